// Calibration of the sensors: instructions, progress and result.

import { button, element, select, statusLine, tint, write } from "./ui.js";
import { Scene } from "./scene.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./attitude.js").Vec} Vec */

/** Title and instructions of each calibration, in the recommended order. @type {Record<string, [string, string]>} */
const KINDS = {
  gyro: ["gyro: bias", "Warm up the unit, then leave it still for five seconds."],
  accel: ["accelerometer: bias and scale", "Place the unit at rest on each of its six sides for two seconds, or rotate it slowly by hand through all orientations for two minutes."],
  mag: ["magnetometer: hard and soft iron", "Rotate the unit about all axes for about a minute, in one place and away from iron."],
  mounting: ["mounting", "Hold the body level and still for two seconds, then nose down by 20° to 90°, without roll, for two seconds."],
  clock: ["clock: delay of the magnetometer", "Rotate the unit back and forth about all axes, once or twice a second, for half a minute."],
};
/** Number of facets along the edge of a sector of the sphere. */
const FACETS = 3;

export class Calibration {
  /** @param {HTMLElement} parent @param {Data} data @param {import("./wire.js").SendCommand} sendCommand */
  constructor(parent, data, sendCommand) {
    this.data = data;
    this.sendCommand = sendCommand;
    this.kind = select("calibration-kind", Object.entries(KINDS).map(([name, [title]]) => [name, title]));
    this.start = button("calibrate", "Start", () => this.command(this.kind.value));
    this.cancel = button("calibrate-cancel", "Cancel", () => this.command(""));
    this.bar = element("progress", "");
    this.bar.max = 1;
    this.progress = element("span", "number");
    this.message = statusLine("coverage");
    this.report = element("pre", "");
    this.report.id = "report";
    this.copy = button("copy-report", "Copy", () => void navigator.clipboard.writeText(this.report.textContent ?? ""));
    this.apply = button("apply", "Apply to the launch file", () => this.applyResult());
    this.applied = statusLine("applied");
    this.sphere = element("div", "panel sphere");
    parent.append(
      element("div", "actions", element("label", "", "calibration ", this.kind), this.start, this.cancel, this.bar, this.progress),
      this.message, this.sphere, this.report, element("div", "actions", this.copy, this.apply, this.applied));
    this.scene = new Scene(this.sphere, 4.6);
    this.sendError = "";
    /** Key of the content shown last. */ this.shownKey = "";
    /** Calibration shown last. */ this.shownWhat = "";
    /** Content shown, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  /** @param {string} kind Calibration to start; empty to cancel. */
  command(kind) {
    this.data.calibrationError = "";
    this.sendError = this.sendCommand({ kind: "KIND_CALIBRATE", what: kind }, ({ reason }) => { this.data.calibrationError = reason; }) ?? "";
  }

  /** Writes the result into the launch file of the system. */
  applyResult() {
    const show = (/** @type {string} */ error) => {
      this.applied.className = error ? "c-fault" : "c-field";
      write(this.applied, error || "Written to the launch file. Restart the system to use it.");
    };
    const error = this.sendCommand({ kind: "KIND_APPLY", what: this.data.calibration?.what }, ({ reason }) => show(reason));
    if (error) show(error);
  }

  draw() {
    const { systemStatus, calibration, calibrationError } = this.data;
    const error = this.sendError || calibrationError;
    const sectors = calibration?.parts ?? [];
    this.drawn = { what: calibration?.what ?? "", share: calibration?.share ?? 0, missing: calibration?.missing ?? [], covered: sectors.filter(Boolean).length, report: calibration?.report ?? "", error };
    this.start.disabled = !systemStatus.accepts_commands;
    this.cancel.disabled = !calibration || !!calibration.report;
    this.bar.hidden = this.progress.hidden = !calibration;
    this.bar.value = calibration?.share ?? 0;
    this.sphere.hidden = !sectors.length;
    this.report.hidden = this.copy.hidden = this.apply.hidden = this.applied.hidden = !calibration?.report;
    if (calibration && calibration.what !== this.shownWhat) this.kind.value = calibration.what;
    this.shownWhat = calibration?.what ?? "";
    const key = JSON.stringify([calibration?.what, calibration?.share, calibration?.found, calibration?.missing, calibration?.report, error, this.kind.value]);
    if (key !== this.shownKey) {
      this.shownKey = key;
      this.message.className = error ? "c-fault" : "";
      write(this.progress, calibration ? `${KINDS[calibration.what]?.[0] ?? calibration.what}: ${Math.floor(100 * calibration.share)} %` : "");
      write(this.report, calibration?.report ?? "");
      write(this.applied, "");
      this.message.replaceChildren(...(error ? [error]
        : !calibration ? [`${KINDS[this.kind.value][1]} Recommended order: gyro, accelerometer, magnetometer, mounting, clock.`]
        : calibration.report ? ["Done. Apply this to the launch file, or copy it there, and restart the system."]
        : [`Collected: ${calibration.found}.`, ...calibration.missing.map((/** @type {string} */ item) => element("span", "missing", `Still needed: ${item}.`))]));
    }
    if (sectors.length) this.drawSphere(sectors, calibration?.direction);
  }

  /** @param {boolean[]} sectors `true` for each covered sector @param {import("./wire.js").Message | null} direction */
  drawSphere(sectors, direction) {
    const { scene } = this;
    scene.begin();
    sectors.forEach((covered, sector) => {
      const at = (/** @type {number} */ i, /** @type {number} */ j) => onSphere(sector, i / FACETS, j / FACETS);
      for (let i = 0; i < FACETS; i++) {
        for (let j = 0; j < FACETS; j++) {
          for (const [b, c] of /** @type {[Vec, Vec][]} */ ([[at(i + 1, j), at(i + 1, j + 1)], [at(i + 1, j + 1), at(i, j + 1)]])) scene.triangle(at(i, j), b, c, tint(covered ? "field" : "line"));
        }
      }
      const edge = [...Array(FACETS + 1).keys()];
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
      scene.label(at(1.5), "current", "c-fault");
    }
    scene.end();
  }
}

/** Returns a point of a sector of the sphere; i and j run from the middle of its cube face, 0, to the edge, 1. @param {number} sector @param {number} i @param {number} j @returns {Vec} */
function onSphere(sector, i, j) {
  const [face, quadrant] = [Math.floor(sector / 4), sector % 4];
  const axis = Math.floor(face / 2);
  const v = [0, 0, 0];
  v[axis] = face % 2 ? -1 : 1;
  v[(axis + 1) % 3] = quadrant & 2 ? -i : i;
  v[(axis + 2) % 3] = quadrant & 1 ? -j : j;
  const length = Math.hypot(...v);
  return [v[0] / length, v[1] / length, v[2] / length];
}
