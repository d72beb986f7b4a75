// Sensors view: plausibility of the input, calibration and mounting check.

import { DEGREE } from "./attitude.js";
import { Calibration } from "./calibration.js";
import { vector } from "./data.js";
import { element, fillTable, section, table, write } from "./ui.js";
import { Mounting } from "./mounting.js";
import { Strips, axisLines, line, signed } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */

/** Age above which values are greyed out, s; fixes arrive about once a second. */
const MAX_AGE_S = 0.5, MAX_FIX_AGE_S = 2.5;

/** @type {[string, string][]} */
const COLUMNS = [["sensor", ""], ["x", "number"], ["y", "number"], ["z", "number"], ["magnitude", "number"], ["age", "number"], ["expected", ""]];

export class Sensors {
  /** @param {HTMLElement} parent @param {Data} data @param {import("./wire.js").SendCommand} sendCommand */
  constructor(parent, data, sendCommand) {
    this.data = data;
    this.values = element("tbody", "");
    this.flags = element("p", "");
    this.warnings = element("div", "");
    const strips = element("div", "panel tall");
    const [calibration, mounting] = [section("Calibration"), section("Mounting check")];
    this.unit = element("div", "columns", calibration, mounting);
    parent.replaceChildren(
      element("div", "columns",
        section("Latest samples, body axes: right, forward, up", table("samples", COLUMNS, this.values), element("h3", "", "Flags of the latest sample"), this.flags),
        section("Input checks", this.warnings)),
      strips,
      this.unit);
    this.calibration = new Calibration(calibration, data, sendCommand);
    this.mounting = new Mounting(mounting, data);
    this.scene = this.calibration.scene;
    this.strips = new Strips(strips, data, "sensors", [
      { title: "force", unit: "m/s²", scale: 1, digits: 2, least: 0, lines: [line("force_m_s2", "magnitude", "accel")] },
      { title: "field", unit: "µT", scale: 1, digits: 1, least: 0, optional: true, lines: [line("field_ut", "magnitude", "field")] },
      { title: "rate", unit: "°/s", scale: 1 / DEGREE, digits: 1, lines: axisLines("rate", "rad_s") },
    ]);
    /** Content shown, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  draw() {
    const snapshot = this.data.shown()?.snapshot ?? {};
    const [rate, force, field, velocity] = [vector(snapshot.imu?.rate_rad_s), vector(snapshot.imu?.force_m_s2), vector(snapshot.mag?.field_ut), vector(snapshot.gnss?.velocity_m_s)];
    const now_s = this.data.shown()?.t ?? 0;
    const age_s = (/** @type {import("./wire.js").Message | null | undefined} */ message) => (message ? now_s - message.header.t_end_ns * 1e-9 : NaN);
    const ages_s = [age_s(snapshot.imu), age_s(snapshot.imu), age_s(snapshot.mag), age_s(snapshot.gnss)];
    const row = (/** @type {string} */ name, /** @type {number[] | null} */ v, /** @type {number} */ scale, /** @type {number} */ digits, /** @type {number} */ age_s, /** @type {string} */ expected) => {
      const cell = (/** @type {number} */ x) => (Number.isFinite(x) ? signed(x * scale, digits) : "–");
      return [name, ...(v ? [...v.map(cell), (Math.hypot(...v) * scale).toFixed(digits)] : ["–", "–", "–", "–"]), v ? `${Math.max(0, age_s).toFixed(1)} s` : "–", v ? expected : "no data"];
    };
    fillTable(this.values, [
      row("angular rate, °/s", rate, 1 / DEGREE, 2, ages_s[0], "≈ 0 at rest"),
      row("specific force, m/s²", force, 1, 3, ages_s[1], "9.81 upwards at rest"),
      row("magnetic field, µT", field, 1, 1, ages_s[2], "25 to 65"),
      row("velocity, m/s (east, north, up)", velocity, 1, 2, ages_s[3], "vehicle speed"),
    ], [...COLUMNS.slice(0, -1).map(([, className]) => className), "c-quiet"]);
    const isPresent = [true, true, this.data.newest.mag, this.data.newest.gnss];
    ages_s.forEach((age_s, at) => {
      const row = /** @type {HTMLElement} */ (this.values.children[at]);
      row.classList.toggle("old", age_s > (at === 3 ? MAX_FIX_AGE_S : MAX_AGE_S));
      row.hidden = !isPresent[at];
    });
    const flags = snapshot.imu ? this.data.flags.filter((_, bit) => Math.floor(snapshot.imu.header.flags / 2 ** bit) % 2 === 1).map(([name]) => name) : [];
    write(this.flags, flags.length ? flags.join(", ") : "none");
    const warnings = [...(this.data.systemStatus.warnings ?? [])];
    for (const { status } of this.data.systemStatus.services ?? []) for (const diagnostic of status?.diagnostics ?? []) warnings.push(`${status.service}: ${diagnostic.found}\n${diagnostic.remedy}`);
    const isRecording = this.data.recording.length > 0;
    this.unit.hidden = isRecording;
    this.calibration.draw();
    this.mounting.draw();
    this.drawn = { force_m_s2: force, rate_rad_s: rate, flags, warnings, calibration: this.calibration.drawn, mounting: this.mounting.drawn };
    const empty = isRecording ? "The input of a recording is not checked here. `plumb score` checks it." : "No problems found. `plumb doctor` also checks the machine.";
    const shown = warnings.join("\n") || empty;
    if (this.warnings.dataset.shown !== shown) {
      this.warnings.dataset.shown = shown;
      this.warnings.replaceChildren(...(warnings.length ? warnings.map((text) => element("p", "warning", text)) : [element("p", "c-quiet", empty)]));
    }
    this.strips.draw();
  }
}
