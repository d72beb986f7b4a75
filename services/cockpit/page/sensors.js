// Sensors: whether what comes in is sane.

import { DEGREE } from "./attitude.js";
import { vector } from "./data.js";
import { element, rows } from "./look.js";
import { Strips, signed } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */

const FLAGS = ["rate-invalid", "force-invalid", "rate-clipped", "force-clipped", "rate-stuck", "force-stuck", "force-small", "gap", "clock-leap", "refused-before", "rate-instant", "gyro-missing", "accel-missing", "lost-before", "aligned", "reset", "at-rest", "near-gimbal", "unaligned", "field", "fix", "field-invalid", "fix-invalid", "field-disturbed", "aiding-missing", "fault-injected", "swapped"];

/** The names of the bits. @param {number} bits */
export const flagsOf = (bits) => FLAGS.filter((_, bit) => Math.floor(bits / 2 ** bit) % 2 === 1);

export class Sensors {
  /** @param {HTMLElement} place @param {Data} data */
  constructor(place, data) {
    this.data = data;
    this.values = element("tbody", "");
    this.flags = element("p", "");
    this.warnings = element("div", "");
    const strips = element("div", "panel");
    strips.style.height = "300px";
    const head = element("thead", "", element("tr", "", ...["sensor", "x", "y", "z", "length", "expected"].map((name) => element("th", name === "sensor" || name === "expected" ? "" : "number", name))));
    place.replaceChildren(
      element("div", "columns",
        element("section", "", element("h2", "", "Last values, body axes: right, forward, up"), element("table", "", head, this.values), element("h3", "", "Flags of the last sample"), this.flags),
        element("section", "", element("h2", "", "What the judge of the input and the drivers say"), this.warnings)),
      strips);
    this.strips = new Strips(strips, data, [
      { title: "force", unit: "m/s²", scale: 1, digits: 2, lines: [{ of: "force", name: "length", colour: "accel" }] },
      { title: "field", unit: "µT", scale: 1, digits: 1, lines: [{ of: "field", name: "length", colour: "field" }] },
      { title: "rate", unit: "°/s", scale: 1 / DEGREE, digits: 1, lines: [{ of: "rate_x", name: "x", colour: "axis-x" }, { of: "rate_y", name: "y", colour: "axis-y" }, { of: "rate_z", name: "z", colour: "axis-z" }] },
    ]);
    /** What is drawn, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  draw() {
    const picture = this.data.shown()?.picture ?? {};
    const [rate, force, field, velocity] = [vector(picture.imu?.rate_rad_s), vector(picture.imu?.force_m_s2), vector(picture.mag?.field_ut), vector(picture.gnss?.velocity_m_s)];
    const row = (/** @type {string} */ name, /** @type {number[] | null} */ v, /** @type {number} */ scale, /** @type {number} */ digits, /** @type {string} */ expected) => {
      const cell = (/** @type {number} */ x) => (Number.isFinite(x) ? signed(x * scale, digits) : "–");
      return [name, ...(v ? [...v.map(cell), (Math.hypot(...v) * scale).toFixed(digits)] : ["–", "–", "–", "–"]), v ? expected : "none has come"];
    };
    rows(this.values, [
      row("rate, °/s", rate, 1 / DEGREE, 2, "0 at rest, less the bias"),
      row("specific force, m/s²", force, 1, 3, "9.81 at rest, up"),
      row("field, µT", field, 1, 1, "25 to 65"),
      row("velocity, m/s (east, north, up)", velocity, 1, 2, "that of the vehicle"),
    ], ["", "number", "number", "number", "number", "c-quiet"]);
    const named = picture.imu ? flagsOf(picture.imu.header.flags) : [];
    this.flags.textContent = named.length ? named.join(", ") : "none";
    const warnings = [...(this.data.standing.warnings ?? [])];
    for (const { status } of this.data.standing.services ?? []) for (const trouble of status?.troubles ?? []) warnings.push(`${status.service}: ${trouble.found}\n${trouble.remedy}`);
    this.drawn = { force_m_s2: force, rate_rad_s: rate, flags: named, warnings };
    if (this.warnings.dataset.said !== warnings.join("\n")) {
      this.warnings.dataset.said = warnings.join("\n");
      this.warnings.replaceChildren(...(warnings.length ? warnings.map((text) => element("p", "warning", text)) : [element("p", "c-quiet", "Nothing is wrong with what comes in. `plumb doctor` looks at the machine, too; `plumb calibrate … --live` finds bias, scale and mounting.")]));
    }
    this.strips.draw();
  }
}
