// Before anything is painted: the looks, so that no white page flashes at night; and what the page asks for first, while
// its modules are still on their way, so that the first that is painted is what there is to see.

{
  let theme = null;
  try {
    theme = JSON.parse(localStorage.getItem('wsg.theme'));
  } catch {
    // As outside.
  }
  const isDark = theme === 'dark' || (theme !== 'light' && matchMedia('(prefers-color-scheme: dark)').matches);
  document.documentElement.dataset.theme = isDark ? 'dark' : 'light';

  const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
  const socket = new WebSocket(`${scheme}://${location.host}/api/v1/ws`, 'wsg.v1');
  const asked = {
    jsonrpc: '2.0',
    id: 0,
    method: 'subscribe',
    params: { topics: ['state', 'events'], max_hz: document.hidden ? 1 : 20 },
  };
  /** What has come, and when. More than that waits for a page that doesn't come. */
  const heard = [];
  const MAX_HEARD = 1000;
  socket.addEventListener('open', () => socket.send(JSON.stringify(asked)));
  socket.onmessage = ({ data }) => {
    if (heard.push({ data, at: performance.now() }) > MAX_HEARD) socket.close();
  };
  globalThis.early = { socket, asked, heard };
}
