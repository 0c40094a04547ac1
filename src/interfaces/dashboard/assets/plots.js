// The library that draws plots. It is nearly as large as the rest of the operating view, whose controls do not wait for it.

import uPlot from './vendor/uplot.js';

export const Plot = uPlot;
