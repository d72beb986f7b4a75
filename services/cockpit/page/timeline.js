// The time line: everything that happened, below every view, with the cursor that all of them share; and what is under it, to be copied.

import { FRAMES } from "./attitude.js";
import { QUANTITIES, RANGES, placeOf, quaternion } from "./data.js";
import { begin } from "./fly.js";
import { colour, element, write } from "./look.js";
import { LEFT, RIGHT } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./data.js").Told} Told */

/** So near to the cursor an event is told in words, px. */
const NEAR_PX = 6;
const ROW_PX = 16;

export class Timeline {
  /** @param {HTMLElement} place @param {Data} data */
  constructor(place, data) {
    this.data = data;
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("aria-label", "Time line of events; a click sets the cursor, the wheel changes how much is shown, [ and ] go to the event before and after");
    this.told = element("output", "");
    this.frame = /** @type {HTMLSelectElement} */ (element("select", "", ...Object.keys(FRAMES).map((name) => element("option", "", name))));
    this.frame.id = "frame";
    this.copied = element("span", "c-quiet");
    this.copied.setAttribute("role", "status");
    const button = (/** @type {string} */ id, /** @type {string} */ text, /** @type {() => void} */ act) => {
      const made = /** @type {HTMLButtonElement} */ (element("button", "", text));
      made.id = id;
      made.type = "button";
      made.addEventListener("click", act);
      return made;
    };
    place.append(this.canvas, element("div", "told", this.told, this.copied,
      button("zoom-in", "+", () => data.zoom(0.5)), button("zoom-out", "−", () => data.zoom(2)), button("copy-values", "Copy values", () => void this.copyValues()), button("copy-quaternion", "Copy quaternion", () => void this.copyQuaternion()), element("label", "", "in ", this.frame)));
    this.canvas.addEventListener("click", (event) => {
      const near = this.near(event.offsetX);
      const part = (event.offsetX - LEFT) / (this.canvas.clientWidth - LEFT - RIGHT);
      if (part >= 0 && part <= 1) data.go(near?.t ?? this.from + part * (this.to - this.from));
    });
    this.canvas.addEventListener("wheel", (event) => { event.preventDefault(); data.zoom(Math.exp(event.deltaY * 1e-3)); }, { passive: false });
    this.from = 0;
    this.to = 0;
    /** What is drawn, for tests. @type {{ word: string, kind: string, t: number, x: number }[]} */ this.drawn = [];
  }

  /** Of a running system what the strips show, of a recording all of it. @returns {[number, number]} */
  span() {
    const { data } = this;
    return data.recording.length ? [data.standing.t_first_ns * 1e-9, data.standing.t_last_ns * 1e-9] : data.window();
  }

  /** @param {number} t */
  x(t) {
    return LEFT + ((t - this.from) / (this.to - this.from || 1)) * (this.canvas.clientWidth - LEFT - RIGHT);
  }

  /** The event next to a place. @param {number} x @returns {Told | null} */
  near(x) {
    /** @type {Told | null} */ let found = null;
    for (const told of this.data.events) {
      const off = told.t === null ? NaN : Math.abs(this.x(told.t) - x);
      if (off <= NEAR_PX && (!found || off <= Math.abs(this.x(found.t ?? NaN) - x))) found = told;
    }
    return found;
  }

  /** Goes to the event before or after the cursor. @param {number} way −1 or 1 */
  step(way) {
    const at = this.data.cursor ?? this.data.shown()?.t;
    // Where there is no cursor, the picture of an event is a little later than it.
    const least = this.data.cursor === null ? 0.05 : 1e-6;
    const times = this.data.events.map((told) => told.t ?? NaN).filter((t) => at !== undefined && (t - at) * way > least && t >= this.from && t <= this.to);
    if (times.length) this.data.go(way < 0 ? Math.max(...times) : Math.min(...times));
  }

  draw() {
    const made = begin(this.canvas);
    if (!made) return;
    const [context, width, height] = made;
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
    // The newest words have the room; what has none is a mark.
    const taken = [width, width];
    const places = shown.map((told) => {
      const row = told.kind === "FLAG" ? 1 : 0, y = 3 + row * ROW_PX, x = Math.max(LEFT, this.x(told.t ?? 0));
      const wide = told.until === null ? 0 : this.x(told.until) - x;
      const look = colour(told.fault ? "fault" : told.word.includes("swap") ? "fused" : told.word.includes("shadow") ? "shadow" : "ink");
      context.fillStyle = look;
      if (row) context.fillRect(x - 1, y + 1, Math.max(2, wide), ROW_PX - 3);
      else if (told.fault) { context.beginPath(); context.moveTo(x - 5, y + 13); context.lineTo(x, y + 2); context.lineTo(x + 5, y + 13); context.fill(); }
      else context.fillRect(x - 2, y + 2, 4, 12);
      return { told, row, y, x, wide, look };
    });
    // Words stand on the marks of all.
    for (const { told, row, y, x, wide, look } of places.reverse()) {
      context.fillStyle = look;
      const from = x + Math.max(wide, 5) + 4, length = context.measureText(told.word).width, before = taken[row];
      taken[row] = Math.min(taken[row], x - 6);
      if (from + length + 6 <= before) context.fillText(told.word, from, y + 12);
      else if (x - 9 <= before && x - length - 9 > LEFT) {
        context.fillText(told.word, x - length - 9, y + 12);
        taken[row] = x - length - 15;
      }
      this.drawn.push({ word: told.word, kind: told.kind, t: told.t ?? 0, x });
    }
    const at = data.shown()?.t;
    if (at !== undefined && (data.cursor !== null || data.recording.length)) {
      const x = this.x(at);
      context.strokeStyle = colour("ink");
      context.setLineDash([2, 3]);
      context.beginPath(); context.moveTo(x, 0); context.lineTo(x, height); context.stroke();
      context.setLineDash([]);
    }
    const told = data.cursor !== null && at !== undefined ? this.near(this.x(data.cursor)) : null;
    const last = told ?? data.events.at(-1);
    const text = last ? `${last.t === null || Number.isNaN(last.t) ? "before" : `${last.t.toFixed(2)} s`}: ${last.text}` : "Nothing has happened since the page's program joined the system.";
    write(this.told, text);
    this.told.className = last?.fault ? "c-fault" : last ? "" : "c-quiet";
  }

  /** What is under the cursor, as CSV: of what has a range within the picture the least and the most. */
  async copyValues() {
    const frame = this.data.shown();
    if (!frame) return;
    const columns = QUANTITIES.flatMap((name) => {
      const [least, most] = frame.values.subarray(placeOf(name));
      return Number.isNaN(most) ? [] : RANGES.has(name) ? [[`${name}_least`, least], [`${name}_most`, most]] : [[name, most]];
    });
    const q = quaternion(frame.picture.attitude?.quaternion);
    const all = [["t_s", frame.t], ...(q ? q.map((part, at) => [`q${"wxyz"[at]}`, part]) : []), ...columns];
    await this.copy(`${all.map(([name]) => name).join(",")}\n${all.map(([, value]) => value).join(",")}\n`, `${all.length} values`);
  }

  /** The attitude under the cursor, w x y z, in the frame that is chosen. */
  async copyQuaternion() {
    const q = quaternion(this.data.shown()?.picture.attitude?.quaternion);
    if (q) await this.copy(FRAMES[this.frame.value](q).join(", "), `w, x, y, z in ${this.frame.value}`);
  }

  /** @param {string} text @param {string} what */
  async copy(text, what) {
    try {
      await navigator.clipboard.writeText(text);
      this.copied.textContent = `copied: ${what}`;
    } catch (error) {
      this.copied.textContent = `not copied, the browser does not let it be: ${error}`;
    }
  }
}
