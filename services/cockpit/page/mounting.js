// Mounting check: compares the measured up vector with the one expected in two poses, level and nose down. It needs no calibration.

import { DEGREE } from "./attitude.js";
import { upOfPoint, valueIndex } from "./data.js";
import { button, element, statusLine, write } from "./ui.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./attitude.js").Vec} Vec */

/** Time for which a pose must be held, s. */
const POSE_S = 2;
/** Rate below which the body counts as still, each axis, rad/s. */
const MAX_STILL_RATE_RAD_S = 5 * DEGREE;
/** Minimum and maximum angle between the two poses, rad. */
const NOSE_DOWN_RAD = [20 * DEGREE, 150 * DEGREE];
/** Tolerance for poses held by hand, rad. */
const TOLERANCE_RAD = 10 * DEGREE;
/** Sides of the body by axis, positive side first. */
const SIDES = [["right", "left"], ["nose", "tail"], ["top", "bottom"]];

export class Mounting {
  /** @param {HTMLElement} parent @param {Data} data */
  constructor(parent, data) {
    this.data = data;
    this.button = button("mounting", "Start", () => { this.step = "level"; this.level = null; this.gyro = null; this.held_since = null; this.verdict = ""; });
    this.message = statusLine("mounting-message");
    parent.append(element("div", "actions", this.button), this.message);
    /** "" | "level" | "nose down" | "done" */ this.step = "";
    /** Up vector of the accelerometer in the level pose. @type {Vec | null} */ this.level = null;
    /** Up vector of the gyro in the level pose. @type {Vec | null} */ this.gyro = null;
    /** Time since which the pose is held, s. @type {number | null} */ this.held_since = null;
    this.verdict = "";
    this.correct = true;
    /** Content shown, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  draw() {
    const frame = this.data.frames.at(-1);
    const up = upOfPoint(frame?.snapshot.accel), gyro = upOfPoint(frame?.snapshot.gyro);
    if (frame && up && this.step && this.step !== "done" && this.data.state(performance.now()).kind === "live") this.update(frame, up, gyro);
    this.drawn = { step: this.step, verdict: this.verdict, correct: this.correct };
    const held = this.held_since === null || !frame ? "" : ` Held for ${(frame.t - this.held_since).toFixed(1)} s.`;
    const text = this.step === "level" ? `Hold the body level and still.${held} ${up ? measuredUp(up) : ""}`
      : this.step === "nose down" ? `Now turn the nose down by 20° to 90°, without roll, and hold it still.${held} ${up ? measuredUp(up) : ""}`
      : this.step === "done" ? this.verdict
      : "Checks the mounting of the unit against the launch file. Hold the body level, then nose down.";
    write(this.message, text);
    this.message.className = this.step !== "done" ? "" : this.correct ? "c-field" : "c-fault";
  }

  /** Advances to the next step once the pose has been held. @param {import("./data.js").Frame} frame @param {Vec} up @param {Vec | null} gyro */
  update(frame, up, gyro) {
    const still = ["rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"].every((name) => [0, 1].every((offset) => Math.abs(frame.values[valueIndex(name) + offset]) < MAX_STILL_RATE_RAD_S));
    const rotated_rad = this.level ? angle(this.level, up) : 0;
    if (!still || (this.level && (rotated_rad < NOSE_DOWN_RAD[0] || rotated_rad > NOSE_DOWN_RAD[1]))) { this.held_since = null; return; }
    if (this.held_since !== null && frame.t < this.held_since) this.held_since = null;
    this.held_since ??= frame.t;
    if (frame.t - this.held_since < POSE_S) return;
    this.held_since = null;
    if (!this.level) {
      [this.level, this.gyro, this.step] = [up, gyro, "nose down"];
      return;
    }
    this.step = "done";
    this.evaluate(this.level, up, gyro);
  }

  /** Sets the verdict from the up vectors of the two poses. @param {Vec} level @param {Vec} down @param {Vec | null} gyro */
  evaluate(level, down, gyro) {
    const tilt = angle(level, [0, 0, 1]);
    // Nose down, the component of up across the level up vector points to the tail.
    const back = /** @type {Vec} */ (down.map((part, i) => part - level[i] * dot(level, down)));
    const yaw_rad = Math.atan2(back[0], -back[1]);
    const faults = [];
    if (tilt > TOLERANCE_RAD) faults.push(`in the level pose, up points to the ${side(level)} of the body, ${deg(tilt)} from its top`);
    else if (Math.abs(yaw_rad) > TOLERANCE_RAD) faults.push(`in the nose-down pose, the ${side(back)} rises instead of the tail: the unit is rotated by ${deg(Math.abs(yaw_rad))} about the vertical`);
    const { gyro: gyroLevel } = this;
    if (gyroLevel && gyro) {
      // The gyro must measure the same rotation between the poses as the accelerometer.
      const byGyro = /** @type {Vec} */ (gyro.map((part, i) => part - gyroLevel[i]));
      const byAccel = /** @type {Vec} */ (down.map((part, i) => part - level[i]));
      if (dot(byGyro, byAccel) < 0.5 * dot(byAccel, byAccel)) faults.push("gyro and accelerometer measured different rotations: their axes or signs differ");
    }
    this.correct = !faults.length;
    this.verdict = this.correct ? `Mounting correct: level within ${deg(tilt)}, nose within ${deg(Math.abs(yaw_rad))}.`
      : `Mounting wrong: ${faults.join("; ")}. Run the calibration “mounting” above, or correct [ingest.mounting].`;
  }
}

const dot = (/** @type {Vec} */ a, /** @type {Vec} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const angle = (/** @type {Vec} */ a, /** @type {Vec} */ b) => Math.acos(Math.max(-1, Math.min(1, dot(a, b))));
const deg = (/** @type {number} */ rad) => `${(rad / DEGREE).toFixed(1)}°`;

/** Returns the side of the body closest to a direction. @param {Vec} v */
function side(v) {
  const axis = [0, 1, 2].reduce((largest, i) => (Math.abs(v[i]) > Math.abs(v[largest]) ? i : largest), 0);
  return SIDES[axis][v[axis] < 0 ? 1 : 0];
}

/** @param {Vec} up */
const measuredUp = (up) => `The measured up vector is ${deg(angle(up, [0, 0, 1]))} from the top of the body.`;
