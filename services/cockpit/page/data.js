// What the page knows: the pictures of the last minute or of a recording, the standing, the events, and which moment is looked at.
// It knows topics, time and thinning, and nothing of the document.

import { angleBetween, attitudeOf, product, upOf } from "./attitude.js";

/** @typedef {import("./wire.js").Message} Message */
/** @typedef {import("./attitude.js").Quat} Quat */
/** @typedef {import("./attitude.js").Vec} Vec */
/** What is kept of a picture; of each of the `QUANTITIES` the least and the most, one after the other, NaN where nothing came; the up vectors of `TRAILS`.
 * @typedef {{ t: number, number: number, picture: Message, values: Float64Array, ups: Record<string, Vec | null> }} Frame */
/** Something that happened: when on the source's clock, s, null where that is not known, and until when; when it was told on the board's clock, s.
 * @typedef {{ t: number | null, until: number | null, told_s: number, number: number, text: string, word: string, fault: boolean, kind: string, service: string, stage: string, tick: number }} Told */

export const SHOWN_S = 60;
const FRAMES_MAX = 3000;
const EVENTS_MAX = 1000;
/** A flag that comes again within this time has been up all the while, s. */
const FLAG_S = 1;
/** After so long without a picture with an attitude what is shown is old, ms. */
export const STALE_MS = 400;
/** A difference is told ten times a second; one that is older belongs to a shadow that is gone, s. */
const DIFFERENCE_S = 0.5;
const NONE = 2 ** 53;
/** The reason of a shadow that was told to end. */
export const ENDED_AS_ASKED = "cancelled as requested";

const EXTREMES = {
  QUANTITY_FORCE_M_S2: "force_m_s2", QUANTITY_FIELD_UT: "field_ut", QUANTITY_RATE_X_RAD_S: "rate_x_rad_s", QUANTITY_RATE_Y_RAD_S: "rate_y_rad_s",
  QUANTITY_RATE_Z_RAD_S: "rate_z_rad_s", QUANTITY_INNOVATION_RAD: "innovation_rad", QUANTITY_ERROR_RAD: "error_rad", QUANTITY_LATENCY_S: "latency_s",
};

/** What is no longer drawn when it is older than this, s. The sensors' values are shown with their age. */
const SHORT_LIVED = ["gyro", "accel", "fused"];
const SAID_S = 0.5;
const TOPICS = ["imu", "mag", "gnss", "gyro", "accel", "fused", "attitude", "reference"];

/** The messages with a point whose way is drawn. */
export const TRAILS = ["accel", "gyro", "fused"];

/** The quantities that have a range within a picture. */
export const RANGES = new Set(Object.values(EXTREMES));

/** What the strips can show. */
export const QUANTITIES = [
  ...RANGES, "yaw_rad", "pitch_rad", "roll_rad", "course_rad", "inclination_sd_rad", "course_sd_rad", "u", "v", "z_rad", "bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s",
  "u_gyro", "v_gyro", "z_gyro_rad", "u_accel", "v_accel", "difference_rad",
];
const PLACES = new Map(QUANTITIES.map((name, at) => [name, 2 * at]));

/** Where the least of a quantity stands in the values of a frame; the most follows it. @param {string} name */
export function placeOf(name) {
  const place = PLACES.get(name);
  if (place === undefined) throw new Error(`${name} is no quantity`);
  return place;
}

export class Data {
  constructor() {
    /** @type {Frame[]} */ this.frames = [];
    /** @type {Message} */ this.standing = {};
    /** @type {Told[]} */ this.events = [];
    /** Grows when an event comes, or the time of one becomes known. */ this.revision = 0;
    /** @type {Message | null} */ this.answer = null;
    /** Why a calibration was refused. */ this.refusal = "";
    /** How the calibration that is under way does. @type {Message | null} */ this.calibration = null;
    /** The newest of each message, as long as it is worth showing. @type {Message} */ this.newest = {};
    /** The newest difference of each slot's shadow, and when it came. @type {Map<string, { t: number, difference: Message }>} */ this.shadows = new Map();
    /** The frame that is looked at; null: the newest. @type {number | null} */ this.cursor = null;
    this.paused = false;
    /** Looks at a time, s: the newest goes on behind it. @type {(t: number) => void} */ this.go = (t) => { this.paused = true; this.cursor = t; };
    /** How much of the last minute the strips and the time line show, s. */ this.span_s = SHOWN_S;
    /** How much of the past is kept, s. */ this.kept_s = SHOWN_S;
    /** Where that ends, s. */ this.end = 0;
    /** The source's clock less the board's, s; null as long as no message has said both. @type {number | null} */ this.lead_s = null;
    /** The newest event of each flag. @type {Map<string, Told>} */ this.up = new Map();
    /** The names of the flags, each with whether it says nothing bad. @type {[string, boolean][]} */ this.flags = [];
    /** The connection: "connecting", "open", "closed", "refused", "absent". */ this.link = "connecting";
    /** Why there is nothing of the vehicle that the address names. */ this.absent = "";
    /** The command that was sent last. */ this.asked = "";
    this.came = -Infinity;
    /** Pictures of a recording. @type {Message[]} */ this.recording = [];
    this.place = 0;
    this.bytes = 0;
  }

  /** Forgets what was seen: another vehicle is looked at. */
  clear() {
    this.frames.length = 0;
    this.events.length = 0;
    this.revision += 1;
    this.recording = [];
    this.up.clear();
    this.standing = {};
    this.newest = {};
    this.lead_s = null;
    this.calibration = null;
    this.shadows.clear();
    this.answer = null;
    this.cursor = null;
    this.paused = false;
    this.came = -Infinity;
  }

  /** Takes a picture. @param {Message} picture @param {number} now */
  take(picture, now) {
    // What happened in a recording is known from the beginning.
    if (!this.recording.length) this.hear(picture);
    if (picture.t_made_ns === 0 && !picture.attitude && !picture.imu) return;
    for (const name of TOPICS) if (picture[name]) this.newest[name] = picture[name];
    if (picture.attitude) this.came = now;
    const header = (picture.attitude ?? picture.imu)?.header;
    if (!header) return;
    const t = header.t_end_ns * 1e-9;
    const last = this.frames.at(-1);
    // A source that begins anew begins the strips anew.
    if (last && t < last.t - 1) this.forget();
    for (const difference of picture.differences) this.shadows.set(difference.service, { t, difference });
    for (const [slot, shadow] of this.shadows) if (t - shadow.t > DIFFERENCE_S) this.shadows.delete(slot);
    const differences = [...this.shadows.values()].map((shadow) => shadow.difference);
    /** @type {Message} */
    const shown = { ...this.newest, differences };
    // What a service said that says nothing any more is not how it is now.
    for (const name of SHORT_LIVED) if (shown[name] && t - shown[name].header.t_end_ns * 1e-9 > SAID_S) delete shown[name];
    const ups = Object.fromEntries(TRAILS.map((name) => [name, upOfPoint(shown[name])]));
    const frame = { t, number: picture.number, picture: shown, values: valuesOf(picture), ups };
    this.frames.push(frame);
    if (!this.paused) {
      while (this.frames.length > FRAMES_MAX || (this.frames.length > 1 && this.frames[0].t < frame.t - this.kept_s)) this.frames.shift();
    } else if (this.frames.length > 2 * FRAMES_MAX) {
      // What stood when it was paused stays.
      this.frames.splice(FRAMES_MAX, FRAMES_MAX / 2);
    }
  }

  /** Another run begins: what was seen is no longer before it. */
  forget() {
    this.frames.length = 0;
    this.shadows.clear();
    this.up.clear();
    this.cursor = null;
    this.paused = false;
    this.revision += 1;
    for (const told of this.events) if (told.t !== null) told.t = NaN;
  }

  /** Takes what a picture says of events and flags. @param {Message} picture */
  hear(picture) {
    const header = (picture.attitude ?? picture.imu)?.header;
    if (header) {
      this.lead_s = (header.t_end_ns - header.t_sent_ns) * 1e-9;
      for (const told of this.events) if (told.t === null) { told.t = told.told_s + this.lead_s; this.revision += 1; }
    }
    // Of pictures that were missed the time is known within their own.
    const t = header ? header.t_end_ns * 1e-9 : this.frames.at(-1)?.t;
    if (t !== undefined) {
      this.flags.forEach(([name, usual], bit) => {
        if (!usual && Math.floor(picture.flags / 2 ** bit) % 2 === 1) this.flagged(name, t);
      });
    }
    for (const event of picture.events) this.note(event);
  }

  /** A flag is up. @param {string} name @param {number} t */
  flagged(name, t) {
    const last = this.up.get(name);
    if (last?.until && t >= last.until && t - last.until < FLAG_S) {
      last.until = t;
      return;
    }
    const told = { t, until: t, told_s: t - (this.lead_s ?? 0), number: -1, text: `flag ${name}`, word: name, fault: name !== "swapped", kind: "FLAG", service: "", stage: "", tick: NONE };
    this.up.set(name, told);
    this.add(told);
  }

  /** The flags that are up and say something bad. @returns {string[]} */
  flagsUp() {
    const t = this.shown()?.t ?? NaN;
    return [...this.up.values()].filter((told) => told.fault && Math.abs(t - (told.until ?? NaN)) < FLAG_S).map((told) => told.word);
  }

  /** @param {Message} event */
  note(event) {
    const told_s = event.t_told_ns * 1e-9;
    if (this.events.some((told) => told.number === event.number && told.told_s === told_s)) return;
    const kind = event.kind.replace("EVENT_KIND_", "");
    const fault = ["ENDED", "GIVEN_UP", "LOST", "NOT_TAKEN", "ABORTED", "REFUSED", "BUS_RENEWED"].includes(kind) && event.why !== ENDED_AS_ASKED;
    const service = event.service === "SERVICE_UNSPECIFIED" ? "" : event.service.replace("SERVICE_", "").toLowerCase();
    const word = `${service} ${kind.toLowerCase().replaceAll("_", " ")}`.trim();
    this.add({ t: this.lead_s === null ? null : told_s + this.lead_s, until: null, told_s, number: event.number, text: say(event, word), word, fault, kind: event.kind, service, stage: event.stage, tick: event.tick });
  }

  /** @param {Told} told */
  add(told) {
    this.events.push(told);
    this.revision += 1;
    if (this.events.length > EVENTS_MAX) this.events.shift();
  }

  /** The times that strips and time line show, s. @returns {[number, number]} */
  window() {
    const newest = this.frames.at(-1)?.t ?? 0;
    if (!this.paused || this.cursor === null) this.end = newest;
    else if (this.cursor > this.end) this.end = this.cursor;
    else if (this.cursor < this.end - this.span_s) this.end = this.cursor + this.span_s;
    return [this.end - this.span_s, this.end];
  }

  /** Shows less or more of the last minute. @param {number} factor */
  zoom(factor) {
    this.span_s = Math.max(2, Math.min(SHOWN_S, this.span_s * factor));
  }

  /** What is looked at. @returns {Frame | null} */
  shown() {
    if (this.cursor !== null) return this.nearest(this.cursor);
    return this.frames.at(-1) ?? null;
  }

  /** The frame at a time of the source. @param {number} t @returns {Frame | null} */
  nearest(t) {
    let [low, high] = [0, this.frames.length - 1];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.frames[middle].t < t) low = middle + 1;
      else high = middle;
    }
    return this.frames[low] ?? null;
  }

  /** Moves the cursor by so many frames, or seconds. @param {number} frames @param {number} seconds */
  step(frames, seconds) {
    const at = this.shown();
    if (!at) return;
    const wanted = seconds ? this.nearest(at.t + seconds) : this.frames[Math.max(0, Math.min(this.frames.length - 1, this.frames.indexOf(at) + frames))];
    if (wanted) this.cursor = wanted.t;
  }

  /** One word, and why. @param {number} now */
  state(now) {
    const { state, why } = this.standing;
    if (this.recording.length) return { word: this.paused ? "paused" : "replay", kind: "live", why: "" };
    if (this.link === "refused") return { word: "no token", kind: "connecting", why: "Looking from here needs a token, and this page has none that is right: open the address that `plumb up` or `plumb view` prints, to its end." };
    if (this.link === "absent") return { word: "no such vehicle", kind: "connecting", why: this.absent };
    if (this.link !== "open") return { word: "connecting", kind: "connecting", why: "The page has no connection to the program that serves it: start it again with `plumb up` or `plumb view`; the page connects by itself." };
    if (state === "STATE_ENDED") return { word: "ended", kind: "ended", why };
    if (state === "STATE_UNCHOSEN") return { word: "choose a vehicle", kind: "paused", why: "" };
    if (state !== "STATE_LIVE" && state !== "STATE_RECORDING") return { word: "connecting", kind: "connecting", why: why ?? "" };
    const age = now - this.came;
    if (age > STALE_MS) {
      const said = Number.isFinite(age) ? `stale ${(age / 1000).toFixed(1)} s` : "no attitude yet";
      return { word: said, kind: "stale", why: "" };
    }
    return { word: this.paused ? "paused" : "live", kind: this.paused ? "paused" : "live", why: "" };
  }
}

/** @param {Message} picture @returns {Float64Array} */
function valuesOf(picture) {
  const values = new Float64Array(2 * QUANTITIES.length).fill(NaN);
  const put = (/** @type {string} */ name, /** @type {number} */ least, /** @type {number} */ most) => {
    if (Number.isFinite(least) && Number.isFinite(most)) values.set([least, most], placeOf(name));
  };
  const one = (/** @type {string} */ name, /** @type {number} */ value) => put(name, value, value);
  for (const { quantity, least, most } of picture.extremes) {
    const name = EXTREMES[/** @type {keyof typeof EXTREMES} */ (quantity)];
    if (name) put(name, least, most);
  }
  const { attitude, fused, accel, gyro } = picture;
  if (attitude) {
    one("yaw_rad", attitude.yaw_rad); one("pitch_rad", attitude.pitch_rad); one("roll_rad", attitude.roll_rad); one("course_rad", attitude.course_rad);
    one("inclination_sd_rad", attitude.inclination_sd_rad);
    if (attitude.course_sd_rad < Math.PI) one("course_sd_rad", attitude.course_sd_rad);
  }
  if (fused?.w) {
    one("u", fused.w.re); one("v", fused.w.im); one("z_rad", fused.z_rad);
    const bias = fused.bias_rad_s;
    if (bias) { one("bias_x_rad_s", bias.x); one("bias_y_rad_s", bias.y); one("bias_z_rad_s", bias.z); }
  }
  if (gyro?.w) { one("u_gyro", gyro.w.re); one("v_gyro", gyro.w.im); one("z_gyro_rad", gyro.z_rad); }
  if (accel?.w) { one("u_accel", accel.w.re); one("v_accel", accel.w.im); }
  for (const difference of picture.differences) if (difference.now_rad) one("difference_rad", difference.now_rad.x);
  return values;
}

/** An event in words. @param {Message} event @param {string} word */
function say(event, word) {
  const stage = event.stage ? ` ${event.stage}` : "";
  const tick = event.tick < NONE && event.tick > 0 ? ` at tick ${event.tick}` : "";
  const why = event.why ? `: ${event.why}` : "";
  return word + stage + tick + why;
}

/** @param {Message | null | undefined} q @returns {Quat | null} */
export const quaternion = (q) => (q ? [q.w, q.x, q.y, q.z] : null);

/** @param {Message | null | undefined} v @returns {Vec | null} */
export const vector = (v) => (v ? [v.x, v.y, v.z] : null);

/** The up vector of a message with a point. @param {Message | null | undefined} message @returns {Vec | null} */
export function upOfPoint(message) {
  return message?.w ? upOf(message.w.re, message.w.im, message.chart === "CHART_INVERTED") : null;
}

/** The attitude of a message with a point and a turn. @param {Message | null | undefined} message @returns {Quat | null} */
export function attitudeOfPoint(message) {
  const up = upOfPoint(message);
  return up && message ? attitudeOf(up, message.z_rad, message.chart === "CHART_INVERTED") : null;
}

/** The attitude of the shadow of a slot: that of the owner, turned by what lies between them. @param {Message} picture @returns {Quat | null} */
export function attitudeOfShadow(picture) {
  const [own, turn] = [quaternion(picture.attitude?.quaternion), quaternion(picture.differences?.[0]?.turn)];
  return own && turn?.every(Number.isFinite) ? product(own, turn) : null;
}

/** The error against the reference of the same tick, rad. @param {Message} picture */
export function errorOf(picture) {
  const [own, truth] = [quaternion(picture.attitude?.quaternion), quaternion(picture.reference?.quaternion)];
  return own && truth && picture.reference.tick === picture.attitude.header.tick ? angleBetween(own, truth) : null;
}
