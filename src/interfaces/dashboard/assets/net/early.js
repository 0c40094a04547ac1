// Runs before the first paint. Sets the theme, so that no white page flashes at night, and sends the first request while
// the first script is loading, so that the first paint shows values.

{
  let theme = null;
  try {
    // Stored as by `model/prefs.js`.
    theme = JSON.parse(localStorage.getItem(`wsg${new URL('.', location.href).pathname.slice(0, -1)}.theme`));
  } catch {
    // Follow the system's theme.
  }
  const isDark = theme === 'dark' || (theme !== 'light' && matchMedia('(prefers-color-scheme: dark)').matches);
  document.documentElement.dataset.theme = isDark ? 'dark' : 'light';

  // Relative to the page, which a proxy can serve below any path. `ws:` takes the place of `http:`.
  const address = new URL('api/v1/ws', location.href);
  address.protocol = address.protocol.replace('http', 'ws');
  const socket = new WebSocket(address, 'wsg.v1');
  const asked = {
    jsonrpc: '2.0',
    id: 0,
    method: 'subscribe',
    params: { topics: ['state', 'events', 'grips', 'alarms'], max_hz: document.hidden ? 1 : 20 },
  };
  /** Messages with their times. If the page does not take them, the connection is closed at the limit. */
  const heard = [];
  const MAX_HEARD = 1000;
  socket.addEventListener('open', () => socket.send(JSON.stringify(asked)));
  socket.onmessage = ({ data }) => {
    if (heard.push({ data, at: performance.now() }) > MAX_HEARD) socket.close();
  };
  globalThis.early = { socket, asked, heard };
}
