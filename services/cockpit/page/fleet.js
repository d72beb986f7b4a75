// Fleet: who is there. A line of each vehicle in sight; one is chosen by a click.

import { DEGREE, angles } from "./attitude.js";
import { quaternion } from "./data.js";
import { begin, countedFrom, degrees } from "./fly.js";
import { colour, element, write } from "./look.js";
import { signed } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./wire.js").Message} Message */

/** An attitude that is older is said to be old, s: a line comes once a second. */
const OLD_S = 2;
const HEADS = ["", "vehicle", "roll", "pitch", "course", "age", "lost on board", "lost on the way", "stage", "services"];

export class Fleet {
  /** @param {HTMLElement} place @param {Data} data @param {(name: string) => void} choose */
  constructor(place, data, choose) {
    this.data = data;
    this.choose = choose;
    const head = element("thead", "", element("tr", "", ...HEADS.map((name) => element("th", look(name), name))));
    this.lines = element("tbody", "");
    this.note = element("p", "c-quiet");
    place.replaceChildren(element("h2", "", "Vehicles in sight"), element("table", "fleet", head, this.lines), this.note);
    /** Names of the vehicles that have a row. */ this.names = "";
    /** What is drawn, for tests. @type {Record<string, any>} */ this.drawn = {};
  }

  draw() {
    const { standing } = this.data;
    const vehicles = standing.vehicles?.length ? standing.vehicles : this.own();
    const names = vehicles.map((/** @type {Message} */ one) => one.vehicle).join(" ");
    if (names !== this.names) {
      this.names = names;
      this.lines.replaceChildren(...vehicles.map((/** @type {Message} */ one) => this.row(one.vehicle)));
    }
    write(this.note, standing.vehicles?.length ? "" : "This page shows one system. `plumb view --remote --connect ENDPOINT` shows every vehicle that is reached over the network.");
    this.drawn = { vehicles: [] };
    vehicles.forEach((/** @type {Message} */ line, /** @type {number} */ at) => this.fill(this.lines.children[at], line));
  }

  /** The system that is shown, as the one line. @returns {Message[]} */
  own() {
    const { standing } = this.data;
    if (!standing.system) return [];
    const statuses = (standing.services ?? []).map((/** @type {Message} */ one) => one.status);
    const of = (/** @type {string} */ name) => statuses.find((/** @type {Message} */ one) => one.service === name);
    const recorded = this.data.recording.length > 0;
    const age_s = recorded ? Infinity : (performance.now() - this.data.came) / 1000;
    const services = statuses.filter((/** @type {Message} */ one) => one.state === "running").map((/** @type {Message} */ one) => one.service);
    return [{ vehicle: standing.system, lives: recorded || standing.state === "STATE_LIVE", age_s: Number.isFinite(age_s) ? age_s : null, attitude: this.data.newest.attitude, lost_messages: 0, lost_ticks: of("course")?.lost ?? null, stage: of("fuser")?.stage ?? "", services }];
  }

  /** A row to be filled. @param {string} name */
  row(name) {
    const canvas = document.createElement("canvas");
    canvas.setAttribute("aria-hidden", "true");
    const button = /** @type {HTMLButtonElement} */ (element("button", "", name));
    button.type = "button";
    button.dataset.vehicle = name;
    button.disabled = !this.data.standing.vehicles?.length;
    button.addEventListener("click", () => this.choose(name));
    return element("tr", "", element("td", "", canvas), element("td", "", button), ...HEADS.slice(2).map((head) => element("td", look(head), "–")));
  }

  /** @param {Element} row @param {Message} line */
  fill(row, line) {
    const { attitude, age_s, lives, lost_messages, lost_ticks, stage, services } = line;
    const old = !lives || age_s === null || age_s > OLD_S;
    row.classList.toggle("old", old);
    const q = quaternion(attitude?.quaternion);
    const [, pitch, roll] = q ? angles(q) : [0, 0, 0];
    const cells = [
      q ? `${signed(roll / DEGREE, 1)}°` : "–", q ? `${signed(pitch / DEGREE, 1)}°` : "–",
      attitude ? `${degrees(attitude.course_rad)}° ${countedFrom(attitude.course_reference)}` : "–",
      age_s === null ? "–" : `${age_s.toFixed(1)} s`, lost_ticks === null ? "–" : String(lost_ticks), String(lost_messages),
      stage || "–", lives ? services.join(" ") : "out of reach",
    ];
    cells.forEach((text, at) => write(row.children[at + 2], text));
    row.children[6].classList.toggle("c-fault", lost_ticks > 0);
    row.children[7].classList.toggle("c-fault", lost_messages > 0);
    this.drawn.vehicles.push({ vehicle: line.vehicle, quaternion: q, old, lost_ticks, lost_messages, stage });
    glyph(/** @type {HTMLCanvasElement} */ (row.querySelector("canvas")), q ? [pitch, roll] : null);
  }
}

/** Numbers stand right. @param {string} head */
const look = (head) => (["", "vehicle", "stage", "services"].includes(head) ? "" : "number");

/** A small horizon. @param {HTMLCanvasElement} canvas @param {[number, number] | null} lies Pitch and roll, rad */
function glyph(canvas, lies) {
  const made = begin(canvas);
  if (!made || !lies) return;
  const [context, width, height] = made;
  const r = Math.min(width, height) / 2 - 1;
  context.translate(width / 2, height / 2);
  context.save();
  context.beginPath(); context.arc(0, 0, r, 0, 7); context.clip();
  context.rotate(-lies[1]);
  context.translate(0, (lies[0] / (45 * DEGREE)) * r);
  context.fillStyle = colour("sky"); context.fillRect(-4 * r, -8 * r, 8 * r, 8 * r);
  context.fillStyle = colour("ground"); context.fillRect(-4 * r, 0, 8 * r, 8 * r);
  context.restore();
  context.strokeStyle = colour("fused");
  context.lineWidth = 2;
  context.beginPath(); context.moveTo(-0.8 * r, 0); context.lineTo(0.8 * r, 0); context.stroke();
}
