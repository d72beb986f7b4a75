// What the page knows: the pictures of the last minute or of a recording, the standing, the events, and which moment is looked at.
// It knows topics, time and thinning, and nothing of the document.

import { angleBetween, attitudeOf, upOf } from "./attitude.js";

/** @typedef {import("./wire.js").Message} Message */
/** @typedef {import("./attitude.js").Quat} Quat */
/** @typedef {import("./attitude.js").Vec} Vec */
/** What is kept of a picture: the quantities of the strips as [least, most].
 * @typedef {{ t: number, number: number, picture: Message, values: Record<string, [number, number]> }} Frame */
/** @typedef {{ t: number, text: string, fault: boolean, kind: string, service: string, tick: number }} Told */

export const SHOWN_S = 60;
const FRAMES_MAX = 3000;
const EVENTS_MAX = 300;
/** After so long without a picture with an attitude what is shown is old, ms. */
export const STALE_MS = 400;
const NONE = 2 ** 53;

const EXTREMES = {
  QUANTITY_FORCE_M_S2: "force", QUANTITY_FIELD_UT: "field", QUANTITY_RATE_X_RAD_S: "rate_x", QUANTITY_RATE_Y_RAD_S: "rate_y",
  QUANTITY_RATE_Z_RAD_S: "rate_z", QUANTITY_INNOVATION_RAD: "innovation", QUANTITY_ERROR_RAD: "error", QUANTITY_LATENCY_S: "latency",
};

export class Data {
  constructor() {
    /** @type {Frame[]} */ this.frames = [];
    /** @type {Message} */ this.standing = {};
    /** @type {Told[]} */ this.events = [];
    /** @type {Message | null} */ this.answer = null;
    /** The newest of each message, as long as it is worth showing. @type {Message} */ this.newest = {};
    /** The frame that is looked at; null: the newest. @type {number | null} */ this.cursor = null;
    this.paused = false;
    /** The connection: "connecting", "open", "closed", "refused". */ this.link = "connecting";
    this.came = -Infinity;
    /** Pictures of a recording. @type {Message[]} */ this.recording = [];
    this.place = 0;
    this.bytes = 0;
  }

  /** Forgets what was seen: another vehicle is looked at. */
  clear() {
    this.frames.length = 0;
    this.events.length = 0;
    this.standing = {};
    this.newest = {};
    this.answer = null;
    this.cursor = null;
    this.paused = false;
    this.came = -Infinity;
  }

  /** Takes a picture. @param {Message} picture @param {number} now */
  take(picture, now) {
    for (const event of picture.events) this.note(event);
    if (picture.t_made_ns === 0 && !picture.attitude && !picture.imu) return;
    for (const name of ["imu", "mag", "gnss", "gyro", "accel", "fused", "attitude", "reference"]) {
      if (picture[name]) this.newest[name] = picture[name];
    }
    if (picture.attitude) this.came = now;
    const header = (picture.attitude ?? picture.imu)?.header;
    if (!header) return;
    const frame = { t: header.t_end_ns * 1e-9, number: picture.number, picture: { ...this.newest, differences: picture.differences }, values: valuesOf(picture) };
    const last = this.frames.at(-1);
    // A source that begins anew begins the strips anew.
    if (last && frame.t < last.t - 1) this.frames.length = 0;
    this.frames.push(frame);
    if (!this.paused) {
      while (this.frames.length > FRAMES_MAX || (this.frames.length > 1 && this.frames[0].t < frame.t - SHOWN_S)) this.frames.shift();
    } else if (this.frames.length > 2 * FRAMES_MAX) {
      this.frames.splice(0, FRAMES_MAX);
    }
  }

  /** @param {Message} event */
  note(event) {
    if (this.events.some((told) => told.tick === event.tick && told.kind === event.kind && told.text === say(event))) return;
    const kind = event.kind.replace("EVENT_KIND_", "");
    const fault = ["ENDED", "GIVEN_UP", "LOST", "NOT_TAKEN", "ABORTED", "REFUSED", "BUS_RENEWED"].includes(kind);
    const service = event.service.replace("SERVICE_", "").toLowerCase();
    this.events.push({ t: event.t_told_ns * 1e-9, text: say(event), fault, kind: event.kind, service: service === "unspecified" ? "" : service, tick: event.tick });
    if (this.events.length > EVENTS_MAX) this.events.shift();
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

/** The quantities of the strips. @param {Message} picture @returns {Record<string, [number, number]>} */
function valuesOf(picture) {
  /** @type {Record<string, [number, number]>} */
  const values = {};
  const one = (/** @type {string} */ name, /** @type {number} */ value) => { if (Number.isFinite(value)) values[name] = [value, value]; };
  for (const { quantity, least, most } of picture.extremes) {
    const name = EXTREMES[/** @type {keyof typeof EXTREMES} */ (quantity)];
    if (name) values[name] = [least, most];
  }
  const { attitude, fused, accel, gyro } = picture;
  if (attitude) {
    one("yaw", attitude.yaw_rad); one("pitch", attitude.pitch_rad); one("roll", attitude.roll_rad); one("course", attitude.course_rad);
    one("inclination_sd", attitude.inclination_sd_rad);
    if (attitude.course_sd_rad < Math.PI) one("course_sd", attitude.course_sd_rad);
  }
  if (fused?.w) {
    one("u", fused.w.re); one("v", fused.w.im); one("z", fused.z_rad);
    const bias = fused.bias_rad_s;
    if (bias) { one("bias_x", bias.x); one("bias_y", bias.y); one("bias_z", bias.z); }
  }
  if (gyro?.w) { one("u_gyro", gyro.w.re); one("v_gyro", gyro.w.im); one("z_gyro", gyro.z_rad); }
  if (accel?.w) { one("u_accel", accel.w.re); one("v_accel", accel.w.im); }
  for (const difference of picture.differences) if (difference.now_rad) one("difference", difference.now_rad.x);
  return values;
}

/** An event in words. @param {Message} event */
function say(event) {
  const kind = event.kind.replace("EVENT_KIND_", "").toLowerCase().replaceAll("_", " ");
  const service = event.service === "SERVICE_UNSPECIFIED" ? "" : event.service.replace("SERVICE_", "").toLowerCase() + " ";
  const stage = event.stage ? ` ${event.stage}` : "";
  const tick = event.tick < NONE && event.tick > 0 ? ` at tick ${event.tick}` : "";
  const why = event.why ? `: ${event.why}` : "";
  return `${service}${kind}${stage}${tick}${why}`;
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

/** The error against the reference of the same tick, rad. @param {Message} picture */
export function errorOf(picture) {
  const [own, truth] = [quaternion(picture.attitude?.quaternion), quaternion(picture.reference?.quaternion)];
  return own && truth && picture.reference.tick === picture.attitude.header.tick ? angleBetween(own, truth) : null;
}
