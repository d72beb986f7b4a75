// State of the page: frames of the last minute or of a recording, system status, events and cursor.
// This module does not access the document.

import { angleBetween, attitudeOf, product, upOf } from "./attitude.js";

/** @typedef {import("./wire.js").Message} Message */
/** @typedef {import("./attitude.js").Quat} Quat */
/** @typedef {import("./attitude.js").Vec} Vec */
/** @typedef {Message & { services?: Message[], slots?: Message[], vehicles?: Message[] }} SystemStatus */
/** Frame of the history, made of one snapshot. `values` holds the minimum and the maximum of each of the `QUANTITIES`, NaN if unknown; `ups` holds the up vectors of `TRAILS`.
 * @typedef {{ t: number, number: number, snapshot: Message, values: Float64Array, ups: Record<string, Vec | null> }} Frame */
/** Entry of the event list. `t` and `until` are the start and the end on the source's clock, s, or null if unknown; `reported_s` is the time of the report on the board's clock.
 * @typedef {{ t: number | null, until: number | null, reported_s: number, number: number, text: string, label: string, fault: boolean, kind: string, service: string, stage: string, tick: number }} LogEvent */

/** Longest time span of a running system that is kept and shown, s. */
export const MAX_SPAN_S = 60;
/** Shortest time span shown, s. */
const MIN_SPAN_S = 0.5;
const MAX_FRAMES = 3000;
const MAX_EVENTS = 1000;
/** A flag that is set again within this time counts as set in between, s. */
const FLAG_HOLD_S = 1;
/** Time without an attitude after which the view is marked stale, ms. */
export const STALE_AFTER_MS = 400;
/** Maximum age of a difference, s. Shadows report ten times a second; an older difference belongs to a shadow that has ended. */
const MAX_DIFFERENCE_AGE_S = 0.5;
/** Tick field of events without a tick. */
const NO_TICK = 2 ** 53;
/** Reason in the reply about a shadow that was cancelled on request. */
export const CANCELLED_REASON = "cancelled as requested";

/** Outputs that are hidden when older than `MAX_OUTPUT_AGE_S`. Sensor values are shown with their age instead. */
const EXPIRING_TOPICS = ["gyro", "accel", "fused"];
const MAX_OUTPUT_AGE_S = 0.5;
const TOPICS = ["imu", "mag", "gnss", "gyro", "accel", "fused", "attitude", "reference"];

/** Topics whose up vector is drawn as a trail. */
export const TRAILS = ["accel", "gyro", "fused"];

/** Quantities with a range within a snapshot, as in the schema. */
export const RANGES = new Set(["force_m_s2", "field_ut", "rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s", "innovation_rad", "error_rad", "latency_s"]);

/** Quantities that the strips can show. */
export const QUANTITIES = [
  ...RANGES, "yaw_rad", "pitch_rad", "roll_rad", "course_rad", "inclination_sd_rad", "course_sd_rad", "u", "v", "z_rad", "bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s",
  "u_gyro", "v_gyro", "z_gyro_rad", "u_accel", "v_accel", "difference_rad",
];
const VALUE_INDEX = new Map(QUANTITIES.map((name, at) => [name, 2 * at]));

/** Returns the index of a quantity's minimum in the values of a frame; its maximum follows. @param {string} name */
export function valueIndex(name) {
  const index = VALUE_INDEX.get(name);
  if (index === undefined) throw new Error(`unknown quantity ${name}`);
  return index;
}

export class Data {
  constructor() {
    /** @type {Frame[]} */ this.frames = [];
    /** @type {SystemStatus} */ this.systemStatus = {};
    /** @type {LogEvent[]} */ this.events = [];
    /** Incremented when the event list changes. */ this.revision = 0;
    /** Reply to `command`. @type {Message | null} */ this.answer = null;
    /** Reason if a calibration was rejected. */ this.calibrationError = "";
    /** Progress of the calibration. @type {Message | null} */ this.calibration = null;
    /** Newest message of each topic. @type {Message} */ this.newest = {};
    /** Newest difference of each slot's shadow and its time, s. @type {Map<string, { t: number, difference: Message }>} */ this.shadows = new Map();
    /** Cursor, s; null shows the newest frame. @type {number | null} */ this.cursor = null;
    this.paused = false;
    /** Moves the cursor to a time, s, and pauses. @type {(t: number) => void} */ this.goTo = (t) => { this.paused = true; this.cursor = t; };
    /** Time span of the strips and the timeline, s. */ this.span_s = MAX_SPAN_S;
    /** Length of the history, s. */ this.kept_s = MAX_SPAN_S;
    /** End of the time span shown, s. */ this.end = 0;
    /** Offset of the source's clock from the board's, s; null until a message contains both times. @type {number | null} */ this.clock_offset_s = null;
    /** Newest event of each flag. @type {Map<string, LogEvent>} */ this.flagEvents = new Map();
    /** Names of the flags, each with whether it is only informational. @type {[string, boolean][]} */ this.flags = [];
    /** Parameters of the built-in stages by slot and stage. @type {Record<string, Record<string, import("./parameters.js").Parameter[]>>} */ this.parameters = {};
    /** Parameters of the shadow that this page has started, by slot. @type {Record<string, import("./parameters.js").Setting[]>} */ this.shadowSet = {};
    /** State of the connection: "connecting", "open", "closed", "unauthorized", "unavailable". */ this.link = "connecting";
    /** Reason if the vehicle is not available. */ this.unavailableReason = "";
    /** Last swap, shadow or cancellation. @type {Message | null} */ this.command = null;
    /** When the last attitude was received, ms. */ this.received_ms = -Infinity;
    /** Snapshots of a recording, each with the frame of the same number. @type {Message[]} */ this.recording = [];
    /** Number of the recording's frame shown. */ this.position = 0;
    /** Time up to which a recording has been played, s. */ this.played_to = 0;
    /** Number of bytes received. */ this.bytes = 0;
  }

  /** Discards the history before another vehicle is shown. */
  clear() {
    this.frames.length = 0;
    this.events.length = 0;
    this.revision += 1;
    this.recording = [];
    this.span_s = MAX_SPAN_S;
    this.flagEvents.clear();
    this.systemStatus = {};
    this.newest = {};
    this.clock_offset_s = null;
    this.calibration = null;
    this.shadows.clear();
    this.answer = null;
    this.cursor = null;
    this.paused = false;
    this.received_ms = -Infinity;
  }

  /** Adds a snapshot. @param {Message} snapshot @param {number} now */
  push(snapshot, now) {
    this.recordEvents(snapshot);
    if (snapshot.attitude) this.received_ms = now;
    const t = timeOf(snapshot), last = this.frames.at(-1);
    // A step back in time means that the source has restarted.
    if (t !== null && last && t < last.t - 1) this.handleRestart();
    const frame = this.addFrame(snapshot);
    if (!frame) return;
    if (!this.paused) {
      while (this.frames.length > MAX_FRAMES || (this.frames.length > 1 && this.frames[0].t < frame.t - this.kept_s)) this.frames.shift();
    } else if (this.frames.length > 2 * MAX_FRAMES) {
      // Keeps the frames from before the pause and drops some received since.
      this.frames.splice(MAX_FRAMES, MAX_FRAMES / 2);
    }
  }

  /** Shows a recording from its start, with the whole of it in the strips. @param {Message[]} snapshots */
  openRecording(snapshots) {
    this.clear();
    this.paused = true;
    for (const snapshot of snapshots) {
      this.recordEvents(snapshot);
      const t = timeOf(snapshot);
      // Frames are in the order of time, so that the one at a time can be found.
      if (t === null || t <= (this.frames.at(-1)?.t ?? -Infinity)) continue;
      this.addFrame(snapshot);
      this.recording.push(snapshot);
    }
    this.seek(0);
    this.showAll();
  }

  /** Shows the frame of a recording with this number. @param {number} position */
  seek(position) {
    this.position = Math.max(0, Math.min(this.frames.length - 1, Math.round(position)));
    this.cursor = this.played_to = this.frames[this.position]?.t ?? 0;
  }

  /** Advances a recording by a time, s. It pauses at the end. @param {number} seconds */
  play(seconds) {
    this.played_to += seconds;
    while (this.position + 1 < this.frames.length && this.frames[this.position + 1].t <= this.played_to) this.position += 1;
    this.cursor = this.frames[this.position]?.t ?? 0;
    if (this.position + 1 >= this.frames.length) this.paused = true;
  }

  /** Adds the frame of a snapshot and returns it, or null if the snapshot has no time. @param {Message} snapshot @returns {Frame | null} */
  addFrame(snapshot) {
    for (const name of TOPICS) if (snapshot[name]) this.newest[name] = snapshot[name];
    const t = timeOf(snapshot);
    if (t === null) return null;
    for (const difference of snapshot.differences) this.shadows.set(difference.service, { t, difference });
    for (const [slot, shadow] of this.shadows) if (t - shadow.t > MAX_DIFFERENCE_AGE_S) this.shadows.delete(slot);
    const differences = [...this.shadows.values()].map((shadow) => shadow.difference);
    /** @type {Message} */
    const shown = { ...this.newest, differences };
    // Outputs of a service that no longer publishes are not current.
    for (const name of EXPIRING_TOPICS) if (shown[name] && t - shown[name].header.t_end_ns * 1e-9 > MAX_OUTPUT_AGE_S) delete shown[name];
    const ups = Object.fromEntries(TRAILS.map((name) => [name, upOfPoint(shown[name])]));
    const frame = { t, number: snapshot.number, snapshot: shown, values: valuesOf({ ...snapshot, differences }), ups };
    this.frames.push(frame);
    return frame;
  }

  /** Discards the frames of the previous run; its events remain in the list without a time. */
  handleRestart() {
    this.frames.length = 0;
    this.shadows.clear();
    this.flagEvents.clear();
    this.cursor = null;
    this.paused = false;
    this.revision += 1;
    for (const event of this.events) if (event.t !== null) event.t = NaN;
  }

  /** Records the events and flags of a snapshot. @param {Message} snapshot */
  recordEvents(snapshot) {
    const header = (snapshot.attitude ?? snapshot.imu)?.header;
    if (header) {
      this.clock_offset_s = (header.t_end_ns - header.t_sent_ns) * 1e-9;
      for (const event of this.events) if (event.t === null) { event.t = event.reported_s + this.clock_offset_s; this.revision += 1; }
    }
    // A snapshot that replaces missed ones has no header; the last frame's time is close enough.
    const t = header ? header.t_end_ns * 1e-9 : this.frames.at(-1)?.t;
    if (t !== undefined) {
      this.flags.forEach(([name, informational], bit) => {
        if (!informational && Math.floor(snapshot.flags / 2 ** bit) % 2 === 1) this.recordFlag(name, t);
      });
    }
    for (const event of snapshot.events) this.recordEvent(event);
  }

  /** Extends the last event of a flag, or adds a new one. @param {string} name @param {number} t */
  recordFlag(name, t) {
    const last = this.flagEvents.get(name);
    if (last?.until && t >= last.until && t - last.until < FLAG_HOLD_S) {
      last.until = t;
      return;
    }
    const event = { t, until: t, reported_s: t - (this.clock_offset_s ?? 0), number: -1, text: `flag ${name}`, label: name, fault: name !== "swapped", kind: "FLAG", service: "", stage: "", tick: NO_TICK };
    this.flagEvents.set(name, event);
    this.add(event);
  }

  /** Returns the names of the fault flags set at the time shown. @returns {string[]} */
  activeFaults() {
    const t = this.shown()?.t ?? NaN;
    return [...this.flagEvents.values()].filter((event) => event.fault && Math.abs(t - (event.until ?? NaN)) < FLAG_HOLD_S).map((event) => event.label);
  }

  /** Records an event unless it was recorded before. @param {Message} event */
  recordEvent(event) {
    const reported_s = event.t_event_ns * 1e-9;
    if (this.events.some((known) => known.number === event.number && known.reported_s === reported_s)) return;
    const kind = event.kind.replace("EVENT_KIND_", "");
    const fault = ["ENDED", "GIVEN_UP", "LOST", "NOT_RECORDED", "ABORTED", "REFUSED", "BUS_RENEWED"].includes(kind) && event.reason !== CANCELLED_REASON;
    const service = event.service === "SERVICE_UNSPECIFIED" ? "" : event.service.replace("SERVICE_", "").toLowerCase();
    const label = `${service} ${kind.toLowerCase().replaceAll("_", " ")}`.trim();
    this.add({ t: this.clock_offset_s === null ? null : reported_s + this.clock_offset_s, until: null, reported_s, number: event.number, text: describe(event, label), label, fault, kind: event.kind, service, stage: event.stage, tick: event.tick });
  }

  /** @param {LogEvent} event */
  add(event) {
    this.events.push(event);
    this.revision += 1;
    if (this.events.length > MAX_EVENTS) this.events.shift();
  }

  /** Returns the longest time span that can be shown: that of the recording, or the last minute, s. */
  maxSpan() {
    return this.recording.length ? Math.max(MIN_SPAN_S, (this.frames.at(-1)?.t ?? 0) - this.frames[0].t) : MAX_SPAN_S;
  }

  /** Shows the longest time span. */
  showAll() {
    this.span_s = this.maxSpan();
    this.end = this.frames.at(-1)?.t ?? 0;
  }

  /** Shows the span between two times, s, and pauses. @param {number} from @param {number} to */
  showSpan(from, to) {
    this.paused = true;
    this.span_s = Math.max(MIN_SPAN_S, Math.min(this.maxSpan(), to - from));
    this.end = to;
    if (this.cursor === null || this.cursor < from || this.cursor > to) this.goTo(to);
  }

  /** Returns the time of the source's clock at which the displayed time is 0, s: the start of a recording. */
  origin() {
    return this.recording.length ? this.systemStatus.t_first_ns * 1e-9 : 0;
  }

  /** Returns a time of the source's clock as displayed. @param {number} t s */
  timeText(t) {
    return `${(t - this.origin()).toFixed(2).replace(/^-0\.00$/, "0.00").replace("-", "−")} s`;
  }

  /** Returns the start and the end of the time span shown, s. @returns {[number, number]} */
  window() {
    const newest = this.frames.at(-1)?.t ?? 0;
    const follows = this.recording.length ? this.span_s >= this.maxSpan() : !this.paused || this.cursor === null;
    if (follows || this.cursor === null) this.end = newest;
    else if (this.cursor > this.end) this.end = this.cursor;
    else if (this.cursor < this.end - this.span_s) this.end = this.cursor + this.span_s;
    return [this.end - this.span_s, this.end];
  }

  /** Scales the time span shown. The cursor, if any, keeps its place. @param {number} factor */
  zoom(factor) {
    const old = this.span_s;
    this.span_s = Math.max(MIN_SPAN_S, Math.min(this.maxSpan(), old * factor));
    if (this.cursor === null) return;
    const newest = this.frames.at(-1)?.t ?? 0, oldest = this.frames[0]?.t ?? 0;
    const end = this.cursor + (this.end - this.cursor) * (this.span_s / old);
    this.end = Math.min(newest, Math.max(end, oldest + this.span_s));
  }

  /** Returns the frame at the cursor, or the newest one. @returns {Frame | null} */
  shown() {
    if (this.recording.length) return this.frames[this.position] ?? null;
    if (this.cursor !== null) return this.nearest(this.cursor);
    return this.frames.at(-1) ?? null;
  }

  /** Returns the first frame at or after `t`, or the last frame. @param {number} t @returns {Frame | null} */
  nearest(t) {
    return this.frames[this.indexAt(t)] ?? null;
  }

  /** Returns the number of the first frame at or after `t`, or of the last frame. @param {number} t */
  indexAt(t) {
    let [low, high] = [0, this.frames.length - 1];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.frames[middle].t < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Moves the cursor by a number of frames, or by `seconds` unless 0. @param {number} frames @param {number} seconds */
  step(frames, seconds) {
    const at = this.shown();
    if (!at) return;
    const wanted = seconds ? this.nearest(at.t + seconds) : this.frames[Math.max(0, Math.min(this.frames.length - 1, this.frames.indexOf(at) + frames))];
    if (wanted) this.cursor = wanted.t;
  }

  /** Returns a short label for the state, its kind and the reason. @param {number} now */
  state(now) {
    const { state, reason } = this.systemStatus;
    if (this.recording.length) return { label: this.paused ? "paused" : "replay", kind: "live", reason: "" };
    if (this.link === "unauthorized") return { label: "no token", kind: "connecting", reason: "Viewing requires a valid token. Open the complete address printed by `plumb up` or `plumb view`." };
    if (this.link === "unavailable") return { label: "no such vehicle", kind: "connecting", reason: this.unavailableReason };
    if (this.link !== "open") return { label: "connecting", kind: "connecting", reason: "No connection to the cockpit. Start it with `plumb up` or `plumb view`; this page then connects automatically." };
    if (state === "STATE_ENDED") return { label: "ended", kind: "ended", reason };
    if (state === "STATE_UNSELECTED") return { label: "choose a vehicle", kind: "paused", reason: "" };
    if (state !== "STATE_LIVE" && state !== "STATE_RECORDING") return { label: "connecting", kind: "connecting", reason: reason ?? "" };
    const age = now - this.received_ms;
    if (age > STALE_AFTER_MS) {
      const label = Number.isFinite(age) ? `stale ${(age / 1000).toFixed(1)} s` : "no attitude yet";
      return { label, kind: "stale", reason: "" };
    }
    return { label: this.paused ? "paused" : "live", kind: this.paused ? "paused" : "live", reason: "" };
  }
}

/** Returns the time of a snapshot on the source's clock, s, or null if it has none. @param {Message} snapshot @returns {number | null} */
function timeOf(snapshot) {
  const header = (snapshot.attitude ?? snapshot.imu)?.header;
  return header ? header.t_end_ns * 1e-9 : null;
}

/** Returns the minimum and the maximum of each quantity in a snapshot. @param {Message} snapshot @returns {Float64Array} */
function valuesOf(snapshot) {
  const values = new Float64Array(2 * QUANTITIES.length).fill(NaN);
  const setRange = (/** @type {string} */ name, /** @type {number} */ min, /** @type {number} */ max) => {
    if (Number.isFinite(min) && Number.isFinite(max)) values.set([min, max], valueIndex(name));
  };
  const set = (/** @type {string} */ name, /** @type {number} */ value) => setRange(name, value, value);
  for (const { quantity, min, max } of snapshot.extremes) {
    const name = quantity.replace("QUANTITY_", "").toLowerCase();
    if (RANGES.has(name)) setRange(name, min, max);
  }
  const { attitude, fused, accel, gyro } = snapshot;
  if (attitude) {
    for (const name of ["yaw_rad", "pitch_rad", "roll_rad", "course_rad", "inclination_sd_rad"]) set(name, attitude[name]);
    if (attitude.course_sd_rad < Math.PI) set("course_sd_rad", attitude.course_sd_rad);
  }
  if (fused?.w) {
    set("u", fused.w.re); set("v", fused.w.im); set("z_rad", fused.z_rad);
    for (const axis of "xyz") if (fused.bias_rad_s) set(`bias_${axis}_rad_s`, fused.bias_rad_s[axis]);
  }
  if (gyro?.w) { set("u_gyro", gyro.w.re); set("v_gyro", gyro.w.im); set("z_gyro_rad", gyro.z_rad); }
  if (accel?.w) { set("u_accel", accel.w.re); set("v_accel", accel.w.im); }
  for (const difference of snapshot.differences) if (difference.now_rad) set("difference_rad", difference.now_rad.x);
  return values;
}

/** Returns the description of an event. @param {Message} event @param {string} label */
function describe(event, label) {
  const stage = event.stage ? ` ${event.stage}` : "";
  const tick = event.tick < NO_TICK && event.tick > 0 ? ` at tick ${event.tick}` : "";
  const reason = event.reason ? `: ${event.reason}` : "";
  return label + stage + tick + reason;
}

/** @param {Message | null | undefined} q @returns {Quat | null} */
export const quaternion = (q) => (q ? [q.w, q.x, q.y, q.z] : null);

/** @param {Message | null | undefined} v @returns {Vec | null} */
export const vector = (v) => (v ? [v.x, v.y, v.z] : null);

/** Returns the up vector of a message with a point w. @param {Message | null | undefined} message @returns {Vec | null} */
export function upOfPoint(message) {
  return message?.w ? upOf(message.w.re, message.w.im, message.chart === "CHART_INVERTED") : null;
}

/** Returns the attitude of a message with a point w and an angle z. @param {Message | null | undefined} message @returns {Quat | null} */
export function attitudeOfPoint(message) {
  const up = upOfPoint(message);
  return up && message ? attitudeOf(up, message.z_rad, message.chart === "CHART_INVERTED") : null;
}

/** Returns the attitude of a slot's shadow: the owner's attitude combined with their difference. @param {Message} snapshot @returns {Quat | null} */
export function attitudeOfShadow(snapshot) {
  const [own, rotation] = [quaternion(snapshot.attitude?.quaternion), quaternion(snapshot.differences?.[0]?.rotation)];
  return own && rotation?.every(Number.isFinite) ? product(own, rotation) : null;
}

/** Returns the angle to the reference of the same tick, rad. @param {Message} snapshot */
export function errorOf(snapshot) {
  const [own, truth] = [quaternion(snapshot.attitude?.quaternion), quaternion(snapshot.reference?.quaternion)];
  return own && truth && snapshot.reference.tick === snapshot.attitude.header.tick ? angleBetween(own, truth) : null;
}
