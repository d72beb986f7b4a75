// Fly view: the attitude and its uncertainty.

import { DEGREE, angles, rotate } from "./attitude.js";
import { attitudeOfPoint, attitudeOfShadow, errorOf, quaternion } from "./data.js";
import { BODIES } from "./bodies.js";
import { colour, createCanvas, element, fillTable, legend, prepareCanvas, select, store, stored, strokeLine, tint, write } from "./ui.js";
import { Scene } from "./scene.js";
import { Strips, axisLines, line, signed } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./attitude.js").Vec} Vec */
/** @typedef {import("./attitude.js").Quat} Quat */

const AXES = /** @type {[string, Vec][]} */ ([["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]]);
const RING = [...Array(65).keys()].map((i) => /** @type {Vec} */ ([1.3 * Math.cos((i * Math.PI) / 32), 1.3 * Math.sin((i * Math.PI) / 32), 0]));
/** Space for the bank scale around the horizon, px. */
const BANK_PX = 32;
/** Bank angles that the scale marks, and the two with a number, °. */
const BANK_DEG = [10, 20, 30, 45, 60], NUMBERED_BANK_DEG = [30, 60];

/** Distance from a mark of the rose to the middle of its text, px. */
const ROSE_TEXT_PX = 15;

export class Fly {
  /** @param {HTMLElement} parent @param {Data} data */
  constructor(parent, data) {
    this.data = data;
    const grid = element("div", "grid fly");
    const [scene, side, horizon, rose, strips] = [element("div", "panel"), element("div", "side"), element("div", "panel"), element("div", "panel"), element("div", "panel wide")];
    scene.style.gridArea = "scene";
    strips.style.gridArea = "strips";
    this.horizon = createCanvas("Artificial horizon");
    this.rose = createCanvas("Compass rose");
    horizon.append(this.horizon);
    rose.append(this.rose);
    this.values = element("tbody", "");
    side.append(horizon, rose, element("table", "big", this.values));
    grid.append(scene, side, strips);
    parent.replaceChildren(grid);
    this.scene = new Scene(scene, 4.1, 0.28, 3.2);
    const [list, ghosts] = legend([["━", "c-fused", "fused"], ["╌", "c-ink", "reference"], ["─", "c-gyro", "gyro only"], ["┄", "c-shadow", "shadow"]]);
    this.ghosts = ghosts;
    this.note = element("p", "note");
    this.body = select("body", Object.keys(BODIES).map((name) => [name, name]));
    this.body.value = stored("localStorage", "body") ?? "";
    // A stored name may be unknown.
    if (!this.body.value) this.body.value = "aeroplane";
    this.body.addEventListener("change", () => store("localStorage", "body", this.body.value));
    this.body.addEventListener("pointerdown", (event) => event.stopPropagation());
    scene.append(list, element("label", "choice", "body ", this.body), this.note);
    const deg = 1 / DEGREE;
    this.strips = new Strips(strips, data, "fly", [
      { title: "angles", unit: "°", scale: deg, digits: 1, least: -180, most: 180, wraps: true, lines: [line("yaw_rad", "yaw", "axis-z"), line("pitch_rad", "pitch", "axis-x"), line("roll_rad", "roll", "axis-y")] },
      { title: "rate", unit: "°/s", scale: deg, digits: 1, optional: true, lines: axisLines("rate", "rad_s") },
      { title: "error, sd", unit: "°", scale: deg, digits: 2, least: 0, most: 180, robust: true, lines: [line("error_rad", "error", "fault"), line("inclination_sd_rad", "inclination sd", "fused", "dashed"), line("difference_rad", "shadow", "shadow")] },
    ]);
    /** Content shown, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  draw() {
    const frame = this.data.shown();
    const snapshot = frame?.snapshot ?? {};
    const own = quaternion(snapshot.attitude?.quaternion);
    const truth = quaternion(snapshot.reference?.quaternion);
    const gyro = attitudeOfPoint(snapshot.gyro);
    const shadow = attitudeOfShadow(snapshot);
    const shadow_difference_deg = shadow ? snapshot.differences[0].now_rad.x / DEGREE : null;
    this.drawn = { quaternion: own, reference: truth, gyro, shadow, shadow_difference_deg, yaw_deg: null, error_deg: null };
    [own, truth, gyro, shadow].forEach((ghost, at) => { this.ghosts[at].hidden = !ghost; });
    this.drawn.body = this.body.value;
    const slot = shadow ? snapshot.differences[0].service.replace("SERVICE_", "").toLowerCase() : "";
    write(this.ghosts[3], `shadow of ${slot}, difference ${shadow_difference_deg?.toFixed(2)}°`);
    this.drawScene(own, truth, gyro, shadow);
    this.drawHorizon(own);
    this.drawRose(snapshot.attitude);
    this.drawValues(snapshot);
    this.strips.draw();
  }

  /** @param {Quat | null} own @param {Quat | null} truth @param {Quat | null} gyro @param {Quat | null} shadow */
  drawScene(own, truth, gyro, shadow) {
    const { scene } = this, body = BODIES[this.body.value];
    scene.begin();
    scene.line(RING, tint("line"), 0.8);
    for (const [name, axis] of AXES) {
      scene.line([[0, 0, 0], /** @type {Vec} */ (axis.map((part) => part * 1.3))], tint(`axis-${name}`), 0.7);
      const end = /** @type {Vec} */ (axis.map((part) => part * 1.4));
      scene.label(end, { x: "east x", y: "north y", z: "up z" }[name] ?? name, `c-${name}`);
    }
    if (shadow) {
      for (const [, axis] of AXES) scene.line(dashPoints(rotate(shadow, axis), 1.25), tint("shadow"), 1.2, true);
      for (const shape of body) scene.line([...shape, shape[0]].map((point) => rotate(shadow, point)), tint("shadow", 0.8), 0.6);
    }
    if (truth) for (const [, axis] of AXES) scene.line(dashPoints(rotate(truth, axis), 1.22), tint("ink"), 0.9, true);
    if (gyro) for (const [, axis] of AXES) scene.line([[0, 0, 0], /** @type {Vec} */ (rotate(gyro, axis).map((part) => part * 1.1))], tint("gyro"), 0.9);
    if (own) {
      const light = [0.35, -0.5, 0.8];
      for (const shape of body) {
        const [a, b, c] = shape.map((point) => rotate(own, point));
        const n = normal(a, b, c);
        const bright = 0.62 + 0.38 * Math.abs(n[0] * light[0] + n[1] * light[1] + n[2] * light[2]);
        const [r, g, blue] = tint("body");
        scene.triangle(a, b, c, [r * bright, g * bright, blue * bright, 1]);
      }
      for (const [name, axis] of AXES) {
        const end = /** @type {Vec} */ (rotate(own, axis).map((part) => part * 1.18));
        scene.line([[0, 0, 0], end], tint("fused"), 1.6);
        scene.label(end, { x: "right", y: "nose", z: "top" }[name] ?? "", "c-fused");
      }
    }
    scene.end();
    write(this.note, own ? scene.fallbackReason : "no attitude yet; start a system with `plumb up`");
  }

  /** @param {Quat | null} q */
  drawHorizon(q) {
    const prepared = prepareCanvas(this.horizon);
    if (!prepared) return;
    const [context, width, height] = prepared;
    // The bank scale is above the disc.
    const r = Math.min(width / 2 - BANK_PX, (height - BANK_PX - 6) / 2), [x, y] = [width / 2, (height + BANK_PX - 6) / 2];
    context.save();
    context.beginPath(); context.arc(x, y, r, 0, 7); context.clip();
    context.fillStyle = colour("panel");
    context.fillRect(0, 0, width, height);
    if (q) {
      const [, pitch, roll] = angles(q);
      const scale = r / (45 * DEGREE);
      context.translate(x, y);
      context.rotate(-roll);
      context.translate(0, pitch * scale);
      context.fillStyle = colour("sky"); context.fillRect(-3 * r, -12 * r, 6 * r, 12 * r);
      context.fillStyle = colour("ground"); context.fillRect(-3 * r, 0, 6 * r, 12 * r);
      context.strokeStyle = context.fillStyle = colour("ink");
      context.font = "13px system-ui";
      context.textAlign = "right";
      context.textBaseline = "middle";
      for (let mark = -80; mark <= 80; mark += 10) {
        const half = mark === 0 ? 3 * r : mark % 30 === 0 ? 0.3 * r : 0.16 * r;
        const at = -mark * DEGREE * scale;
        strokeLine(context, -half, at, half, at);
        // A text near the edge would be cut off.
        if (mark && mark % 30 === 0 && Math.abs(at + pitch * scale) < 0.62 * r) context.fillText(`${mark < 0 ? "−" : ""}${Math.abs(mark)}°`, -half - 5, at);
      }
    }
    context.restore();
    this.drawBankScale(context, x, y, r, q ? angles(q)[2] : null);
    context.strokeStyle = colour("fused");
    context.lineWidth = 3;
    strokeLine(context, x - 0.5 * r, y, x - 0.15 * r, y, x, y + 0.1 * r, x + 0.15 * r, y, x + 0.5 * r, y);
  }

  /** Draws the fixed scale and the pointer, which shows the zenith. @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {number} r @param {number | null} roll rad */
  drawBankScale(context, x, y, r, roll) {
    context.strokeStyle = context.fillStyle = colour("ink");
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.font = "13px system-ui";
    const at = (/** @type {number} */ angle, /** @type {number} */ radius) => /** @type {[number, number]} */ ([x + radius * Math.sin(angle), y - radius * Math.cos(angle)]);
    for (const mark of [0, ...BANK_DEG, ...BANK_DEG.map((mark) => -mark)]) {
      const numbered = NUMBERED_BANK_DEG.includes(Math.abs(mark));
      strokeLine(context, ...at(mark * DEGREE, r + 2), ...at(mark * DEGREE, r + (numbered || !mark ? 10 : 6)));
      if (numbered && r > 50) context.fillText(String(Math.abs(mark)), ...at(mark * DEGREE, r + 22));
    }
    this.drawn.bank = { marks_deg: BANK_DEG, pointer_deg: roll === null ? null : -roll / DEGREE };
    if (roll === null) return;
    context.beginPath();
    for (const [angle, radius] of [[0, r], [7 / r, r - 12], [-7 / r, r - 12]]) context.lineTo(...at(angle - roll, radius));
    context.fill();
  }

  /** @param {import("./wire.js").Message | undefined} attitude */
  drawRose(attitude) {
    const prepared = prepareCanvas(this.rose);
    if (!prepared) return;
    const [context, width, height] = prepared;
    const [x, y, r] = [width / 2, height / 2, Math.min(width, height) * 0.44];
    const course = attitude?.course_rad;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.strokeStyle = colour("line");
    context.beginPath(); context.arc(x, y, r, 0, 7); context.stroke();
    if (course === undefined) return;
    const arbitrary = attitude?.course_reference === "COURSE_REFERENCE_ARBITRARY";
    context.font = "14px system-ui";
    for (let mark = 0; mark < 360; mark += 10) {
      const angle = mark * DEGREE - course;
      const [s, c] = [Math.sin(angle), -Math.cos(angle)];
      const long = mark % 30 === 0;
      context.strokeStyle = context.fillStyle = colour(mark === 0 && !arbitrary ? "fault" : "ink");
      const inner = r * (long ? 0.9 : 0.95), middle = inner - ROSE_TEXT_PX;
      strokeLine(context, x + r * s, y + r * c, x + inner * s, y + inner * c);
      // A small rose has room for the main directions only.
      if (mark % 90 === 0 || (long && r > 80)) context.fillText(!arbitrary && mark % 90 === 0 ? "NESW"[mark / 90] : String(mark), x + middle * s, y + middle * c);
    }
    context.fillStyle = colour("fused");
    context.beginPath(); context.moveTo(x, y - r * 1.02); context.lineTo(x - 7, y - r * 1.02 - 11); context.lineTo(x + 7, y - r * 1.02 - 11); context.fill();
    context.font = `600 ${Math.min(20, 0.24 * r)}px system-ui`;
    context.fillText(`${degrees(course)}°`, x, y - 8);
    context.font = "13px system-ui";
    context.fillStyle = colour("quiet");
    context.fillText(courseReference(attitude?.course_reference), x, y + 14);
  }

  /** @param {import("./wire.js").Message} snapshot */
  drawValues(snapshot) {
    const { attitude } = snapshot;
    const deg = (/** @type {number} */ rad) => `${signed(rad / DEGREE, 1)}°`;
    const sd = (/** @type {number | undefined} */ rad) => (rad === undefined || rad >= Math.PI ? "± –" : `± ${(rad / DEGREE).toFixed(2)}°`);
    const error = errorOf(snapshot);
    if (attitude) Object.assign(this.drawn, { yaw_deg: attitude.yaw_rad / DEGREE, pitch_deg: attitude.pitch_rad / DEGREE, roll_deg: attitude.roll_rad / DEGREE, course_deg: attitude.course_rad / DEGREE });
    this.drawn.error_deg = error === null ? null : error / DEGREE;
    const rows = [
      ["pitch", attitude ? deg(attitude.pitch_rad) : "–", "roll", attitude ? deg(attitude.roll_rad) : "–", attitude ? sd(attitude.inclination_sd_rad) : ""],
      ["yaw", attitude ? deg(attitude.yaw_rad) : "–", `course ${courseReference(attitude?.course_reference)}`, attitude ? `${degrees(attitude.course_rad)}°` : "–", attitude ? sd(attitude.course_sd_rad) : ""],
    ];
    // Only simulations and some recordings have a reference.
    if (error !== null) rows.push(["error", `${(error / DEGREE).toFixed(2)}°`, "against the reference", "", ""]);
    fillTable(this.values, rows, ["", "number", "", "number", "c-quiet"]);
  }
}

/** @param {number} rad */
export const degrees = (rad) => (rad / DEGREE).toFixed(1).padStart(5, "0");

/** Returns the abbreviation of a course reference. @param {string | undefined} reference */
export const courseReference = (reference) => ({ COURSE_REFERENCE_MAGNETIC: "mag.", COURSE_REFERENCE_TRUE: "true", COURSE_REFERENCE_ARBITRARY: "arb." })[reference ?? ""] ?? "";

/** Returns the points of a dashed line from the origin. @param {Vec} end @param {number} length @returns {Vec[]} */
const dashPoints = (end, length) => [...Array(16).keys()].map((i) => /** @type {Vec} */ (end.map((part) => (part * length * i) / 15)));

/** @param {Vec} a @param {Vec} b @param {Vec} c @returns {Vec} */
function normal(a, b, c) {
  const [p, q] = [b.map((part, i) => part - a[i]), c.map((part, i) => part - a[i])];
  const n = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
  const length = Math.hypot(...n) || 1;
  return [n[0] / length, n[1] / length, n[2] / length];
}
