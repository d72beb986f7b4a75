// Fleet view: one row per available vehicle. A click selects the vehicle.

import { DEGREE, angles } from "./attitude.js";
import { quaternion } from "./data.js";
import { courseReference, degrees } from "./fly.js";
import { button, colour, createCanvas, element, prepareCanvas, statusLine, strokeLine, table, write } from "./ui.js";
import { signed } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./wire.js").Message} Message */

/** Age above which an attitude counts as old, s. Rows are updated once a second. */
const MAX_AGE_S = 2;
const COLUMNS = ["", "vehicle", "roll", "pitch", "course", "age", "lost on board", "lost in transit", "stage", "services"];

export class Fleet {
  /** @param {HTMLElement} parent @param {Data} data @param {(name: string) => void} onSelect */
  constructor(parent, data, onSelect) {
    this.data = data;
    this.onSelect = onSelect;
    this.rows = element("tbody", "");
    this.note = element("p", "c-quiet");
    this.summary = statusLine("summary");
    this.filter = element("input", "");
    this.filter.id = "filter";
    this.filter.type = "search";
    this.filter.size = 14;
    this.problemsFirst = element("input", "");
    this.problemsFirst.id = "problems-first";
    this.problemsFirst.type = "checkbox";
    this.controls = element("div", "actions", element("label", "", "name or stage ", this.filter), element("label", "", this.problemsFirst, " problems first"));
    parent.replaceChildren(element("h2", "", "Vehicles"), this.summary, this.controls, table("fleet", COLUMNS.map((name) => [name, columnClass(name)]), this.rows), this.note);
    /** Row of each vehicle. @type {Map<string, HTMLTableRowElement>} */ this.rowOf = new Map();
    /** Names of the vehicles whose rows are shown, joined. */ this.names = "";
    /** Content shown, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  draw() {
    const { systemStatus } = this.data;
    const all = systemStatus.vehicles?.length ? systemStatus.vehicles : this.ownVehicle();
    const wanted = this.filter.value.trim().toLowerCase();
    const vehicles = all.filter(({ vehicle, stage }) => `${vehicle} ${stage}`.toLowerCase().includes(wanted));
    if (this.problemsFirst.checked) vehicles.sort((a, b) => Number(hasProblem(b)) - Number(hasProblem(a)));
    const names = vehicles.map((line) => line.vehicle).join(" ");
    if (names !== this.names) {
      this.names = names;
      for (const name of this.rowOf.keys()) if (!all.some((line) => line.vehicle === name)) this.rowOf.delete(name);
      this.rows.replaceChildren(...vehicles.map((line) => this.row(line.vehicle)));
    }
    this.controls.hidden = all.length < 2;
    const count = (/** @type {(line: Message) => boolean} */ test) => all.filter(test).length;
    write(this.summary, all.length < 2 ? "" : `${all.length} vehicles: ${count((line) => !isOld(line))} current, ${count((line) => line.alive && isOld(line))} old, ${count((line) => !line.alive)} unreachable; ${count(hasLost)} with losses${wanted ? `; ${vehicles.length} shown` : ""}`);
    write(this.note, systemStatus.vehicles?.length ? "" : systemStatus.state === "STATE_UNSELECTED" ? "No vehicle has been found yet. Systems with a gateway appear here; `--connect` of `plumb view` names their endpoints." : "This page shows one system. Run `plumb view --remote --connect ENDPOINT` to show all vehicles on the network.");
    this.drawn = { vehicles: [], summary: this.summary.textContent };
    for (const line of vehicles) this.fillRow(this.row(line.vehicle), line);
  }

  /** Returns the system shown as the only vehicle. @returns {Message[]} */
  ownVehicle() {
    const { systemStatus } = this.data;
    if (!systemStatus.system) return [];
    const statuses = (systemStatus.services ?? []).map((service) => service.status);
    const statusOf = (/** @type {string} */ name) => statuses.find((status) => status.service === name);
    const isRecording = this.data.recording.length > 0;
    const age_s = isRecording ? Infinity : (performance.now() - this.data.received_ms) / 1000;
    const services = statuses.filter((status) => status.state === "running").map((status) => status.service);
    return [{ vehicle: systemStatus.system, alive: isRecording || systemStatus.state === "STATE_LIVE", age_s: Number.isFinite(age_s) ? age_s : null, attitude: this.data.newest.attitude, lost_messages: 0, lost_ticks: statusOf("course")?.lost ?? null, stage: statusOf("fuser")?.stage ?? "", services }];
  }

  /** Returns the row of a vehicle. @param {string} name */
  row(name) {
    const row = this.rowOf.get(name) ?? this.createRow(name);
    this.rowOf.set(name, row);
    return row;
  }

  /** @param {string} name */
  createRow(name) {
    const canvas = createCanvas();
    canvas.setAttribute("aria-hidden", "true");
    const chosen = button("", name, () => this.onSelect(name));
    chosen.dataset.vehicle = name;
    chosen.disabled = !this.data.systemStatus.vehicles?.length;
    return element("tr", "", element("td", "", canvas), element("td", "", chosen), ...COLUMNS.slice(2).map((column) => element("td", columnClass(column), "–")));
  }

  /** @param {Element} row @param {Message} line */
  fillRow(row, line) {
    const { attitude, age_s, alive, lost_messages, lost_ticks, stage, services } = line;
    const old = isOld(line);
    row.classList.toggle("old", old);
    const q = quaternion(attitude?.quaternion);
    const [, pitch, roll] = q ? angles(q) : [0, 0, 0];
    const cells = [
      q ? `${signed(roll / DEGREE, 1)}°` : "–", q ? `${signed(pitch / DEGREE, 1)}°` : "–",
      attitude ? `${degrees(attitude.course_rad)}° ${courseReference(attitude.course_reference)}` : "–",
      age_s === null ? "–" : `${age_s.toFixed(1)} s`, lost_ticks === null ? "–" : String(lost_ticks), String(lost_messages),
      stage || "–", alive ? services.join(" ") : "unreachable",
    ];
    cells.forEach((text, at) => write(row.children[at + 2], text));
    row.children[6].classList.toggle("c-fault", lost_ticks > 0);
    row.children[7].classList.toggle("c-fault", lost_messages > 0);
    this.drawn.vehicles.push({ vehicle: line.vehicle, quaternion: q, old, lost_ticks, lost_messages, stage });
    drawGlyph(/** @type {HTMLCanvasElement} */ (row.querySelector("canvas")), q ? [pitch, roll] : null);
  }
}

/** Returns whether the attitude of a vehicle is not current. @param {Message} line */
const isOld = ({ alive, age_s }) => !alive || age_s === null || age_s > MAX_AGE_S;

/** @param {Message} line */
const hasLost = ({ lost_ticks, lost_messages }) => lost_ticks > 0 || lost_messages > 0;

/** @param {Message} line */
const hasProblem = (line) => isOld(line) || hasLost(line);

/** Returns the classes of a column. Numbers are aligned to the right; details are hidden on small screens. @param {string} name */
const columnClass = (name) => [["", "vehicle", "stage", "services"].includes(name) ? "" : "number", ["roll", "pitch", "stage", "services"].includes(name) ? "detail" : ""].join(" ").trim();

/** Draws a small horizon. @param {HTMLCanvasElement} canvas @param {[number, number] | null} angles Pitch and roll, rad */
function drawGlyph(canvas, angles) {
  const prepared = prepareCanvas(canvas);
  if (!prepared || !angles) return;
  const [context, width, height] = prepared;
  const r = Math.min(width, height) / 2 - 1;
  context.translate(width / 2, height / 2);
  context.save();
  context.beginPath(); context.arc(0, 0, r, 0, 7); context.clip();
  context.rotate(-angles[1]);
  context.translate(0, (angles[0] / (45 * DEGREE)) * r);
  context.fillStyle = colour("sky"); context.fillRect(-4 * r, -8 * r, 8 * r, 8 * r);
  context.fillStyle = colour("ground"); context.fillRect(-4 * r, 0, 8 * r, 8 * r);
  context.restore();
  context.strokeStyle = colour("fused");
  context.lineWidth = 2;
  strokeLine(context, -0.8 * r, 0, 0.8 * r, 0);
}
