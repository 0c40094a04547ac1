// The command editor: bytes as text, their frame, and the gripper's answer.

import { html, useSignal } from '../lib.js';
import { interpretations, parse, parseId } from './bytes.js';
import { encode, fromHex, MAX_PAYLOAD, toHex } from './frame.js';
import { t } from '../model/i18n.js';
import { isLive, rpc } from '../model/store.js';
import { Panel, ProblemNote } from '../ui/parts.js';

/** Digits of a frame that are shown. A longer one loses its middle, so that the checksum stays visible. */
const SHOWN = 240;
const shortened = (hex) => (hex.length <= SHOWN ? hex : `${hex.slice(0, SHOWN - 30)} … ${hex.slice(-23)}`);

function Answer({ answer }) {
  const bytes = fromHex(answer.payload ?? '');
  return html`<div role="status" id="answer"><p><strong>${t('editor.answer')}
    </strong> <code>${answer.status ?? answer.phase ?? '–'}${answer.outcome ? ` ${answer.outcome}` : ''}</code></p>
    ${
      bytes.length > 0 &&
      html`<p><code>${toHex(bytes, ' ')}</code></p><dl
        class="meanings">${interpretations(Array.from(bytes)).map(
          ({ type, value }) => html`<dt
            key=${type}>${t(`type.${type}`)}</dt><dd data-type=${type}>${String(value)}</dd>`,
        )}</dl>`
    }</div>`;
}

export function Editor({ one }) {
  const [id, payload, answer, problem] = [useSignal('0x31'), useSignal(''), useSignal(null), useSignal(null)];
  const code = parseId(id.value);
  const { bytes, wrong } = parse(payload.value);
  const isLong = bytes.length > MAX_PAYLOAD;
  const isRight = code !== null && wrong === null && !isLong;
  const send = async (event) => {
    event.preventDefault();
    [answer.value, problem.value] = [null, null];
    const lease = one.held.peek()?.token;
    try {
      answer.value = await rpc.call('raw', {
        gripper: one.name,
        id: code,
        payload: toHex(bytes),
        ...(lease ? { lease } : {}),
      });
    } catch (refused) {
      problem.value = refused;
    }
  };
  return html`<${Panel} title=${t('editor.title')} id="editor-title"><form class="controls" onSubmit=${send}>
    <div class=${`field ${code === null ? 'wrong' : ''}`}><label for="editor-id">${t('editor.id')}</label><input
        id="editor-id" type="text" autocomplete="off" spellcheck=${false} aria-describedby="editor-id-hint"
            aria-invalid=${code === null ? 'true' : 'false'} value=${id.value}
                onInput=${(event) => {
                  id.value = event.currentTarget.value;
                }} />
      <p class="hint" id="editor-id-hint">${t(code === null ? 'editor.id_wrong' : 'editor.id_hint')}</p></div>
    <div class=${`field ${wrong !== null || isLong ? 'wrong' : ''}`}><label
        for="editor-payload">${t('editor.payload')}</label><textarea id="editor-payload" spellcheck=${false}
            aria-describedby="editor-payload-hint" aria-invalid=${wrong === null && !isLong ? 'false' : 'true'}
                value=${payload.value} onInput=${(event) => {
                  payload.value = event.currentTarget.value;
                }}></textarea>
      <p class="hint" id="editor-payload-hint">${
        wrong !== null
          ? t('editor.wrong', { what: wrong })
          : isLong
            ? t('editor.long', { max: MAX_PAYLOAD })
            : t('editor.hint')
      }</p></div>
    <div><p class="small muted">${t('editor.frame')}</p><p><output id="editor-frame" for="editor-id editor-payload">
      <code>${isRight ? shortened(toHex(encode(code, bytes), ' ')) : '–'}</code></output></p></div>
    <button type="submit" id="editor-send" class="primary" disabled=${!isRight || !isLive.value}>${t('editor.send')}
      </button>
    <p class="hint">${t('editor.moves')}</p>
    ${answer.value && html`<${Answer} answer=${answer.value} />`}
  </form><${ProblemNote} problem=${problem} /></${Panel}>`;
}
