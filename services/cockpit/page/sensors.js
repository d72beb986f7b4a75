// Sensors: whether what comes in is sane.

import { DEGREE } from "./attitude.js";
import { Calibration } from "./calibration.js";
import { vector } from "./data.js";
import { element, rows, write } from "./look.js";
import { Mounting } from "./mounting.js";
import { Strips, signed } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */

/** What is older is grey, s: samples, and fixes, of which there is one a second. */
const OLD_S = 0.5, GNSS_OLD_S = 2.5;

export class Sensors {
  /** @param {HTMLElement} place @param {Data} data @param {import("./calibration.js").Ask} ask */
  constructor(place, data, ask) {
    this.data = data;
    this.values = element("tbody", "");
    this.flags = element("p", "");
    this.warnings = element("div", "");
    const strips = element("div", "panel tall");
    const [calibration, mounting] = [element("section", "", element("h2", "", "Calibration")), element("section", "", element("h2", "", "Mounting check"))];
    const head = element("thead", "", element("tr", "", ...["sensor", "x", "y", "z", "length", "age", "expected"].map((name) => element("th", name === "sensor" || name === "expected" ? "" : "number", name))));
    place.replaceChildren(
      element("div", "columns",
        element("section", "", element("h2", "", "Last values, body axes: right, forward, up"), element("table", "", head, this.values), element("h3", "", "Flags of the last sample"), this.flags),
        element("section", "", element("h2", "", "What the judge of the input and the drivers say"), this.warnings)),
      strips,
      element("div", "columns", calibration, mounting));
    this.calibration = new Calibration(calibration, data, ask);
    this.mounting = new Mounting(mounting, data);
    this.scene = this.calibration.scene;
    this.strips = new Strips(strips, data, [
      { title: "force", unit: "m/s²", scale: 1, digits: 2, lines: [{ of: "force_m_s2", name: "length", colour: "accel" }] },
      { title: "field", unit: "µT", scale: 1, digits: 1, lines: [{ of: "field_ut", name: "length", colour: "field" }] },
      { title: "rate", unit: "°/s", scale: 1 / DEGREE, digits: 1, lines: [{ of: "rate_x_rad_s", name: "x", colour: "axis-x" }, { of: "rate_y_rad_s", name: "y", colour: "axis-y" }, { of: "rate_z_rad_s", name: "z", colour: "axis-z" }] },
    ]);
    /** What is drawn, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  draw() {
    const picture = this.data.shown()?.picture ?? {};
    const [rate, force, field, velocity] = [vector(picture.imu?.rate_rad_s), vector(picture.imu?.force_m_s2), vector(picture.mag?.field_ut), vector(picture.gnss?.velocity_m_s)];
    const now_s = this.data.shown()?.t ?? 0;
    const age_s = (/** @type {import("./wire.js").Message | null | undefined} */ message) => (message ? now_s - message.header.t_end_ns * 1e-9 : NaN);
    const ages_s = [age_s(picture.imu), age_s(picture.imu), age_s(picture.mag), age_s(picture.gnss)];
    const row = (/** @type {string} */ name, /** @type {number[] | null} */ v, /** @type {number} */ scale, /** @type {number} */ digits, /** @type {number} */ age_s, /** @type {string} */ expected) => {
      const cell = (/** @type {number} */ x) => (Number.isFinite(x) ? signed(x * scale, digits) : "–");
      return [name, ...(v ? [...v.map(cell), (Math.hypot(...v) * scale).toFixed(digits)] : ["–", "–", "–", "–"]), v ? `${Math.max(0, age_s).toFixed(1)} s` : "–", v ? expected : "none has come"];
    };
    rows(this.values, [
      row("rate, °/s", rate, 1 / DEGREE, 2, ages_s[0], "0 at rest, less the bias"),
      row("specific force, m/s²", force, 1, 3, ages_s[1], "9.81 at rest, up"),
      row("field, µT", field, 1, 1, ages_s[2], "25 to 65"),
      row("velocity, m/s (east, north, up)", velocity, 1, 2, ages_s[3], "that of the vehicle"),
    ], ["", "number", "number", "number", "number", "number", "c-quiet"]);
    // A receiver tells once a second.
    ages_s.forEach((age_s, at) => this.values.children[at].classList.toggle("old", age_s > (at === 3 ? GNSS_OLD_S : OLD_S)));
    const named = picture.imu ? this.data.flags.filter((_, bit) => Math.floor(picture.imu.header.flags / 2 ** bit) % 2 === 1).map(([name]) => name) : [];
    write(this.flags, named.length ? named.join(", ") : "none");
    const warnings = [...(this.data.standing.warnings ?? [])];
    for (const { status } of this.data.standing.services ?? []) for (const trouble of status?.troubles ?? []) warnings.push(`${status.service}: ${trouble.found}\n${trouble.remedy}`);
    this.calibration.draw();
    this.mounting.draw();
    this.drawn = { force_m_s2: force, rate_rad_s: rate, flags: named, warnings, calibration: this.calibration.drawn, mounting: this.mounting.drawn };
    if (this.warnings.dataset.said !== warnings.join("\n")) {
      this.warnings.dataset.said = warnings.join("\n");
      this.warnings.replaceChildren(...(warnings.length ? warnings.map((text) => element("p", "warning", text)) : [element("p", "c-quiet", "Nothing is wrong with what comes in. `plumb doctor` looks at the machine, too.")]));
    }
    this.strips.draw();
  }
}
