// Strip charts of quantities over time, one below the other, with a common time axis and cursor.

/** @typedef {import("./data.js").Data} Data */
/** Line of a strip: its quantity, name, colour and style. @typedef {{ quantity: string, name: string, colour: string, style?: "dashed" | "dots" }} Line */
/** Strip of lines. `scale` converts a quantity to `unit`. `least` and `most` are the limits of the quantity, in `unit`. With `wraps`, ±180° are equal. A `robust` axis does not extend to rare large values, which are marked instead. An `optional` strip is shown only if it has values.
 * @typedef {{ title: string, unit: string, scale: number, digits: number, least?: number, most?: number, wraps?: boolean, robust?: boolean, optional?: boolean, lines: Line[] }} Strip */

import { valueIndex } from "./data.js";
import { colour, createCanvas, element, prepareCanvas, store, stored, strokeCursor, write } from "./ui.js";

/** Returns a line of a strip. @param {string} quantity @param {string} name @param {string} colour @param {"dashed" | "dots"} [style] @returns {Line} */
export const line = (quantity, name, colour, style) => ({ quantity, name, colour, style });

/** Returns the lines of the components of a vector. @param {string} quantity @param {string} unit */
export const axisLines = (quantity, unit) => ["x", "y", "z"].map((axis) => line(`${quantity}_${axis}_${unit}`, axis, `axis-${axis}`));

/** Horizontal movement from which a press selects a time span, px. */
const MIN_BRUSH_PX = 6;
/** Minimum distance between two labels of the value axis and of the time axis, px. */
const MIN_ROW_PX = 17, MIN_COLUMN_PX = 66;

/** Names of the strips and lines that are hidden. The browser remembers them. @type {Set<string>} */
const hidden = new Set((stored("localStorage", "hidden") ?? "").split("\n").filter(Boolean));

export class Strips {
  /** @param {HTMLElement} panel @param {Data} data @param {string} view Name of the view @param {Strip[]} strips */
  constructor(panel, data, view, strips) {
    this.data = data;
    this.view = view;
    this.strips = strips;
    this.panel = panel;
    this.canvas = createCanvas(`Strip charts of ${strips.map((strip) => strip.title).join(", ")}; click to set the cursor, drag to zoom to a time span, use the wheel to zoom, double-click to show all`);
    this.canvas.tabIndex = 0;
    panel.classList.add("strips");
    panel.append(this.canvas);
    panel.style.setProperty("--strips", String(strips.length));
    /** Start of a drag and its present end, px. @type {[number, number] | null} */ this.brush = null;
    this.canvas.addEventListener("pointerdown", (event) => { this.canvas.setPointerCapture(event.pointerId); this.brush = [event.offsetX, event.offsetX]; });
    this.canvas.addEventListener("pointermove", (event) => { if (this.brush) this.brush[1] = event.offsetX; });
    this.canvas.addEventListener("pointercancel", () => { this.brush = null; });
    this.canvas.addEventListener("pointerup", () => this.endBrush());
    this.canvas.addEventListener("dblclick", () => data.showAll());
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      data.zoom(Math.exp(event.deltaY * 1e-3));
    }, { passive: false });
    this.from = 0;
    this.lines = strips.flatMap((strip) => strip.lines);
    this.indices = this.lines.map((line) => valueIndex(line.quantity));
    /** Whether ±180° are equal, for each line. */ this.wraps = strips.flatMap((strip) => strip.lines.map(() => strip.wraps ?? false));
    /** Minimum and maximum per pixel of each line. @type {Float64Array[]} */ this.binned = [];
    /** Whether each line has values in the time span. @type {boolean[]} */ this.hasValues = [];
    /** Axis of each strip drawn last, its lines, the largest step within a line and the largest value that is cut off, in the unit of the strip, for tests. @type {{ title: string, least: number, most: number, ticks: number[], largest_step: number, cut_off: number | null, lines: string[] }[]} */ this.drawn = [];
    /** Value of each line in the legend. @type {HTMLElement[]} */ this.values = [];
    /** Entries of the legend. @type {HTMLButtonElement[]} */ this.entries = [];
    /** Largest value that is cut off, for each strip. */ this.cutOffs = strips.map(() => element("span", "cut-off number"));
    this.legends = strips.map((strip, number) => element("div", "", ...strip.lines.map((line) => this.legendEntry(strip, line)), this.cutOffs[number]));
    panel.append(element("div", "strip-legends", ...this.legends));
    /** Controls that select strips and lines. */
    this.choices = element("div", "", ...strips.map((strip) => element("fieldset", "", this.choice(strip), ...(strip.lines.length > 1 ? strip.lines.map((line) => this.choice(strip, line)) : []))));
  }

  /** Returns the name under which a strip or a line is hidden. @param {Strip} strip @param {Line} [line] */
  key(strip, line) {
    return [this.view, strip.title, ...(line ? [line.name] : [])].join("/");
  }

  /** @param {Strip} strip @param {Line} [line] */
  toggle(strip, line) {
    const key = this.key(strip, line);
    if (!hidden.delete(key)) hidden.add(key);
    store("localStorage", "hidden", [...hidden].join("\n"));
  }

  /** Returns the button that shows or hides a line. @param {Strip} strip @param {Line} line */
  legendEntry(strip, line) {
    const value = element("span", "number");
    const button = element("button", "", line.name, " ", value);
    button.title = `Show or hide ${line.name}`;
    button.style.color = `var(--${line.colour})`;
    button.addEventListener("click", () => this.toggle(strip, line));
    this.entries.push(button);
    this.values.push(value);
    return button;
  }

  /** Returns the check box that shows or hides a strip or a line. @param {Strip} strip @param {Line} [line] */
  choice(strip, line) {
    const box = element("input", "");
    box.type = "checkbox";
    box.name = this.key(strip, line);
    box.addEventListener("change", () => this.toggle(strip, line));
    return element("label", line ? "" : "title", box, line?.name ?? strip.title);
  }

  /** Shows which strips and lines are hidden in the legend and the controls. */
  updateControls() {
    let at = 0;
    this.strips.forEach((strip, number) => {
      this.legends[number].hidden = !this.isShown(strip);
      for (const line of strip.lines) {
        // A line without values, such as the error without a reference, has no entry.
        this.entries[at].hidden = !this.hasValues[at];
        this.entries[at++].setAttribute("aria-pressed", String(!hidden.has(this.key(strip, line))));
      }
    });
    for (const box of this.choices.querySelectorAll("input")) box.checked = !hidden.has(box.name);
  }

  /** @param {Strip} strip */
  isShown(strip) {
    return !hidden.has(this.key(strip)) && (!strip.optional || strip.lines.some((line) => this.hasValues[this.lines.indexOf(line)]));
  }

  /** Returns a picture of the strips with their legends, as PNG. @returns {Promise<Blob>} */
  picture() {
    const { canvas } = this, ratio = canvas.width / canvas.clientWidth;
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [canvas.width, canvas.height];
    const context = copy.getContext("2d");
    if (!context) return Promise.reject(new Error("no canvas"));
    context.fillStyle = colour("panel");
    context.fillRect(0, 0, copy.width, copy.height);
    context.drawImage(canvas, 0, 0);
    context.scale(ratio, ratio);
    context.font = FONT;
    context.textBaseline = "middle";
    const { left, top } = canvas.getBoundingClientRect();
    for (const entry of [...this.entries, ...this.cutOffs].filter((entry) => entry.checkVisibility() && entry.getAttribute("aria-pressed") !== "false")) {
      const place = entry.getBoundingClientRect();
      context.fillStyle = getComputedStyle(entry).color;
      context.fillText(entry.textContent ?? "", place.left - left + 6, (place.top + place.bottom) / 2 - top);
    }
    return new Promise((resolve, reject) => copy.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("the picture is empty"))), "image/png"));
  }

  /** Sets the cursor after a click, or the time span after a drag. */
  endBrush() {
    if (!this.brush) return;
    const [start, end] = this.brush;
    const inner = this.canvas.clientWidth - LEFT - RIGHT;
    const time = (/** @type {number} */ x) => this.from + Math.max(0, Math.min(1, (x - LEFT) / inner)) * this.data.span_s;
    this.brush = null;
    if (Math.abs(end - start) >= MIN_BRUSH_PX) this.data.showSpan(time(Math.min(start, end)), time(Math.max(start, end)));
    else if (end >= LEFT && end <= LEFT + inner) this.data.goTo(time(end));
  }

  draw() {
    const { data } = this;
    const prepared = prepareCanvas(this.canvas);
    if (!prepared) return;
    const [context, width, height] = prepared;
    context.font = FONT;
    [this.from] = data.window();
    const inner = width - LEFT - RIGHT;
    this.bin(Math.max(1, Math.ceil(inner)));
    const strips = this.strips.filter((strip) => this.isShown(strip));
    this.panel.style.setProperty("--strips", String(Math.max(1, strips.length)));
    this.updateControls();
    const stripHeight = (height - FOOT) / strips.length;
    const x = (/** @type {number} */ t) => LEFT + ((t - this.from) / data.span_s) * inner;
    // Times are counted from the origin, so that the ticks are round numbers.
    const origin = data.origin(), step = niceStep(data.span_s / Math.max(1, inner / MIN_COLUMN_PX));
    const times = ticks(this.from - origin, this.from + data.span_s - origin, step).filter((t) => t + origin >= (data.frames[0]?.t ?? Infinity) - 1e-9);
    const columns = times.map((t) => x(t + origin));
    this.drawn = strips.map((strip, index) => this.drawStrip(context, strip, index * stripHeight, stripHeight, width, columns));
    context.fillStyle = colour("quiet");
    if (!strips.length) context.fillText("All strips are hidden. Select them under Signals.", LEFT, height / 2);
    context.textAlign = "center";
    const digits = digitsOf(step);
    times.forEach((t, at) => context.fillText(`${t.toFixed(digits)} s`, Math.max(LEFT + 16, Math.min(columns[at], width - 30)), height - 5));
    if (data.cursor !== null) strokeCursor(context, x(data.cursor), height - FOOT);
    if (this.brush && Math.abs(this.brush[1] - this.brush[0]) >= MIN_BRUSH_PX) {
      const [start, end] = this.brush.map((at) => Math.max(LEFT, Math.min(width - RIGHT, at)));
      context.fillStyle = colour("fused");
      context.globalAlpha = 0.18;
      context.fillRect(start, 0, end - start, height - FOOT);
      context.globalAlpha = 1;
    }
    const frame = data.shown();
    let at = 0;
    for (const strip of this.strips) for (const line of strip.lines) {
      const value = frame?.values[valueIndex(line.quantity) + 1] ?? NaN;
      write(this.values[at++], Number.isNaN(value) ? "–" : strip.least === 0 ? (value * strip.scale).toFixed(strip.digits) : signed(value * strip.scale, strip.digits));
    }
  }

  /** Draws a strip and returns its axis. @param {CanvasRenderingContext2D} context @param {Strip} strip @param {number} top @param {number} height @param {number} width @param {number[]} columns Positions of the time ticks, px */
  drawStrip(context, strip, top, height, width, columns) {
    const inner = width - LEFT - RIGHT;
    // The legend is above the curves.
    const [from, to] = [top + LEGEND, top + height - 5];
    const lines = strip.lines.filter((line) => !hidden.has(this.key(strip, line)));
    const binned = lines.map((line) => this.binned[this.lines.indexOf(line)]);
    let [least, most] = [Infinity, -Infinity];
    for (const bins of binned) for (let i = 0; i < bins.length; i += 2) { if (bins[i] < least) least = bins[i]; if (bins[i + 1] > most) most = bins[i + 1]; }
    [least, most] = [least * strip.scale, most * strip.scale];
    const largest = most;
    if (strip.robust) most = Math.min(most, robustMost(binned) * strip.scale);
    const unit = strip.unit === "°" ? "°" : ` ${strip.unit}`;
    write(this.cutOffs[this.strips.indexOf(strip)], largest > most ? `▲ up to ${largest.toFixed(strip.digits)}${unit}` : "");
    context.strokeStyle = colour("line");
    context.strokeRect(LEFT, from + 0.5, inner, to - from);
    context.textAlign = "left";
    context.fillStyle = colour("ink");
    context.fillText(strip.title, 8, top + 15);
    context.fillStyle = colour("quiet");
    context.fillText(strip.unit, 8, top + 31);
    const drawn = { title: strip.title, least: NaN, most: NaN, ticks: /** @type {number[]} */ ([]), largest_step: 0, cut_off: /** @type {number | null} */ (null), lines: lines.map((line) => line.name) };
    if (!(most >= least)) {
      context.fillText(lines.length ? "no data" : "all lines are hidden", LEFT + 8, (from + to) / 2 + 4);
      return drawn;
    }
    const margin = Math.max((most - least) * 0.08, 10 ** -strip.digits / 2);
    // No value lies beyond the limits of the quantity.
    least = Math.max(least - margin, strip.least ?? -Infinity);
    most = Math.min(most + margin, strip.most ?? Infinity);
    if (!(most > least)) [least, most] = [least - margin, most + margin];
    const place = (/** @type {number} */ value) => to - ((value - least) / (most - least)) * (to - from);
    const y = (/** @type {number} */ value) => place(value * strip.scale);
    const step = niceStep((most - least) / Math.max(1, Math.floor((to - from) / MIN_ROW_PX)), strip.wraps ? ANGLE_STEPS : undefined);
    Object.assign(drawn, { least, most, ticks: ticks(least, most, step) });
    context.textAlign = "right";
    context.beginPath();
    for (const value of drawn.ticks) {
      const row = Math.round(place(value)) + 0.5;
      context.moveTo(LEFT, row); context.lineTo(LEFT + inner, row);
      context.fillText(minus(value.toFixed(digitsOf(step))), LEFT - 4, Math.max(from + 9, Math.min(row + 4, to)));
    }
    for (const column of columns) { context.moveTo(Math.round(column) + 0.5, from); context.lineTo(Math.round(column) + 0.5, to); }
    context.globalAlpha = 0.55;
    context.stroke();
    context.globalAlpha = 1;
    // Mitred corners of steep lines would exceed the axis.
    context.lineJoin = "bevel";
    context.save();
    context.beginPath();
    context.rect(LEFT, from, inner, to - from);
    context.clip();
    const half_turn = strip.wraps ? Math.PI : Infinity;
    lines.forEach((line, index) => {
      context.strokeStyle = context.fillStyle = colour(line.colour);
      context.lineWidth = line.style === "dashed" ? 1 : 1.6;
      context.setLineDash(line.style === "dashed" ? [5, 3] : []);
      context.beginPath();
      const bins = binned[index];
      /** Previous value that is connected to the next one. */ let previous = NaN;
      for (let x = 0; 2 * x < bins.length; x++) {
        const [low, high] = [bins[2 * x], bins[2 * x + 1]];
        if (Number.isNaN(low)) { previous = NaN; continue; }
        if (line.style === "dots") { if (x % 3 === 0) context.rect(LEFT + x - 1, y(low) - 1, 2, 2); continue; }
        if (high - low > half_turn) {
          // The angle has passed ±180° within the pixel.
          for (const value of [low, high]) { context.moveTo(LEFT + x, y(value)); context.lineTo(LEFT + x + 1, y(value)); }
          previous = NaN;
          continue;
        }
        // A gap, or an angle that has passed ±180°, interrupts the line.
        const step = Math.abs(low - previous);
        if (step <= half_turn) {
          context.lineTo(LEFT + x, y(low));
          drawn.largest_step = Math.max(drawn.largest_step, step * strip.scale);
        } else context.moveTo(LEFT + x, y(low));
        if (high > low) context.lineTo(LEFT + x, y(high));
        previous = low;
      }
      if (line.style === "dots") context.fill(); else context.stroke();
    });
    context.restore();
    if (largest > most) {
      drawn.cut_off = largest;
      this.markCutOff(context, lines, most / strip.scale, from);
    }
    return drawn;
  }

  /** Marks the values above an axis. @param {CanvasRenderingContext2D} context @param {Line[]} lines @param {number} most End of the axis @param {number} top px */
  markCutOff(context, lines, most, top) {
    for (const line of lines) {
      const bins = this.binned[this.lines.indexOf(line)];
      context.fillStyle = colour(line.colour);
      for (let x = 0; 2 * x < bins.length; x++) if (bins[2 * x + 1] > most) context.fillRect(LEFT + x, top - 1, 1, 4);
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
    for (let number = this.data.indexAt(this.from); number < frames.length; number++) {
      const frame = frames[number];
      const x = Math.floor(((frame.t - this.from) / span_s) * count);
      // The newest frame is at the end of the span.
      if (x > count) break;
      if (x < 0) continue;
      const pixel = Math.min(x, count - 1);
      for (let at = 0; at < indices.length; at++) {
        const low = frame.values[indices[at]], high = frame.values[indices[at] + 1];
        if (Number.isNaN(low)) continue;
        const bins = this.binned[at], last = lastPixel[at];
        if (last === pixel) {
          if (low < bins[2 * pixel]) bins[2 * pixel] = low;
          if (high > bins[2 * pixel + 1]) bins[2 * pixel + 1] = high;
          continue;
        }
        if (last >= 0 && pixel - last < gap) this.connect(at, last, pixel, low);
        bins[2 * pixel] = low;
        bins[2 * pixel + 1] = high;
        lastPixel[at] = pixel;
      }
    }
    this.hasValues = lastPixel.map((pixel) => pixel >= 0);
  }

  /** Fills the pixels between two values of a line, unless the angle passes ±180° in between. @param {number} at Number of the line @param {number} last Pixel of the first value @param {number} pixel Pixel of the second value @param {number} low The second value */
  connect(at, last, pixel, low) {
    const bins = this.binned[at], first = bins[2 * last];
    const change = this.wraps[at] && Math.abs(low - first) > Math.PI ? 0 : low - first;
    for (let x = last + 1; x < pixel; x++) bins[2 * x] = bins[2 * x + 1] = first + (change * (x - last)) / (pixel - last);
  }
}

/** Left and right margins of the strips and the timeline. The left one holds the titles. */
export const LEFT = 118, RIGHT = 8;
/** Heights of the time axis and of a legend, px. */
const FOOT = 20, LEGEND = 20;
const FONT = "13px system-ui, sans-serif";
/** Minimum fraction of the values that a robust axis covers, and the ratio of the largest value to the covered ones above which it is cut off. */
const COVERED = 0.95, MAX_RATIO = 4;
/** Steps of an axis of angles, °. */
const ANGLE_STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45, 90, 180];

/** Returns the end of a robust axis: the largest value unless it is much larger than nearly all others. @param {Float64Array[]} binned Minimum and maximum per pixel of each line */
function robustMost(binned) {
  let most = 0;
  for (const bins of binned) {
    const sorted = bins.filter((value, at) => at % 2 === 1 && !Number.isNaN(value)).sort();
    if (!sorted.length) continue;
    const [covered, largest] = [sorted[Math.floor((sorted.length - 1) * COVERED)], sorted[sorted.length - 1]];
    most = Math.max(most, covered > 0 && largest > MAX_RATIO * covered ? (MAX_RATIO / 2) * covered : largest);
  }
  return most;
}

/** Returns the smallest round step that is at least `minimum`: 1, 2 or 5 times a power of ten, or one of `steps`. @param {number} minimum @param {number[]} [steps] */
export function niceStep(minimum, steps) {
  const known = steps?.find((step) => step >= minimum);
  if (known !== undefined && minimum >= (steps?.[0] ?? 0)) return known;
  const power = 10 ** Math.floor(Math.log10(minimum));
  return (/** @type {number} */ ([1, 2, 5, 10].find((factor) => factor * power >= minimum * (1 - 1e-9)) ?? 10)) * power;
}

/** Returns the multiples of `step` from `least` to `most`. @param {number} least @param {number} most @param {number} step @returns {number[]} */
export function ticks(least, most, step) {
  const first = Math.ceil(least / step - 1e-9), last = Math.floor(most / step + 1e-9);
  return Array.from({ length: Math.max(0, Math.min(100, last - first + 1)) }, (_, at) => (first + at) * step);
}

/** Returns the number of decimal places of a step. @param {number} step */
const digitsOf = (step) => Math.max(0, Math.min(9, -Math.floor(Math.log10(step) + 1e-9)));

/** @param {string} text */
const minus = (text) => (/^-0\.?0*$/.test(text) ? text.slice(1) : text.replace("-", "−"));

/** Formats a number with its sign. @param {number} value @param {number} digits */
export const signed = (value, digits) => (value >= 0 ? "+" : "−") + Math.abs(value).toFixed(digits);
