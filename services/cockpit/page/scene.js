// A small 3-D scene of lines, triangles, points and labels. Without WebGL 2 it is drawn on a 2-D canvas, and the reason is shown.
// Space is right-handed with z up; the camera looks at a point above the origin. The module does not depend on attitudes.

import { write } from "./ui.js";

/** @typedef {import("./attitude.js").Vec} Vec */
/** @typedef {[number, number, number, number]} Colour */
/** @typedef {{ at: Vec, text: string, className: string }} Label */

const VERTEX = `#version 300 es
in vec3 a; in vec3 b; in vec2 side; in vec4 colour;
uniform mat4 camera; uniform vec2 size;
out vec4 tint; out vec2 disc;
void main() {
  vec4 p = camera * vec4(a, 1.0);
  tint = colour; disc = vec2(0.0);
  if (side.x != 0.0 && a != b) {
    vec4 q = camera * vec4(b, 1.0);
    vec2 along = normalize((q.xy / q.w - p.xy / p.w) * size);
    p.xy += vec2(-along.y, along.x) * side.x * side.y / size * p.w * 2.0;
  } else if (side.x != 0.0) {
    float corner = abs(side.x);
    vec2 to = corner == 1.0 ? vec2(-1, -1) : corner == 2.0 ? vec2(1, -1) : corner == 3.0 ? vec2(1, 1) : vec2(-1, 1);
    disc = to; p.xy += to * side.y / size * p.w * 2.0;
  }
  gl_Position = p;
}`;
const FRAGMENT = `#version 300 es
precision mediump float;
in vec4 tint; in vec2 disc; out vec4 colour;
void main() { if (dot(disc, disc) > 1.0) discard; colour = vec4(tint.rgb * tint.a, tint.a); }`;
/** Number of floats per vertex: a, b, side, width, colour. */
const FLOATS = 12;

/** Assumed width of a letter and height of a label, px. */
const LETTER_PX = 7.5, LABEL_PX = 17;

export class Scene {
  /** @param {HTMLElement} panel @param {number} distance Distance of the camera from the centre @param {number} [centre] Height of the centre of the snapshot above the origin @param {number} [focal] Focal length of the camera, in half heights of the snapshot */
  constructor(panel, distance, centre = 0, focal = 2.4) {
    this.homeDistance = distance;
    this.centre = centre;
    this.focal = focal;
    this.canvas = document.createElement("canvas");
    this.labelParent = document.createElement("div");
    this.labelParent.className = "labels";
    panel.append(this.canvas, this.labelParent);
    panel.classList.add("rotatable");
    this.panel = panel;
    this.vertices = new Float32Array(1 << 16);
    /** Number of floats used. */ this.used = 0;
    /** @type {Label[]} */ this.labels = [];
    /** Numbers of shapes drawn last, for tests. @type {{ lines: number, triangles: number, points: number }} */ this.count = { lines: 0, triangles: 0, points: 0 };
    this.azimuth = -0.9; this.elevation = 0.45; this.distance = distance;
    /** Reason why WebGL is not used; empty if it is used. */ this.fallbackReason = "";
    /** @type {WebGLUniformLocation | null} */ this.camera = null;
    /** @type {WebGLUniformLocation | null} */ this.size = null;
    this.startWebGl();
    this.canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); this.gl = null; this.useFlatCanvas("the WebGL context was lost"); });
    panel.addEventListener("pointerdown", (event) => this.drag(event));
    panel.addEventListener("wheel", (event) => { event.preventDefault(); this.distance = Math.max(2.5, Math.min(12, this.distance * Math.exp(event.deltaY * 1e-3))); }, { passive: false });
  }

  startWebGl() {
    const gl = this.canvas.getContext("webgl2", { antialias: true, alpha: true });
    if (!gl) {
      this.useFlatCanvas("this browser does not support WebGL 2");
      return;
    }
    const program = gl.createProgram();
    for (const [kind, text] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]])) {
      const shader = gl.createShader(kind);
      if (!program || !shader) { this.useFlatCanvas("WebGL 2 program creation failed"); return; }
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    ["a", "b", "side", "colour"].forEach((name, index) => gl.bindAttribLocation(program, index, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) { this.useFlatCanvas("WebGL 2 program linking failed"); return; }
    gl.useProgram(program);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    [[3, 0], [3, 3], [2, 6], [4, 8]].forEach(([size, offset], index) => {
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, size, gl.FLOAT, false, FLOATS * 4, offset * 4);
    });
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.camera = gl.getUniformLocation(program, "camera");
    this.size = gl.getUniformLocation(program, "size");
    this.gl = gl;
  }

  /** Switches to a new canvas with a 2-D context, because a canvas that had WebGL cannot have one. @param {string} reason */
  useFlatCanvas(reason) {
    this.fallbackReason = `${reason}; using the 2-D fallback`;
    const canvas = document.createElement("canvas");
    this.canvas.replaceWith(canvas);
    this.canvas = canvas;
    this.flat = canvas.getContext("2d");
  }

  reset() {
    this.azimuth = -0.9; this.elevation = 0.45; this.distance = this.homeDistance;
  }

  /** @param {PointerEvent} event */
  drag(event) {
    this.panel.setPointerCapture(event.pointerId);
    const move = (/** @type {PointerEvent} */ moved) => this.rotate(-moved.movementX * 0.008, moved.movementY * 0.008);
    this.panel.addEventListener("pointermove", move);
    this.panel.addEventListener("lostpointercapture", () => this.panel.removeEventListener("pointermove", move), { once: true });
  }

  /** @param {number} azimuth rad @param {number} elevation rad */
  rotate(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.max(-1.5, Math.min(1.5, this.elevation + elevation));
  }

  begin() {
    this.used = 0;
    this.labels.length = 0;
    this.count = { lines: 0, triangles: 0, points: 0 };
  }

  /** Adds a line through the points. If dashed, every second segment is drawn.
   * @param {Vec[]} points @param {Colour} colour @param {number} width Half width, pixels @param {boolean} [dashed] */
  line(points, colour, width, dashed = false) {
    for (let i = 0; i + 1 < points.length; i += dashed ? 2 : 1) {
      const [a, b] = [points[i], points[i + 1]];
      for (const [p, q, side] of /** @type {[Vec, Vec, number][]} */ ([[a, b, -1], [a, b, 1], [b, a, -1], [b, a, -1], [b, a, 1], [a, b, -1]])) this.vertex(p, q, side, width, colour);
      this.count.lines++;
    }
  }

  /** @param {Vec} a @param {Vec} b @param {Vec} c @param {Colour} colour */
  triangle(a, b, c, colour) {
    for (const p of [a, b, c]) this.vertex(p, p, 0, 0, colour);
    this.count.triangles++;
  }

  /** Adds a disc. @param {Vec} at @param {Colour} colour @param {number} size Radius, pixels */
  point(at, colour, size) {
    for (const corner of [1, 2, 3, 1, 3, 4]) this.vertex(at, at, corner, size, colour);
    this.count.points++;
  }

  /** @param {Vec} at @param {string} text @param {string} className */
  label(at, text, className) {
    this.labels.push({ at, text, className });
  }

  /** @param {Vec} a @param {Vec} b @param {number} side @param {number} width @param {Colour} colour */
  vertex(a, b, side, width, colour) {
    if (this.used + FLOATS > this.vertices.length) {
      const larger = new Float32Array(2 * this.vertices.length);
      larger.set(this.vertices);
      this.vertices = larger;
    }
    const v = this.vertices, n = this.used;
    v[n] = a[0]; v[n + 1] = a[1]; v[n + 2] = a[2]; v[n + 3] = b[0]; v[n + 4] = b[1]; v[n + 5] = b[2];
    v[n + 6] = side; v[n + 7] = width; v[n + 8] = colour[0]; v[n + 9] = colour[1]; v[n + 10] = colour[2]; v[n + 11] = colour[3];
    this.used += FLOATS;
  }

  end() {
    const { canvas } = this;
    const ratio = Math.min(devicePixelRatio, 2);
    const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    if (!width || !height) return;
    const camera = cameraMatrix(this.azimuth, this.elevation, this.distance, width / height, this.centre, this.focal);
    if (this.gl) this.drawWebGl(this.gl, camera, width, height, ratio);
    else if (this.flat) this.drawFlat(this.flat, camera, width, height, ratio);
    this.placeLabels(camera, width / ratio, height / ratio);
  }

  /** @param {WebGL2RenderingContext} gl @param {number[]} camera @param {number} width @param {number} height @param {number} ratio */
  drawWebGl(gl, camera, width, height, ratio) {
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(this.camera, false, camera);
    gl.uniform2f(this.size, width / ratio, height / ratio);
    gl.bufferData(gl.ARRAY_BUFFER, this.vertices.subarray(0, this.used), gl.DYNAMIC_DRAW);
    gl.drawArrays(gl.TRIANGLES, 0, this.used / FLOATS);
  }

  /** @param {CanvasRenderingContext2D} flat @param {number[]} camera @param {number} width @param {number} height @param {number} ratio */
  drawFlat(flat, camera, width, height, ratio) {
    flat.clearRect(0, 0, width, height);
    const v = this.vertices;
    const projected = (/** @type {number} */ i) => project(camera, [v[i], v[i + 1], v[i + 2]], width, height);
    const shapes = [];
    for (let i = 0; i + 2 * FLOATS < this.used; i += 3 * FLOATS) shapes.push({ i, depth: projected(i)[2] + projected(i + FLOATS)[2] + projected(i + 2 * FLOATS)[2] });
    shapes.sort((p, q) => q.depth - p.depth);
    for (const { i } of shapes) {
      const [p, q, r] = [projected(i), projected(i + FLOATS), projected(i + 2 * FLOATS)];
      flat.fillStyle = flat.strokeStyle = `rgba(${v[i + 8] * 255},${v[i + 9] * 255},${v[i + 10] * 255},${v[i + 11]})`;
      flat.lineWidth = 2 * v[i + 7] * ratio;
      flat.beginPath();
      if (v[i + 6] !== 0 && p[0] === q[0] && p[1] === q[1] && r[0] === p[0] && r[1] === p[1]) flat.arc(p[0], p[1], v[i + 7] * ratio, 0, 7);
      else { flat.moveTo(p[0], p[1]); flat.lineTo(q[0], q[1]); flat.lineTo(r[0], r[1]); }
      if (v[i + 6] === 0 || flat.lineWidth === 0) flat.fill();
      else flat.stroke();
    }
  }

  /** @param {number[]} camera @param {number} width @param {number} height */
  placeLabels(camera, width, height) {
    const spans = /** @type {HTMLCollectionOf<HTMLElement>} */ (this.labelParent.children);
    while (spans.length < this.labels.length) this.labelParent.append(document.createElement("span"));
    /** Places of the labels: their middle and half width, px. @type {Vec[]} */
    const places = [];
    for (let i = 0; i < spans.length; i++) {
      const label = this.labels[i];
      spans[i].hidden = !label;
      if (!label) continue;
      let [x, y] = project(camera, label.at, width, height);
      const half = (label.text.length * LETTER_PX) / 2;
      // A label that would cover an earlier one is moved up or down, and one outside the snapshot to its edge.
      x = clamp(x, half, width - half);
      const covered = places.find(([px, py, other]) => Math.abs(px - x) < half + other && Math.abs(py - y) < LABEL_PX);
      if (covered) y = covered[1] + (y < covered[1] ? -LABEL_PX : LABEL_PX);
      y = clamp(y, LABEL_PX / 2, height - LABEL_PX / 2);
      places.push([x, y, half]);
      write(spans[i], label.text);
      if (spans[i].className !== label.className) spans[i].className = label.className;
      spans[i].style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, -50%)`;
    }
  }
}

/** Returns the camera matrix, column by column. @param {number} azimuth @param {number} elevation @param {number} distance @param {number} aspect @param {number} centre @param {number} length Focal length */
function cameraMatrix(azimuth, elevation, distance, aspect, centre, length) {
  const [s, c, t, e] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(elevation), Math.cos(elevation)];
  const [right, upward, back] = [[-s, c, 0], [-t * c, -t * s, e], [e * c, e * s, t]];
  const [near, far, focal] = [0.5, 40, aspect < 1 ? length * aspect : length];
  const [m, n] = [(far + near) / (near - far), (2 * far * near) / (near - far)];
  /** @type {number[]} */ const columns = [];
  for (let i = 0; i < 3; i++) columns.push((focal / aspect) * right[i], focal * upward[i], m * back[i], -back[i]);
  // The centre is moved to the origin first.
  [0, 0, -m * distance + n, distance].forEach((part, row) => columns.push(part - centre * columns[8 + row]));
  return columns;
}

/** @param {number} value @param {number} least @param {number} most */
const clamp = (value, least, most) => Math.max(least, Math.min(most, value));

/** Projects a point to pixels and depth. @param {number[]} m @param {Vec} p @param {number} width @param {number} height @returns {Vec} */
function project(m, [x, y, z], width, height) {
  const at = (/** @type {number} */ row) => m[row] * x + m[4 + row] * y + m[8 + row] * z + m[12 + row];
  const w = at(3);
  return [(0.5 + (0.5 * at(0)) / w) * width, (0.5 - (0.5 * at(1)) / w) * height, at(2) / w];
}
