// Parts of the page that load after its first screen: the rest of the operating view.

import './model/texts.js';
import './views/notices.js';

export { Alarms, Announcer } from './views/alarms.js';
export { Charts } from './views/charts.js';
export { Latch } from './views/latch.js';
export { Motion } from './views/motion.js';
export { Recipes } from './views/recipes.js';
export { WhoControls } from './views/who.js';
