// Strip charts of quantities over time, one below the other, with a common cursor.

/** @typedef {import("./data.js").Data} Data */
/** Line of a strip: its quantity, name, colour and style. @typedef {{ quantity: string, name: string, colour: string, dashed?: boolean, dots?: boolean }} Line */
/** @typedef {{ title: string, unit: string, scale: number, digits: number, lines: Line[] }} Strip */

import { valueIndex } from "./data.js";
import { colour } from "./ui.js";

export class Strips {
  /** @param {HTMLElement} panel @param {Data} data @param {Strip[]} strips */
  constructor(panel, data, strips) {
    this.data = data;
    this.strips = strips;
    this.canvas = document.createElement("canvas");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("aria-label", `Strip charts of ${strips.map((strip) => strip.title).join(", ")}; click to set the cursor, use the wheel to zoom`);
    panel.append(this.canvas);
    this.canvas.addEventListener("click", (event) => {
      const part = (event.offsetX - LEFT) / (this.canvas.clientWidth - LEFT - RIGHT);
      if (part >= 0 && part <= 1) data.goTo(this.from + part * data.span_s);
    });
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      data.zoom(Math.exp(event.deltaY * 1e-3));
    }, { passive: false });
    this.from = 0;
    this.lines = strips.flatMap((strip) => strip.lines);
    this.indices = this.lines.map((line) => valueIndex(line.quantity));
    /** Minimum and maximum per pixel of each line. @type {Float64Array[]} */ this.binned = [];
  }

  draw() {
    const { canvas, data } = this;
    const context = canvas.getContext("2d");
    const ratio = Math.min(devicePixelRatio, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!context || !width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = "13px system-ui, sans-serif";
    [this.from] = data.window();
    const stripHeight = (height - FOOT) / this.strips.length;
    this.bin(Math.max(1, Math.ceil(width - LEFT - RIGHT)));
    this.strips.forEach((strip, index) => this.drawStrip(context, strip, index * stripHeight, stripHeight, width));
    context.fillStyle = colour("quiet");
    context.textAlign = "center";
    for (let part = 0; part <= 4; part++) {
      const t = this.from + (part / 4) * data.span_s;
      const x = LEFT + (part / 4) * (width - LEFT - RIGHT);
      if (t >= (data.frames[0]?.t ?? Infinity)) context.fillText(`${t.toFixed(1)} s`, Math.min(x, width - 30), height - 5);
    }
    if (data.cursor !== null) {
      const x = LEFT + ((data.cursor - this.from) / data.span_s) * (width - LEFT - RIGHT);
      context.strokeStyle = colour("ink");
      context.setLineDash([2, 3]);
      context.beginPath(); context.moveTo(x, 0); context.lineTo(x, height - FOOT); context.stroke();
      context.setLineDash([]);
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {Strip} strip @param {number} top @param {number} height @param {number} width */
  drawStrip(context, strip, top, height, width) {
    const inner = width - LEFT - RIGHT;
    const binned = strip.lines.map((line) => this.binned[this.lines.indexOf(line)]);
    let [least, most] = [Infinity, -Infinity];
    for (const bins of binned) for (let i = 0; i < bins.length; i += 2) { if (bins[i] < least) least = bins[i]; if (bins[i + 1] > most) most = bins[i + 1]; }
    [least, most] = [least * strip.scale, most * strip.scale];
    context.strokeStyle = colour("line");
    context.strokeRect(LEFT, top + 2.5, inner, height - 5);
    context.textAlign = "left";
    context.fillStyle = colour("ink");
    context.fillText(strip.title, 8, top + 17);
    context.fillStyle = colour("quiet");
    context.fillText(strip.unit, 8, top + 33);
    if (!(most >= least)) {
      context.fillText("no data", LEFT + 8, top + height / 2 + 4);
      return;
    }
    const margin = Math.max((most - least) * 0.08, 10 ** -strip.digits / 2);
    [least, most] = [least - margin, most + margin];
    const y = (/** @type {number} */ value) => top + 3 + (1 - (value * strip.scale - least) / (most - least)) * (height - 6);
    strip.lines.forEach((line, index) => {
      context.strokeStyle = context.fillStyle = colour(line.colour);
      context.lineWidth = line.dashed ? 1 : 1.6;
      context.setLineDash(line.dashed ? [5, 3] : []);
      context.beginPath();
      const bins = binned[index];
      let connected = false;
      for (let x = 0; 2 * x < bins.length; x++) {
        const [low, high] = [bins[2 * x], bins[2 * x + 1]];
        if (Number.isNaN(low)) { connected = false; continue; }
        if (line.dots) { if (x % 3 === 0) context.rect(LEFT + x - 1, y(low) - 1, 2, 2); continue; }
        if (connected) context.lineTo(LEFT + x, y(low)); else context.moveTo(LEFT + x, y(low));
        if (high > low) context.lineTo(LEFT + x, y(high));
        connected = true;
      }
      if (line.dots) context.fill(); else context.stroke();
    });
    context.setLineDash([]);
    context.lineWidth = 1;
    context.textAlign = "right";
    context.fillStyle = colour("quiet");
    context.fillText(most.toFixed(strip.digits), LEFT - 4, top + 15);
    context.fillText(least.toFixed(strip.digits), LEFT - 4, top + height - 6);
    context.textAlign = "left";
    const frame = this.data.shown();
    let x = LEFT + 8;
    for (const line of strip.lines) {
      const value = frame?.values[valueIndex(line.quantity) + 1] ?? NaN;
      const text = `${line.name} ${Number.isNaN(value) ? "–" : signed(value * strip.scale, strip.digits)}`;
      context.fillStyle = colour(line.colour);
      context.fillText(text, x, top + 17);
      x += context.measureText(text).width + 16;
    }
  }

  /** Computes the minimum and maximum of each line per pixel, NaN if empty. One pass through the frames serves all lines. @param {number} count */
  bin(count) {
    if (this.binned[0]?.length !== 2 * count) this.binned = this.indices.map(() => new Float64Array(2 * count));
    for (const bins of this.binned) bins.fill(NaN);
    const { indices } = this;
    const { frames, span_s } = this.data;
    const lastPixel = indices.map(() => -1);
    // Gaps longer than half a second remain visible.
    const gap = (0.5 / span_s) * count;
    for (const frame of frames) {
      const x = Math.floor(((frame.t - this.from) / span_s) * count);
      if (x < 0 || x >= count) continue;
      for (let at = 0; at < indices.length; at++) {
        const low = frame.values[indices[at]], high = frame.values[indices[at] + 1];
        if (Number.isNaN(low)) continue;
        const bins = this.binned[at], last = lastPixel[at];
        if (last === x) {
          if (low < bins[2 * x]) bins[2 * x] = low;
          if (high > bins[2 * x + 1]) bins[2 * x + 1] = high;
          continue;
        }
        if (last >= 0 && x - last < gap) bins.fill(low, 2 * (last + 1), 2 * x);
        bins[2 * x] = low;
        bins[2 * x + 1] = high;
        lastPixel[at] = x;
      }
    }
  }
}

/** Left and right margins of the strips and the timeline. The left one holds the titles. */
export const LEFT = 118, RIGHT = 8;
const FOOT = 20;

/** Formats a number with its sign. @param {number} value @param {number} digits */
export const signed = (value, digits) => (value >= 0 ? "+" : "−") + Math.abs(value).toFixed(digits);
