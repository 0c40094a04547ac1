// Views that are opened less often. The page loads them with the first of them.

export { Device } from './views/device.js';
export { Flags } from './views/flags.js';
export { History } from './views/history.js';
export { Log } from './views/log.js';
export { All } from './views/overview.js';
