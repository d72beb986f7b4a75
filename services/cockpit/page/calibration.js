// Calibration of the sensors: what there is and what is still missing, while the unit is turned; and what was found.

import { element, tint, write } from "./look.js";
import { Scene } from "./scene.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./attitude.js").Vec} Vec */
/** @typedef {(command: { kind: string, what: string }) => string | null} Ask Sends a command; why not, where it cannot. */

/** What can be calibrated, in the order in which it is done, and what to do for it. @type {Record<string, [string, string]>} */
const KINDS = {
  gyro: ["gyro: bias", "Leave the unit alone for five seconds, warm."],
  accel: ["accelerometer: bias and scale", "Let the unit rest for two seconds with each of its six sides up; or turn it slowly by hand through all positions for two minutes."],
  mag: ["magnetometer: hard and soft iron", "Turn the unit in one place, far from iron, about all axes, for a minute or so."],
  mounting: ["mounting", "Hold the body level and still for two seconds, then nose down by 20° to 90°, without roll, for two seconds."],
  clock: ["clock: the magnetometer's delay", "Turn the unit to and fro about all axes, once or twice a second, for half a minute."],
};
/** Pieces along an edge of a part of the sphere. */
const PIECES = 3;

export class Calibration {
  /** @param {HTMLElement} place @param {Data} data @param {Ask} ask */
  constructor(place, data, ask) {
    this.data = data;
    this.ask = ask;
    this.what = /** @type {HTMLSelectElement} */ (element("select", "", ...Object.entries(KINDS).map(([name, [title]]) => {
      const option = /** @type {HTMLOptionElement} */ (element("option", "", title));
      option.value = name;
      return option;
    })));
    this.what.id = "calibrated";
    const button = (/** @type {string} */ id, /** @type {string} */ text, /** @type {() => void} */ act) => {
      const made = /** @type {HTMLButtonElement} */ (element("button", "", text));
      made.id = id;
      made.type = "button";
      made.addEventListener("click", act);
      return made;
    };
    this.begin = button("calibrate", "Begin", () => this.command(this.what.value));
    this.end = button("calibrate-end", "End", () => this.command(""));
    this.bar = /** @type {HTMLProgressElement} */ (element("progress", ""));
    this.bar.max = 1;
    this.share = element("span", "number");
    this.words = element("p", "");
    this.words.id = "coverage";
    this.words.setAttribute("role", "status");
    this.report = element("pre", "");
    this.report.id = "report";
    this.copy = button("copy-report", "Copy", () => void navigator.clipboard.writeText(this.report.textContent ?? ""));
    this.sphere = element("div", "panel sphere");
    place.append(
      element("div", "actions", element("label", "", "calibrate ", this.what), this.begin, this.end, this.bar, this.share),
      this.words, this.sphere, this.report, this.copy);
    this.scene = new Scene(this.sphere, 3.7);
    this.refused = "";
    this.said = "";
    /** What is drawn, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  /** @param {string} what */
  command(what) {
    this.data.refusal = "";
    this.refused = this.ask({ kind: "KIND_CALIBRATE", what }) ?? "";
  }

  draw() {
    const { standing, calibration, refusal } = this.data;
    const refused = this.refused || refusal;
    const parts = calibration?.parts ?? [];
    this.drawn = { what: calibration?.what ?? "", share: calibration?.share ?? 0, missing: calibration?.missing ?? [], covered: parts.filter(Boolean).length, report: calibration?.report ?? "", refused };
    this.begin.disabled = !standing.takes_commands;
    this.end.disabled = !calibration || !!calibration.report;
    this.bar.hidden = this.share.hidden = !calibration;
    this.bar.value = calibration?.share ?? 0;
    this.sphere.hidden = !parts.length;
    this.report.hidden = this.copy.hidden = !calibration?.report;
    const said = JSON.stringify([calibration?.what, calibration?.share, calibration?.found, calibration?.missing, calibration?.report, refused, this.what.value]);
    if (said !== this.said) {
      this.said = said;
      this.words.className = refused ? "c-fault" : "";
      write(this.share, calibration ? `${KINDS[calibration.what]?.[0] ?? calibration.what}: ${Math.floor(100 * calibration.share)} %` : "");
      write(this.report, calibration?.report ?? "");
      this.words.replaceChildren(...(refused ? [refused]
        : !calibration ? [`${KINDS[this.what.value][1]} The order is gyro, accelerometer, magnetometer, mounting, clock.`]
        : calibration.report ? ["Found; put the piece into launch.toml, and start the system again."]
        : [`So far ${calibration.found}.`, ...calibration.missing.map((/** @type {string} */ what) => element("span", "missing", `Missing: ${what}.`))]));
    }
    if (parts.length) this.drawSphere(parts, calibration?.direction);
  }

  /** @param {boolean[]} parts @param {import("./wire.js").Message | null} direction */
  drawSphere(parts, direction) {
    const { scene } = this;
    scene.begin();
    parts.forEach((covered, part) => {
      const at = (/** @type {number} */ i, /** @type {number} */ j) => onSphere(part, i / PIECES, j / PIECES);
      for (let i = 0; i < PIECES; i++) {
        for (let j = 0; j < PIECES; j++) {
          for (const [b, c] of /** @type {[Vec, Vec][]} */ ([[at(i + 1, j), at(i + 1, j + 1)], [at(i + 1, j + 1), at(i, j + 1)]])) scene.triangle(at(i, j), b, c, tint(covered ? "field" : "line"));
        }
      }
      const edge = [...Array(PIECES + 1).keys()];
      for (const line of [edge.map((i) => at(i, 0)), edge.map((i) => at(0, i))]) scene.line(line.map((p) => /** @type {Vec} */ (p.map((x) => x * 1.01))), tint("paper"), 1);
    });
    for (const [axis, name] of ["x", "y", "z"].entries()) {
      for (const sign of [1, -1]) scene.label(/** @type {Vec} */ ([0, 1, 2].map((i) => (i === axis ? 1.25 * sign : 0))), `${sign > 0 ? "+" : "−"}${name}`, `c-${name}`);
    }
    const v = direction ? [direction.x, direction.y, direction.z] : [];
    const length = Math.hypot(...v);
    if (length > 0) {
      const at = (/** @type {number} */ size) => /** @type {Vec} */ (v.map((x) => (x / length) * size));
      scene.line([at(1.02), at(1.35)], tint("fault"), 2);
      scene.point(at(1.02), tint("fault"), 5);
      scene.label(at(1.5), "now", "c-fault");
    }
    scene.end();
  }
}

/** A point of a part of the sphere: from the middle of its face to the corner. @param {number} part @param {number} i @param {number} j @returns {Vec} */
function onSphere(part, i, j) {
  const [face, quadrant] = [Math.floor(part / 4), part % 4];
  const axis = Math.floor(face / 2);
  const v = [0, 0, 0];
  v[axis] = face % 2 ? -1 : 1;
  v[(axis + 1) % 3] = quadrant & 2 ? -i : i;
  v[(axis + 2) % 3] = quadrant & 1 ? -j : j;
  const length = Math.hypot(...v);
  return [v[0] / length, v[1] / length, v[2] / length];
}
