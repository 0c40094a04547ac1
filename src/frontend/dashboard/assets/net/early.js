// Before anything is painted: the looks, so that no white page flashes at night; and the connection, while the modules
// are still on their way: one round trip less until there is something to see.

let earlyTheme = null;
try {
  earlyTheme = JSON.parse(localStorage.getItem('wsg.theme'));
} catch {
  // As outside.
}
const isEarlyDark = earlyTheme === 'dark' || (earlyTheme !== 'light' && matchMedia('(prefers-color-scheme: dark)').matches);
document.documentElement.dataset.theme = isEarlyDark ? 'dark' : 'light';

globalThis.earlySocket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/api/v1/ws`, 'wsg.v1');
