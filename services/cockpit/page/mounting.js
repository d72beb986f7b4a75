// Mounting check: held level, then nose down, the body must feel up where it is. It needs two poses of the body and no calibration.

import { DEGREE } from "./attitude.js";
import { placeOf, upOfPoint } from "./data.js";
import { element, write } from "./look.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./attitude.js").Vec} Vec */

/** A pose lasts so long, s. */
const POSE_S = 2;
/** Turning slower than this on each axis, the body is still, rad/s. */
const STILL_RAD_S = 5 * DEGREE;
/** The nose is to go down by so much at least, and at most. */
const DOWN = [20 * DEGREE, 150 * DEGREE];
/** What a hand cannot hold better. */
const GOOD = 10 * DEGREE;
/** Where up is felt, by the axis of the body that it is along. */
const SIDES = [["right", "left"], ["nose", "tail"], ["top", "bottom"]];

export class Mounting {
  /** @param {HTMLElement} place @param {Data} data */
  constructor(place, data) {
    this.data = data;
    this.button = /** @type {HTMLButtonElement} */ (element("button", "", "Check"));
    this.button.id = "mounting";
    this.button.type = "button";
    this.button.addEventListener("click", () => { this.step = "level"; this.level = null; this.gyro = null; this.since = null; this.verdict = ""; });
    this.words = element("p", "");
    this.words.id = "mounting-says";
    this.words.setAttribute("role", "status");
    place.append(element("div", "actions", this.button), this.words);
    /** "" | "level" | "nose down" | "done" */ this.step = "";
    /** @type {Vec | null} */ this.level = null;
    /** Up by the gyro alone in the level pose. @type {Vec | null} */ this.gyro = null;
    /** Since when the pose is held, s. @type {number | null} */ this.since = null;
    this.verdict = "";
    this.right = true;
    /** What is drawn, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  draw() {
    const frame = this.data.frames.at(-1);
    const up = upOfPoint(frame?.picture.accel), gyro = upOfPoint(frame?.picture.gyro);
    if (frame && up && this.step && this.step !== "done" && this.data.state(performance.now()).kind === "live") this.look(frame, up, gyro);
    this.drawn = { step: this.step, verdict: this.verdict, right: this.right };
    const held = this.since === null || !frame ? "" : ` Held for ${(frame.t - this.since).toFixed(1)} s.`;
    const text = this.step === "level" ? `Hold the body level and still.${held} ${up ? felt(up) : ""}`
      : this.step === "nose down" ? `Now turn the nose down, by 20° to 90° and without roll, and hold it still.${held} ${up ? felt(up) : ""}`
      : this.step === "done" ? this.verdict
      : "Whether the unit sits in the body as the launch file says: hold the body level, then nose down.";
    write(this.words, text);
    this.words.className = this.step !== "done" ? "" : this.right ? "c-field" : "c-fault";
  }

  /** @param {import("./data.js").Frame} frame @param {Vec} up @param {Vec | null} gyro */
  look(frame, up, gyro) {
    const still = ["rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"].every((name) => [0, 1].every((most) => Math.abs(frame.values[placeOf(name) + most]) < STILL_RAD_S));
    const apart = this.level ? angle(this.level, up) : 0;
    if (!still || (this.level && (apart < DOWN[0] || apart > DOWN[1]))) { this.since = null; return; }
    if (this.since !== null && frame.t < this.since) this.since = null;
    this.since ??= frame.t;
    if (frame.t - this.since < POSE_S) return;
    this.since = null;
    if (!this.level) {
      [this.level, this.gyro, this.step] = [up, gyro, "nose down"];
      return;
    }
    this.step = "done";
    this.judge(this.level, up, gyro);
  }

  /** @param {Vec} level @param {Vec} down @param {Vec | null} gyro */
  judge(level, down, gyro) {
    const tilt = angle(level, [0, 0, 1]);
    // Across the level up, the nose-down up is towards the tail.
    const back = /** @type {Vec} */ (down.map((part, i) => part - level[i] * dot(level, down)));
    const off = Math.atan2(back[0], -back[1]);
    const said = [];
    if (tilt > GOOD) said.push(`held level, the body feels up towards its ${side(level)}, ${deg(tilt)} from its top`);
    else if (Math.abs(off) > GOOD) said.push(`nose down, its ${side(back)} rises, not its tail: the unit is turned by ${deg(Math.abs(off))} about the vertical`);
    const { gyro: before } = this;
    if (before && gyro) {
      // From pose to pose the gyro alone must see the same turn.
      const seen = /** @type {Vec} */ (gyro.map((part, i) => part - before[i]));
      const felt = /** @type {Vec} */ (down.map((part, i) => part - level[i]));
      if (dot(seen, felt) < 0.5 * dot(felt, felt)) said.push("the gyro saw another turn than the accelerometer: its axes or signs differ");
    }
    this.right = !said.length;
    this.verdict = this.right ? `The mounting is right: level within ${deg(tilt)}, the nose within ${deg(Math.abs(off))}.`
      : `The mounting is wrong: ${said.join("; ")}. Calibrate “mounting” above, or correct [ingest.mounting].`;
  }
}

const dot = (/** @type {Vec} */ a, /** @type {Vec} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const angle = (/** @type {Vec} */ a, /** @type {Vec} */ b) => Math.acos(Math.max(-1, Math.min(1, dot(a, b))));
const deg = (/** @type {number} */ rad) => `${(rad / DEGREE).toFixed(1)}°`;

/** The side of the body next to a direction. @param {Vec} v */
function side(v) {
  const axis = [0, 1, 2].reduce((most, i) => (Math.abs(v[i]) > Math.abs(v[most]) ? i : most), 0);
  return SIDES[axis][v[axis] < 0 ? 1 : 0];
}

/** @param {Vec} up */
const felt = (up) => `Up is felt ${deg(angle(up, [0, 0, 1]))} from the top.`;
