// The tab's title: number of open alarms, gripper and gateway.

import { effect, signal } from '../lib.js';
import { get } from '../net/rest.js';
import { isOpen } from '../core/alarms.js';
import { alarms } from '../model/alarms.js';
import { shownGripper, isLive } from '../model/state.js';

const gateway = signal('WSG Gateway');

// After a lost connection, another gateway can answer at the same address.
effect(() => {
  if (!isLive.value) return;
  get('/healthz').then(
    ({ gateway: name }) => {
      gateway.value = name;
    },
    () => {},
  );
});

effect(() => {
  const open = alarms.value.filter(isOpen).length;
  document.title = [open > 0 ? `(${open})` : '', shownGripper.value?.name, '–', gateway.value]
    .filter(Boolean)
    .join(' ');
});
