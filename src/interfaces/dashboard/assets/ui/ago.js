// How long ago something was.

import { span, t } from '../model/i18n.js';
import { now } from '../model/state.js';

export const ago = (at) => t('ago', { span: span(now.value - at) });
