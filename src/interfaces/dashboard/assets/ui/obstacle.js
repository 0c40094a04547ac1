// Notice of the reason that the page gets no connection.

import { html } from '../lib.js';
import { t } from '../model/i18n.js';
import { obstacle } from '../model/obstacle.js';

export function Obstacle() {
  if (obstacle.value === null) return null;
  const text = obstacle.value === 'origin' ? t('obstacle.origin', { origin: location.origin }) : t('obstacle.socket');
  return html`<div class="newer missing"><p role="alert">${text} <a href="docs/guide/proxy" target="_blank"
      rel="noopener">${t('obstacle.guide')}</a></p></div>`;
}
