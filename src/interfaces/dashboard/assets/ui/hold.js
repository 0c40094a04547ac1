// Controls that act while they are held.

import { useEffect } from '../lib.js';

/** Lets go when the page is left or hidden, or another window is used, and when `gripper` is no longer shown. */
export function useLettingGo(end, gripper) {
  useEffect(() => {
    const hidden = () => {
      if (document.hidden) end();
    };
    addEventListener('blur', end);
    addEventListener('pagehide', end);
    document.addEventListener('visibilitychange', hidden);
    return () => {
      end();
      removeEventListener('blur', end);
      removeEventListener('pagehide', end);
      document.removeEventListener('visibilitychange', hidden);
    };
  }, [gripper]);
}

/** Handlers of a control that is held with a pointer. */
export const onHold = (begin, end) => ({
  onPointerDown: (event) => {
    if (event.button !== 0) return;
    event.currentTarget.setPointerCapture(event.pointerId);
    begin(event);
  },
  onPointerUp: end,
  onPointerCancel: end,
  onLostPointerCapture: end,
  onBlur: end,
  onContextMenu: (event) => event.preventDefault(),
});
