// Adds the texts of what is loaded after the first screen, so that the first screen waits for its own texts only.

import { moreDe } from '../locales/de-more.js';
import { moreEn } from '../locales/en-more.js';
import { addTexts } from './i18n.js';

addTexts({ de: moreDe, en: moreEn });
