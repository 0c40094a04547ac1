// One gripper, as the page knows it.

import { batch, computed, signal } from '../lib.js';
import { Samples } from '../core/ring.js';
import { has } from '../core/flags.js';
import { numbered } from '../core/newest.js';

/** Ten minutes at 20 a second. */
const SAMPLES = 12_288;

/** Nobody reads figures that change faster. */
const READ_EVERY_MS = 230;

/** Marks on the charts: more are not told apart. */
const MAX_MARKS = 64;

const SETTINGS = ['acceleration_mm_s2', 'force_n', 'minus_mm', 'plus_mm', 'tag'];

export class Gripper {
  #readAt = -Infinity;

  constructor(name) {
    this.name = name;
    /** What was told last, and perhaps not shown yet. */
    this.newest = null;
    this.state = signal(null);
    /** The same for figures that people read, less often while it moves. */
    this.reading = signal(null);
    /** When the gripper was heard last, while it isn't connected. */
    this.lostAt = signal(null);
    this.info = signal(null);
    this.lease = signal(null);
    /** What is set, by the field names of the API; what isn't known is left out. */
    this.settings = signal({});
    /** Who set them, by the same names; null where that was only read. */
    this.setBy = signal({});
    /** The event that told of the newest change of a setting. */
    this.settingsChange = signal(null);
    /** Where a running motion goes: `{command, kind, width_mm, force_n}`. */
    this.target = signal(null);
    /** The newest command that began or ended here, whoever asked: for the line below the controls. */
    this.command = signal(null);
    this.problem = signal(null);
    /** What entitles this page to move it: `{token, epoch}`. */
    this.held = signal(null);
    this.isAsking = signal(false);
    /** Numbers its FAST STOPs. */
    this.stopping = numbered();
    /** Whether a motion of this page was asked for, of which no state tells yet. */
    this.isAsked = signal(false);
    this.samples = new Samples(SAMPLES);
    this.marks = [];

    const of = (read) => computed(() => (this.state.value === null ? null : read(this.state.value)));
    this.width = of((state) => state.width_mm);
    this.speed = of((state) => state.speed_mm_s);
    this.force = of((state) => state.force_n);
    this.gripperState = of((state) => state.state);
    this.link = of((state) => state.link);
    this.linkCause = of((state) => state.link_cause);
    this.flags = of((state) => state.flags_raw);
    this.isMoving = of((state) => state.moving);
    this.isReferenced = of((state) => state.referenced);
    this.holder = of((state) => state.lease_holder);
    this.temperature = of((state) => state.temperature_c);
    this.runs = of((state) => state.command);
    this.latchId = of((state) => (state.fast_stop ? state.fast_stop_id : null));
    this.isConfirmed = of((state) => state.fast_stop_confirmed ?? null);
    this.hasOverdrive = computed(() => has(this.flags.value, 'OVERDRIVE_MODE'));
    this.isMine = computed(() => this.held.value !== null && this.held.value.epoch === this.state.value?.lease_epoch);
    this.softLimits = computed(() => ({
      minus_mm: this.settings.value.minus_mm ?? null,
      plus_mm: this.settings.value.plus_mm ?? null,
    }));
    this.isThere = computed(() => this.link.value === 'connected');
    /** -1 closes, 1 opens, 0 stands. */
    this.direction = computed(() => {
      if (!this.isMoving.value) return 0;
      const speed = this.speed.value ?? 0;
      if (Math.abs(speed) > 0.1) return Math.sign(speed);
      const target = this.target.value?.width_mm;
      return target === undefined || target === null || this.width.value === null
        ? 0
        : Math.sign(target - this.width.value);
    });
  }

  /** Takes a state; it is shown with the next frame of the screen. */
  take(state, at) {
    this.newest = state;
    if (state.link === 'connected')
      this.samples.push(at, [state.width_mm ?? NaN, state.speed_mm_s ?? NaN, state.force_n ?? NaN]);
    else this.samples.gap();
  }

  /** Takes what is set, out of whatever tells it: an event tells by whom, too. */
  takeSettings(told) {
    const [known, by] = [this.settings.peek(), this.setBy.peek()];
    const fields = SETTINGS.filter((field) => field in told);
    // What is read again was set by whoever set it.
    const whose = (field) => told.subject ?? (told[field] === known[field] ? by[field] : null) ?? null;
    batch(() => {
      this.setBy.value = { ...by, ...Object.fromEntries(fields.map((field) => [field, whose(field)])) };
      this.settings.value = { ...known, ...Object.fromEntries(fields.map((field) => [field, told[field]])) };
    });
  }

  show() {
    const state = this.newest;
    if (state === null || state === this.state.peek()) return;
    this.state.value = state;
    if (state.link === 'connected') this.lostAt.value = null;
    else if (this.lostAt.peek() === null && state.age_ms !== null) this.lostAt.value = Date.now() - state.age_ms;
    const now = performance.now();
    if (!state.moving || now - this.#readAt >= READ_EVERY_MS) {
      this.#readAt = now;
      this.reading.value = state;
    }
    const held = this.held.peek();
    // What was lost, or is somebody else's by now, entitles to nothing: its token would only be refused.
    const isOver =
      held && (state.lease_epoch > held.epoch || (state.lease_epoch === held.epoch && state.lease_holder === null));
    if (isOver) this.held.value = null;
  }

  mark(at, kind, text) {
    this.marks.push({ at, kind, text });
    if (this.marks.length > MAX_MARKS) this.marks.shift();
  }
}
