// Timeline of events below every view, with the common cursor and the values at the cursor for copying.

import { FRAMES } from "./attitude.js";
import { QUANTITIES, RANGES, quaternion, valueIndex } from "./data.js";
import { button, colour, createCanvas, element, prepareCanvas, select, strokeCursor, write } from "./ui.js";
import { LEFT, RIGHT } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./data.js").LogEvent} LogEvent */

/** Distance from the cursor within which an event is selected, px. */
const NEAR_PX = 6;
const ROW_PX = 16;

export class Timeline {
  /** @param {HTMLElement} parent @param {Data} data */
  constructor(parent, data) {
    this.data = data;
    this.canvas = createCanvas("Timeline of events; click to set the cursor, use the wheel to zoom, press [ or ] for the previous or next event");
    this.description = element("output", "");
    this.frame = select("frame", Object.keys(FRAMES).map((name) => [name, name]));
    this.copyStatus = element("span", "c-quiet");
    this.copyStatus.setAttribute("role", "status");
    /** Strips of the view; null if it has none. @type {import("./strips.js").Strips | null} */ this.strips = null;
    this.view = "";
    this.choices = element("div", "choices");
    this.choices.popover = "auto";
    this.signals = button("signals", "Signals", () => {});
    this.signals.popoverTargetElement = this.choices;
    this.copyPictureButton = button("copy-picture", "Copy picture", () => void this.copyPicture());
    parent.append(this.canvas, element("div", "controls", this.description, this.copyStatus,
      button("zoom-in", "+", () => data.zoom(0.5)), button("zoom-out", "−", () => data.zoom(2)), this.signals, this.copyPictureButton, button("copy-values", "Copy values", () => void this.copyValues()), button("copy-quaternion", "Copy quaternion", () => void this.copyQuaternion()), element("label", "", "in ", this.frame)), this.choices);
    this.canvas.addEventListener("click", (event) => {
      const near = this.nearestEvent(event.offsetX);
      const part = (event.offsetX - LEFT) / (this.canvas.clientWidth - LEFT - RIGHT);
      if (part >= 0 && part <= 1) data.goTo(near?.t ?? this.from + part * (this.to - this.from));
    });
    this.canvas.addEventListener("wheel", (event) => { event.preventDefault(); data.zoom(Math.exp(event.deltaY * 1e-3)); }, { passive: false });
    this.from = 0;
    this.to = 0;
    /** Events shown, with the extents of their marks and labels, px, for tests. @type {{ label: string, kind: string, t: number, x: number, row: number, until_x: number, text: [number, number] | null }[]} */ this.drawn = [];
  }

  /** Shows the controls of a view's strips. @param {import("./strips.js").Strips | null} strips @param {string} view */
  setStrips(strips, view) {
    this.strips = strips;
    this.view = view;
    this.signals.hidden = this.copyPictureButton.hidden = !strips;
    this.choices.replaceChildren(...(strips ? [strips.choices] : []));
  }

  /** Returns the time span: that of the strips, or the whole recording. @returns {[number, number]} */
  span() {
    const { data } = this;
    return data.recording.length ? [data.systemStatus.t_first_ns * 1e-9, data.systemStatus.t_last_ns * 1e-9] : data.window();
  }

  /** @param {number} t */
  x(t) {
    return LEFT + ((t - this.from) / (this.to - this.from || 1)) * (this.canvas.clientWidth - LEFT - RIGHT);
  }

  /** Returns the event closest to a pixel, within `NEAR_PX`. @param {number} x @returns {LogEvent | null} */
  nearestEvent(x) {
    /** @type {LogEvent | null} */ let nearest = null;
    for (const event of this.data.events) {
      const distance = event.t === null ? NaN : Math.abs(this.x(event.t) - x);
      if (distance <= NEAR_PX && (!nearest || distance <= Math.abs(this.x(nearest.t ?? NaN) - x))) nearest = event;
    }
    return nearest;
  }

  /** Moves the cursor to the previous or next event. @param {number} direction −1 or 1 */
  step(direction) {
    const at = this.data.cursor ?? this.data.shown()?.t;
    // Without a cursor, the frame shown may be slightly later than its event.
    const minimum = this.data.cursor === null ? 0.05 : 1e-6;
    const times = this.data.events.map((event) => event.t ?? NaN).filter((t) => at !== undefined && (t - at) * direction > minimum && t >= this.from && t <= this.to);
    if (times.length) this.data.goTo(direction < 0 ? Math.max(...times) : Math.min(...times));
  }

  draw() {
    const prepared = prepareCanvas(this.canvas);
    if (!prepared) return;
    const [context, width, height] = prepared;
    const { data } = this;
    [this.from, this.to] = this.span();
    context.font = "13px system-ui, sans-serif";
    context.strokeStyle = colour("line");
    context.strokeRect(LEFT, 1.5, width - LEFT - RIGHT, height - 3);
    context.fillStyle = colour("ink");
    context.fillText("events", 8, 15);
    context.fillStyle = colour("quiet");
    context.fillText("flags", 8, 15 + ROW_PX);
    const shown = data.events.filter(({ t, until }) => t !== null && (until ?? t) >= this.from && t <= this.to);
    this.drawn = [];
    const marks = shown.map((event) => {
      const row = event.kind === "FLAG" ? 1 : 0, y = 3 + row * ROW_PX, x = Math.max(LEFT, this.x(event.t ?? 0));
      const length = event.until === null ? 0 : this.x(event.until) - x;
      const style = colour(event.fault ? "fault" : event.label.includes("swap") ? "fused" : event.label.includes("shadow") ? "shadow" : "ink");
      context.fillStyle = style;
      if (row) context.fillRect(x - 1, y + 1, Math.max(2, length), ROW_PX - 3);
      else if (event.fault) { context.beginPath(); context.moveTo(x - 5, y + 13); context.lineTo(x, y + 2); context.lineTo(x + 5, y + 13); context.fill(); }
      else context.fillRect(x - 2, y + 2, 4, 12);
      return { event, row, y, x, length, style };
    });
    // Labels are placed from the newest to the oldest, right or left of their marks. One without room is left out.
    for (const row of [0, 1]) {
      const ofRow = marks.filter((mark) => mark.row === row).sort((a, b) => a.x - b.x);
      let end = width, reach = LEFT - 4;
      // A label also keeps clear of earlier bars that extend beyond its mark.
      const reaches = ofRow.map(({ x, length }) => { const before = reach; reach = Math.max(reach, x + Math.max(length, 5)); return before; });
      for (let at = ofRow.length - 1; at >= 0; at--) {
        const { event, y, x, length, style } = ofRow[at];
        const from = Math.max(x + Math.max(length, 5), reaches[at]) + 4, textWidth = context.measureText(event.label).width, left = x - textWidth - 9;
        /** @type {number | null} */ let start = null;
        context.fillStyle = style;
        if (from + textWidth + 6 <= end) {
          start = from;
          end = x - 6;
        } else if (x - 9 <= end && left > reaches[at] + 4) {
          start = left;
          end = left - 6;
        } else end = Math.min(end, x - 6);
        if (start !== null) context.fillText(event.label, start, y + 12);
        this.drawn.push({ label: event.label, kind: event.kind, t: event.t ?? 0, x, row, until_x: x + length, text: start === null ? null : [start, start + textWidth] });
      }
    }
    const at = data.shown()?.t;
    if (at !== undefined && (data.cursor !== null || data.recording.length)) {
      strokeCursor(context, this.x(at), height);
    }
    const selected = data.cursor !== null && at !== undefined ? this.nearestEvent(this.x(data.cursor)) : null;
    const event = selected ?? data.events.at(-1);
    const text = event ? `${event.t === null || Number.isNaN(event.t) ? "earlier" : data.timeText(event.t)}: ${event.text}` : "No events yet.";
    write(this.description, text);
    this.description.className = event?.fault ? "c-fault" : event ? "" : "c-quiet";
  }

  /** Copies the values at the cursor as CSV, with minimum and maximum of quantities that have a range. */
  async copyValues() {
    const frame = this.data.shown();
    if (!frame) return;
    const columns = QUANTITIES.flatMap((name) => {
      const [min, max] = frame.values.subarray(valueIndex(name));
      return Number.isNaN(max) ? [] : RANGES.has(name) ? [[`${name}_min`, min], [`${name}_max`, max]] : [[name, max]];
    });
    const q = quaternion(frame.snapshot.attitude?.quaternion);
    const all = [["t_s", frame.t], ...(q ? q.map((part, at) => [`q${"wxyz"[at]}`, part]) : []), ...columns];
    await this.copy(`${all.map(([name]) => name).join(",")}\n${all.map(([, value]) => value).join(",")}\n`, `${all.length} values`);
  }

  /** Copies the attitude at the cursor, w x y z, in the selected frame. */
  async copyQuaternion() {
    const q = quaternion(this.data.shown()?.snapshot.attitude?.quaternion);
    if (q) await this.copy(FRAMES[this.frame.value](q).join(", "), `w, x, y, z in ${this.frame.value}`);
  }

  /** Copies a picture of the strips, or saves it if the browser denies access to the clipboard. */
  async copyPicture() {
    if (!this.strips) return;
    const picture = this.strips.picture();
    try {
      await navigator.clipboard.write([new ClipboardItem({ "image/png": picture })]);
      this.copyStatus.textContent = "copied: picture";
    } catch {
      const link = element("a", "");
      link.download = `${this.data.systemStatus.system || "plumbline"}-${this.view}.png`;
      link.href = URL.createObjectURL(await picture);
      link.click();
      URL.revokeObjectURL(link.href);
      this.copyStatus.textContent = `saved: ${link.download}`;
    }
  }

  /** @param {string} text @param {string} what */
  async copy(text, what) {
    try {
      await navigator.clipboard.writeText(text);
      this.copyStatus.textContent = `copied: ${what}`;
    } catch (error) {
      this.copyStatus.textContent = `not copied: the browser denied access to the clipboard (${error})`;
    }
  }
}
