// The command editor: bytes as text, their frame, and the gripper's answer.

import { html, useSignal } from '../lib.js';
import { interpretations, parse, parseId } from '../core/bytes_text.js';
import { encode, fromHex, MAX_PAYLOAD, toHex } from '../core/frame.js';
import { exchange } from '../model/frames.js';
import { compose, fieldsOf, idText, MANUAL, valuesOf } from '../core/manual.js';
import { t } from '../model/i18n.js';
import { isLive } from '../model/state.js';
import { rpc } from '../model/wire.js';
import { Panel, ProblemNote } from '../ui/parts.js';

/** Digits of a frame that are shown. A longer one loses its middle, so that the checksum stays visible. */
const SHOWN = 240;
const shortened = (hex) => (hex.length <= SHOWN ? hex : `${hex.slice(0, SHOWN - 30)} … ${hex.slice(-23)}`);

const spaced = (frame) => shortened(toHex(fromHex(frame.hex), ' '));

/** Shows the sent frame, the reply with its meaning, and the reply's data read as every type of the same length. */
function Answer({ answer }) {
  const { sent, received } = exchange.value ?? {};
  const bytes = fromHex(answer.payload ?? '');
  return html`<div role="status" id="answer"><p><strong>${t('editor.answer')}
    </strong> <code>${answer.status ?? answer.phase ?? '–'}${answer.outcome ? ` ${answer.outcome}` : ''}</code></p>
    <p class="small muted">${t(sent ? 'editor.sent' : 'editor.not_sent')}</p>
    ${sent && html`<p><code id="editor-sent">${spaced(sent)}</code></p>`}
    ${
      received &&
      html`<p class="small muted">${t('editor.received')}</p>
      <p><code id="editor-received">${spaced(received)}</code></p><p><code id="editor-decoded">${received.text}</code></p>`
    }
    ${
      bytes.length > 0 &&
      html`<dl
        class="meanings">${interpretations(Array.from(bytes)).map(
          ({ type, value }) => html`<dt
            key=${type}>${t(`type.${type}`)}</dt><dd data-type=${type}>${String(value)}</dd>`,
        )}</dl>`
    }</div>`;
}

/** List of the manuals' commands. The user types any other id. */
function Commands({ code, onChoose }) {
  return html`<div class="field"><label for="editor-command">${t('editor.command')}</label><select id="editor-command"
      value=${MANUAL.has(code) ? String(code) : ''} onChange=${({ currentTarget }) => {
        if (currentTarget.value !== '') onChoose(Number(currentTarget.value));
      }}>
    <option value="">${t('editor.other')}</option>${Array.from(
      MANUAL,
      ([id, [name]]) => html`<option key=${id} value=${id}>${idText(id)} ${name}</option>`,
    )}</select></div>`;
}

/** Fields for a command's parameters. The text below follows the fields. */
function Form({ code, payload, bytes }) {
  // Text that the fields wrote last, and what was typed into them.
  const typed = useSignal(null);
  const fields = fieldsOf(code);
  if (fields.length === 0) return null;
  const isTyped = typed.value?.code === code && typed.value.text === payload.value;
  const values = isTyped ? typed.value.values : valuesOf(fields, bytes);
  const change = (index, text) => {
    const next = values.with(index, text);
    payload.value = compose(fields, next);
    typed.value = { code, text: payload.value, values: next };
  };
  return html`<div class="fields">${fields.map(
    ({ key, type, unit }, index) => html`<div class="field" key=${key}><label
        for=${`editor-field-${index}`}>${t(key)}</label><div class="input"><input id=${`editor-field-${index}`}
            type="text" inputmode=${type === 'text' ? 'text' : 'decimal'} autocomplete="off" value=${values[index]}
                onInput=${({ currentTarget }) => change(index, currentTarget.value)} /><span
                    class="unit">${unit}</span></div></div>`,
  )}</div>`;
}

export function Editor({ gripper }) {
  const [id, payload, answer, problem] = [useSignal('0x31'), useSignal(''), useSignal(null), useSignal(null)];
  const isExact = useSignal(false);
  const code = parseId(id.value);
  const { bytes, wrong } = parse(payload.value);
  const isLong = bytes.length > MAX_PAYLOAD;
  const isRight = code !== null && wrong === null && !isLong;
  const choose = (chosen) => {
    [id.value, payload.value] = [idText(chosen), ''];
  };
  const send = async (event) => {
    event.preventDefault();
    [answer.value, problem.value] = [null, null];
    exchange.value = { id: code, sent: null, received: null };
    const lease = gripper.held.peek()?.token;
    try {
      answer.value = await rpc.call('raw', {
        gripper: gripper.name,
        id: code,
        payload: toHex(bytes),
        ...(lease ? { lease } : {}),
        ...(isExact.peek() ? { exact: true } : {}),
      });
    } catch (refused) {
      problem.value = refused;
    }
  };
  return html`<${Panel} title=${t('editor.title')} id="editor-title"><form class="controls" onSubmit=${send}>
    <${Commands} code=${code} onChoose=${choose} />
    <div class=${`field ${code === null ? 'wrong' : ''}`}><label for="editor-id">${t('editor.id')}</label><input
        id="editor-id" type="text" autocomplete="off" spellcheck=${false} aria-describedby="editor-id-hint"
            aria-invalid=${code === null ? 'true' : 'false'} value=${id.value}
                onInput=${(event) => {
                  id.value = event.currentTarget.value;
                }} />
      <p class="hint" id="editor-id-hint">${t(code === null ? 'editor.id_wrong' : 'editor.id_hint')}</p></div>
    <${Form} code=${code} payload=${payload} bytes=${bytes} />
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
    <label class="check"><input type="checkbox" id="editor-exact" aria-describedby="editor-exact-hint"
        checked=${isExact.value} onChange=${({ currentTarget }) => {
          isExact.value = currentTarget.checked;
        }} /> ${t('editor.exact')}</label>
    <p class="hint" id="editor-exact-hint">${t('editor.exact_hint')}</p>
    <button type="submit" id="editor-send" class="primary" disabled=${!isRight || !isLive.value}>${t('editor.send')}
      </button>
    ${answer.value && html`<${Answer} answer=${answer.value} />`}
    <p class="hint">${t('editor.moves')}</p>
  </form><${ProblemNote} problem=${problem} /></${Panel}>`;
}
