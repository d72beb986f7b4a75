// Method view: the up vector on the Riemann sphere with its projection to w, and the plane of w = u + jv.

import { DEGREE, pointOf, up } from "./attitude.js";
import { TRAILS, quaternion } from "./data.js";
import { colour, createCanvas, element, legend, prepareCanvas, strokeLine, tint, write } from "./ui.js";
import { Scene } from "./scene.js";
import { Strips, axisLines, line, signed } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./attitude.js").Vec} Vec */

/** Minimum distance between two labels of the plane, px. */
const MIN_LABEL_PX = 56;
/** Maximum number of frames in a trail. */
const TRAIL_FRAMES = 300;
/** Parallels and meridians, each with opacity and width. @type {[Vec[], number, number][]} */
const GRID = [
  ...[-60, -30, 0, 30, 60].map((part) => /** @type {[Vec[], number, number]} */ ([circle((p, q) => [Math.cos(part * DEGREE) * q, Math.cos(part * DEGREE) * p, Math.sin(part * DEGREE)]), part ? 0.45 : 1, part ? 0.5 : 0.8])),
  ...[0, 30, 60, 90, 120, 150].map((part) => /** @type {[Vec[], number, number]} */ ([circle((p, q) => [Math.cos(part * DEGREE) * q, Math.sin(part * DEGREE) * q, p]), 0.45, 0.5])),
];

export class Method {
  /** @param {HTMLElement} parent @param {Data} data */
  constructor(parent, data) {
    this.data = data;
    const grid = element("div", "grid method");
    const [sphere, plane, strips] = [element("div", "panel"), element("div", "panel"), element("div", "panel wide")];
    this.plane = createCanvas("Plane of w");
    plane.append(this.plane);
    grid.append(sphere, plane, strips);
    parent.replaceChildren(grid);
    this.scene = new Scene(sphere, 3.4);
    this.note = element("p", "note");
    for (const panel of [sphere, plane]) panel.append(legend([["●", "c-fused", "fused"], ["○", "c-gyro", "gyro only"], ["∴", "c-accel", "accelerometer"], ["◌", "c-ink", "reference"]])[0]);
    sphere.append(this.note);
    const deg = 1 / DEGREE;
    this.strips = new Strips(strips, data, "method", [
      ...["u", "v"].map((part) => ({ title: part, unit: "", scale: 1, digits: 3, lines: [line(`${part}_accel`, "accel", "accel", "dots"), line(`${part}_gyro`, "gyro", "gyro"), line(part, "fused", "fused")] })),
      { title: "z", unit: "°", scale: deg, digits: 1, least: -180, most: 180, wraps: true, lines: [line("z_gyro_rad", "gyro", "gyro"), line("z_rad", "fused", "fused")] },
      { title: "innovation", unit: "°", scale: deg, digits: 2, least: 0, most: 180, robust: true, lines: [line("innovation_rad", "accelerometer − fused", "accel")] },
      { title: "std. dev.", unit: "°", scale: deg, digits: 2, least: 0, most: 180, robust: true, lines: [line("inclination_sd_rad", "inclination", "fused"), line("course_sd_rad", "course", "axis-z", "dashed")] },
      { title: "gyro bias", unit: "°/s", scale: deg, digits: 3, lines: axisLines("bias", "rad_s") },
    ]);
    /** Content shown, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  draw() {
    const { frames } = this.data;
    const frame = this.data.shown();
    const end = frame ? frames.indexOf(frame) : -1;
    // Every second frame suffices. Selecting by number keeps the trail steady as frames are added.
    const trail = frames.slice(Math.max(0, end - TRAIL_FRAMES), end + 1).filter((one) => one.number % 2 === 0 || one === frame);
    const truth = quaternion(frame?.snapshot.reference?.quaternion);
    const now = { fused: null, gyro: null, accel: null, ...frame?.ups, ink: truth ? up(truth) : null };
    const inverted = frame?.snapshot.fused?.chart === "CHART_INVERTED";
    const project = (/** @type {Vec} */ v) => (inverted ? pointOf([v[0], -v[1], -v[2]]) : pointOf(v));
    this.drawn = { w: now.fused ? project(now.fused) : null, w_gyro: now.gyro ? project(now.gyro) : null, w_accel: now.accel ? project(now.accel) : null, chart: inverted ? "inverted" : "upright" };
    this.drawSphere(trail, now, project, inverted);
    this.drawPlane(trail, now, project, inverted);
    this.strips.draw();
  }

  /** @param {import("./data.js").Frame[]} trail @param {Record<string, Vec | null>} now @param {(v: Vec) => [number, number]} project @param {boolean} inverted */
  drawSphere(trail, now, project, inverted) {
    const { scene } = this;
    scene.begin();
    for (const [line, alpha, width] of GRID) scene.line(line, tint("quiet", alpha), width);
    const pole = inverted ? 1 : -1;
    scene.point([0, 0, pole], tint("fault"), 4);
    scene.label([0, 0, pole * 1.2], inverted ? "pole: zenith" : "pole: nadir", "c-fault");
    // Near this pole, the label of the up vector is in its place.
    if (!now.fused || now.fused[2] * -pole < 0.8) scene.label([0, 0, -pole * 1.12], inverted ? "upside down, w = 0" : "level, w = 0", "c-quiet");
    scene.label([1.3, 0, 0], "right", "c-x");
    scene.label([0, 1.3, 0], "nose", "c-y");
    const dots = tint("accel", 0.6);
    for (const name of TRAILS) {
      const points = trail.map((frame) => frame.ups[name]).filter((point) => point !== null);
      if (name === "accel") points.forEach((point) => scene.point(point, dots, 1.4));
      else scene.line(points, tint(name), name === "fused" ? 1.3 : 0.8);
    }
    for (const [name, size] of /** @type {[string, number][]} */ ([["accel", 4], ["gyro", 4], ["ink", 3.5], ["fused", 5]])) {
      const at = now[name];
      if (!at) continue;
      scene.point(at, tint(name), size);
      if (name !== "fused") continue;
      // The ray from the pole through the up vector meets the equatorial plane at w.
      const [u, v] = project(at);
      scene.line([[0, 0, pole], at, inverted ? [u, -v, 0] : [u, v, 0]], tint("fused"), 1);
      scene.point(inverted ? [u, -v, 0] : [u, v, 0], tint("fused"), 3);
      scene.label([at[0] * 1.15, at[1] * 1.15, at[2] * 1.15], "up", "c-fused");
    }
    scene.end();
    write(this.note, now.fused ? scene.fallbackReason || "body axes: right, nose, top; the ray from the pole meets the plane at w" : "no attitude yet; start a system with `plumb up`");
  }

  /** @param {import("./data.js").Frame[]} trail @param {Record<string, Vec | null>} now @param {(v: Vec) => [number, number]} project @param {boolean} inverted */
  drawPlane(trail, now, project, inverted) {
    const prepared = prepareCanvas(this.plane);
    if (!prepared) return;
    const [context, width, height] = prepared;
    let reach = 0.1;
    for (const frame of trail) {
      const [u, v] = frame.ups.fused ? project(frame.ups.fused) : [0, 0];
      for (const part of [Math.abs(u), Math.abs(v)]) if (part > reach && part < 3) reach = part;
    }
    const step = [0.05, 0.1, 0.2, 0.5, 1].find((size) => reach / size <= 4) ?? 1;
    reach = step * Math.ceil((reach * 1.15) / step);
    const scale = (Math.min(width, height) * 0.46) / reach;
    const at = (/** @type {[number, number]} */ [u, v]) => /** @type {[number, number]} */ ([width / 2 + u * scale, height / 2 - v * scale]);
    context.font = "13px system-ui";
    context.strokeStyle = colour("line");
    context.fillStyle = colour("quiet");
    const every = Math.ceil(MIN_LABEL_PX / (step * scale));
    const last = Math.floor(Math.max(width, height) / 2 / scale / step);
    for (let number = -last; number <= last; number++) {
      const mark = number * step, [x, y] = at([mark, mark]).map((place) => Math.round(place) + 0.5);
      context.globalAlpha = 0.55;
      strokeLine(context, x, 0, x, height); strokeLine(context, 0, y, width, y);
      context.globalAlpha = 1;
      if (!number || number % every) continue;
      const text = mark.toFixed(2).replace("-", "−");
      // A text at the edge would be cut off.
      if (x < width - MIN_LABEL_PX) context.fillText(text, x + 2, height / 2 - 3);
      if (y > 36 && y < height - 20) context.fillText(text, width / 2 + 4, y - 3);
    }
    context.strokeStyle = colour("quiet");
    strokeLine(context, 0, height / 2, width, height / 2);
    strokeLine(context, width / 2, 0, width / 2, height);
    context.fillText("u, right side up", width - 110, height / 2 + 16);
    context.fillText("v, nose up", width / 2 + 6, 16);
    for (const name of TRAILS) {
      context.strokeStyle = context.fillStyle = colour(name);
      context.lineWidth = name === "fused" ? 2 : 1.2;
      context.beginPath();
      let connected = false;
      trail.forEach((frame) => {
        const point = frame.ups[name];
        if (!point) { connected = false; return; }
        const [x, y] = at(project(point));
        if (name === "accel") context.rect(x - 1, y - 1, 2, 2);
        else if (connected) context.lineTo(x, y);
        else context.moveTo(x, y);
        connected = true;
      });
      if (name === "accel") context.fill(); else context.stroke();
    }
    for (const [name, size] of /** @type {[string, number][]} */ ([["accel", 4], ["gyro", 5], ["ink", 6], ["fused", 5]])) {
      const point = now[name];
      if (!point) continue;
      const [x, y] = at(project(point));
      context.fillStyle = context.strokeStyle = colour(name);
      context.lineWidth = 2;
      context.beginPath(); context.arc(x, y, size, 0, 7);
      context.setLineDash(name === "ink" ? [4, 3] : []);
      if (name === "gyro" || name === "ink") context.stroke(); else context.fill();
    }
    context.setLineDash([]);
    const w = now.fused ? project(now.fused) : null;
    context.fillStyle = colour("ink");
    context.fillText(w ? `w = ${signed(w[0], 4)} ${signed(w[1], 4)} j, ${inverted ? "inverted" : "upright"} chart` : "w = –", 8, height - 8);
  }
}

/** @param {(s: number, c: number) => Vec} at @returns {Vec[]} */
function circle(at) {
  return [...Array(49).keys()].map((i) => at(Math.sin((i * Math.PI) / 24), Math.cos((i * Math.PI) / 24)));
}
