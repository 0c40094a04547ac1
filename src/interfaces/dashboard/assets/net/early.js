// Runs before the first paint. Sets the theme, so that no white page flashes at night, and sends the first request
// while the modules are loading, so that the first paint shows values.

{
  let theme = null;
  try {
    theme = JSON.parse(localStorage.getItem('wsg.theme'));
  } catch {
    // Follow the system's theme.
  }
  const isDark = theme === 'dark' || (theme !== 'light' && matchMedia('(prefers-color-scheme: dark)').matches);
  document.documentElement.dataset.theme = isDark ? 'dark' : 'light';

  const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
  const socket = new WebSocket(`${scheme}://${location.host}/api/v1/ws`, 'wsg.v1');
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
