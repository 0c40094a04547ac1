// What the page loads after its first screen.

import './model/texts.js';

export { Alarms, Announcer } from './views/alarms.js';
export { Charts } from './views/charts.js';
export { Control } from './views/control.js';
export { Device } from './views/device.js';
export { Flags } from './views/flags.js';
export { History } from './views/history.js';
export { Log } from './views/log.js';
export { Motion } from './views/motion.js';
export { Notices } from './views/notices.js';
export { All } from './views/overview.js';
export { Recipes } from './views/recipes.js';
