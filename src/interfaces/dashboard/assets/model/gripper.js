// One gripper, as the page knows it.

import { batch, computed, signal } from '../lib.js';
import { gatewayNow } from '../core/clock.js';
import { Samples } from '../core/ring.js';
import { has } from '../core/flags.js';
import { ordered } from '../core/newest.js';
import { person } from '../core/people.js';

/** Ten minutes at 20 samples a second. */
const SAMPLES = 12_288;

/** Figures that change faster cannot be read. */
const READ_EVERY_MS = 230;

/** Limit of the marks on the charts. */
const MAX_MARKS = 64;

const SETTINGS = ['acceleration_mm_s2', 'force_n', 'minus_mm', 'plus_mm', 'tag'];

export class Gripper {
  #readAt = -Infinity;
  /** Time of the newest state with a link; null if the page has lost its own connection since. */
  #liveAt = null;
  #answers = Object.fromEntries(['info', 'lease', 'servo', ...SETTINGS].map((field) => [field, ordered()]));

  constructor(name) {
    this.name = name;
    /** Newest state received, perhaps not shown yet. */
    this.newest = null;
    this.state = signal(null);
    /** State for the figures, which is updated less often while the gripper moves. */
    this.reading = signal(null);
    /** Time of the last state with a link, while the gripper is not connected; null if the page did not see it. */
    this.lostAt = signal(null);
    this.info = signal(null);
    this.lease = signal(null);
    /** The open servo session of any client, with its rate as `hz`; null without one. */
    this.servo = signal(null);
    /** Time at which a servo session has ended last; null if the page has seen no end. */
    this.servoEndedAt = null;
    /** Known settings, by the field names of the API. */
    this.settings = signal({});
    /** Subject that changed each setting; null if its value was only read. */
    this.setBy = signal({});
    /** Number of events about motions and settings, and of grip records, that the page has received. */
    this.changes = signal(0);
    /** Target of a running motion: `{command, kind, width_mm, force_n}`. */
    this.target = signal(null);
    /** Newest command of any client, for the line below the controls. */
    this.command = signal(null);
    /** Part of the newest grip, or null. */
    this.part = signal(null);
    this.problem = signal(null);
    /** Lease that this page holds: `{token, epoch}`. */
    this.held = signal(null);
    /** Whether this page waits for control. */
    this.isControlRequested = signal(false);
    /** Newest request of this page for control, even if it is not the first in the queue: `{as, at, epoch}`. */
    this.controlRequest = null;
    /** Epoch of the lease that this page took and has not given up; null without one. */
    this.epoch = null;
    /** How this page lost control, unless the user gave it up: `{how, by}`, or null. */
    this.lostControl = signal(null);
    /** Whether this page has requested a motion that no state reports yet. */
    this.isMotionRequested = signal(false);
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
    this.faultCode = of((state) => state.fault_code);
    /** `outcome_code` of the newest motion of any client; Stops do not change it. */
    this.outcomeCode = of((state) => state.last_outcome_code);
    this.isMoving = of((state) => state.moving);
    this.isReferenced = of((state) => state.referenced);
    this.holder = of((state) => state.lease_holder);
    this.temperature = of((state) => state.temperature_c);
    this.runs = of((state) => state.command);
    /** Names of the values that the gripper should send and does not, with spaces between. */
    this.missing = of((state) => state.stale.join(' '));
    this.latchId = of((state) => (state.fast_stop ? state.fast_stop_id : null));
    /** `FAST_STOP`, or the gripper state. Null if one of them is unknown. */
    this.condition = of((state) => {
      if (state.fast_stop) return 'FAST_STOP';
      return state.fast_stop === null ? null : state.state;
    });
    this.isConfirmed = of((state) => state.fast_stop_confirmed ?? null);
    this.hasOverdrive = computed(() => has(this.flags.value, 'OVERDRIVE_MODE'));
    this.isMine = computed(() => this.held.value !== null && this.held.value.epoch === this.state.value?.lease_epoch);
    /** Name of a lost holder for which the gripper is reserved, or null. */
    this.reservedFor = of((state) => (state.lease_holder === null ? state.reserved_for : null));
    this.softLimits = computed(() => ({
      minus_mm: this.settings.value.minus_mm ?? null,
      plus_mm: this.settings.value.plus_mm ?? null,
    }));
    this.isThere = computed(() => this.link.value === 'connected');
    /** -1 while closing, 1 while opening, 0 at rest. */
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

  /**
   * To be called for each request whose answer is the gripper's `info`, `lease` or `servo`. The result takes that answer, unless a
   * newer request was answered before.
   */
  asking(field) {
    const isNewest = this.#answers[field]();
    return (answer) => {
      if (isNewest()) this[field].value = answer;
    };
  }

  /** Notes the lease that this page was given, or null after the page gave it up. */
  own(lease) {
    this.held.value = lease && { token: lease.token, epoch: lease.epoch };
    this.epoch = lease?.epoch ?? null;
    if (!lease) return;
    this.lostControl.value = null;
    this.controlRequest = null;
    this.isControlRequested.value = false;
  }

  /** Notes how this page lost control, if the page had it. */
  loseControl(how, by = null) {
    if (this.epoch !== null) this.lostControl.value = { how, by };
    this.epoch = null;
  }

  /** Takes the gateway's values from before this page was opened. */
  takeTrend({ age_ms: ages, width_mm: widths, speed_mm_s: speeds, force_n: forces }) {
    const now = performance.now();
    this.samples.fill(ages.map((age, index) => [now - age, [widths[index], speeds[index], forces[index]]]));
  }

  /** Stores a state for the next update of the screen. */
  take(state, at) {
    this.newest = state;
    if (state.link === 'connected')
      this.samples.push(at, [state.width_mm ?? NaN, state.speed_mm_s ?? NaN, state.force_n ?? NaN]);
    else this.samples.gap();
  }

  /** Notes that the page has lost its own connection, so that it does not know what happens. */
  loseSight() {
    this.samples.gap();
    this.#liveAt = null;
  }

  /**
   * Like `asking`, for a request whose answer has settings. An event counts as a request that is answered at once: it
   * is newer than the answers still to come. An event also names the subject.
   */
  askingSettings() {
    const isNewest = Object.fromEntries(SETTINGS.map((field) => [field, this.#answers[field]()]));
    return (settings) => {
      const [known, by] = [this.settings.peek(), this.setBy.peek()];
      const fields = SETTINGS.filter((field) => field in settings && isNewest[field]());
      // An unchanged value keeps its subject.
      const who = settings.subject ? person(settings.subject, settings.label) : null;
      const whose = (field) => who ?? (settings[field] === known[field] ? by[field] : null) ?? null;
      batch(() => {
        this.setBy.value = { ...by, ...Object.fromEntries(fields.map((field) => [field, whose(field)])) };
        this.settings.value = { ...known, ...Object.fromEntries(fields.map((field) => [field, settings[field]])) };
      });
    };
  }

  show() {
    const state = this.newest;
    if (state === null || state === this.state.peek()) return;
    this.state.value = state;
    if (state.link === 'connected') {
      this.#liveAt = gatewayNow();
      this.lostAt.value = null;
    } else {
      this.lostAt.value ??= this.#liveAt;
    }
    const now = performance.now();
    if (!state.moving || now - this.#readAt >= READ_EVERY_MS) {
      this.#readAt = now;
      this.reading.value = state;
    }
    const held = this.held.peek();
    // The gateway would refuse the token of a lost lease.
    const isOver =
      held && (state.lease_epoch > held.epoch || (state.lease_epoch === held.epoch && state.lease_holder === null));
    if (isOver) this.held.value = null;
  }

  mark(at, kind, text) {
    this.marks.push({ at, kind, text });
    if (this.marks.length > MAX_MARKS) this.marks.shift();
  }
}
