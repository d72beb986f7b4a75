// The page: the connection, the views, the bar, the keys.

import { Data } from "./data.js";
import { Fleet } from "./fleet.js";
import { Fly } from "./fly.js";
import { element, theme, write } from "./look.js";
import { Method } from "./method.js";
import { Sensors } from "./sensors.js";
import { System } from "./system.js";
import { Timeline } from "./timeline.js";
import { Wire } from "./wire.js";

/** @typedef {import("./wire.js").Message} Message */

const VIEWS = ["fly", "method", "sensors", "system", "fleet"];
/** Between two attempts to connect, ms. */
const AGAIN_MS = 500;
/** The code with which a socket is closed whose token is missing or wrong. */
const REFUSED = 1008;
/** The same where there is nothing of the vehicle's name; the reason says why. */
const ABSENT = 4404;
/** Pictures of a recording asked for at once. */
const CHUNK = 2000;
const PICTURE_S = 0.033;

const data = new Data();
const get = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
const input = (/** @type {string} */ id) => /** @type {HTMLInputElement} */ (document.getElementById(id));
/** Behind the # of the address stands the token: no request ever carries it but a command. */
const behind = location.hash.slice(1);
const token = (/^[0-9a-f]+$/.test(behind) && behind) || sessionStorage.getItem("token") || "";
if (token) sessionStorage.setItem("token", token);

/** The vehicle that is looked at, where one is chosen. */
let vehicle = new URLSearchParams(location.search).get("vehicle") ?? "";
/** @type {Wire} */ let wire;
/** @type {Timeline} */ let timeline;
/** @type {WebSocket | null} */ let socket = null;
/** @type {any} */ let shown = null;
let name = "";
let asked = 0;
let played = 0;

/** A command, with the token; why not, where it cannot be sent. @param {Message} command */
function ask(command) {
  if (!token) return "commands need the token: open the address that `plumb up` or `plumb view` prints, to its end";
  if (socket?.readyState !== WebSocket.OPEN) return "there is no connection";
  asked += 1;
  data.asked = `page-${asked}`;
  socket.send(wire.encode("PageCommand", { ...command, request_id: data.asked, token }));
  return null;
}

/** Connects. Until something is told, the page goes on saying why there was no connection. */
function connect() {
  const made = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket${vehicle && `?vehicle=${encodeURIComponent(vehicle)}`}`);
  socket = made;
  made.binaryType = "arraybuffer";
  made.addEventListener("open", () => {
    // What was under way may have ended with the connection; what goes on is told again.
    data.calibration = null;
    if (token) made.send(wire.encode("PageCommand", { kind: "KIND_LOOK", request_id: "look", token }));
  });
  made.addEventListener("message", ({ data: bytes }) => {
    if (made !== socket) return;
    data.link = "open";
    data.bytes += bytes.byteLength;
    const { picture, standing, answer, calibration } = wire.decode("ToPage", new Uint8Array(bytes));
    if (picture) data.take(picture, performance.now());
    if (standing) {
      // In the place of a recording there is a system now.
      if (data.recording.length && standing.state !== "STATE_RECORDING") {
        data.clear();
        get("scrub").hidden = true;
      }
      const first = data.standing.pictures !== standing.pictures;
      // Where there are several and none is chosen, the page begins with them.
      if (standing.state === "STATE_UNCHOSEN" && data.standing.state !== standing.state) show("fleet");
      data.standing = standing;
      if (standing.state === "STATE_RECORDING" && first) load(standing.pictures).catch(() => { data.standing = {}; socket?.close(); });
    }
    if (calibration) data.calibration = calibration.what ? calibration : null;
    // An answer about no slot is that to a calibration.
    if (answer && !answer.slot) data.refusal = answer.reason;
    else if (answer) {
      data.answer = answer;
      if (shown instanceof System) shown.answered(answer);
    }
  });
  made.addEventListener("close", ({ code, reason }) => {
    if (made !== socket) return;
    data.link = code === REFUSED ? "refused" : code === ABSENT ? "absent" : "closed";
    data.absent = reason;
    setTimeout(() => { if (made === socket) connect(); }, AGAIN_MS);
  });
}

/** Looks at another vehicle. @param {string} name */
function choose(name) {
  vehicle = name;
  history.replaceState(null, "", `?vehicle=${encodeURIComponent(name)}`);
  data.clear();
  data.link = "connecting";
  socket?.close();
  connect();
  show("fly");
}

/** Loads a recording. @param {number} count */
async function load(count) {
  const all = [];
  while (all.length < count) {
    const answer = await fetch(`/pictures?${all.length}+${CHUNK}`, { headers: token ? { authorization: `Bearer ${token}` } : {} });
    if (!answer.ok) throw new Error(await answer.text());
    const { pictures } = wire.decode("Pictures", new Uint8Array(await answer.arrayBuffer()));
    if (!pictures.length) break;
    all.push(...pictures);
  }
  data.events.length = 0;
  for (const picture of all) data.hear(picture);
  data.recording = all;
  data.paused = true;
  get("scrub").hidden = false;
  input("place").max = String(Math.max(0, all.length - 1));
  seek(0);
}

/** Shows a recording up to a picture. @param {number} place */
function seek(place) {
  data.place = Math.max(0, Math.min(data.recording.length - 1, Math.round(place)));
  data.frames.length = 0;
  data.newest = {};
  data.shadows.clear();
  data.cursor = null;
  const from = Math.max(0, data.place - 1800);
  for (const picture of data.recording.slice(from, data.place + 1)) data.take(picture, performance.now());
  input("place").value = String(data.place);
}

/** Goes on in a recording by the time that has passed. @param {number} seconds */
function play(seconds) {
  played += (seconds * Number(/** @type {HTMLSelectElement} */ (get("speed")).value)) / pictureLength();
  const whole = Math.floor(played);
  if (!whole) return;
  played -= whole;
  for (let i = 0; i < whole && data.place + 1 < data.recording.length; i++) {
    data.place += 1;
    data.take(data.recording[data.place], performance.now());
  }
  input("place").value = String(data.place);
  if (data.place + 1 >= data.recording.length) data.paused = true;
}

/** The time that a picture of a recording covers, s. */
function pictureLength() {
  const { t_first_ns, t_last_ns } = data.standing;
  return data.recording.length > 1 ? Math.max(PICTURE_S, ((t_last_ns - t_first_ns) * 1e-9) / data.recording.length) : PICTURE_S;
}

/** @param {string} wanted */
function show(wanted) {
  name = wanted;
  for (const tab of get("tabs").children) tab.setAttribute("aria-selected", String(tab.id === `tab-${name}`));
  const place = get("view");
  shown = name === "fly" ? new Fly(place, data) : name === "method" ? new Method(place, data) : name === "sensors" ? new Sensors(place, data, ask) : name === "system" ? new System(place, data, ask) : new Fleet(place, data, choose);
  if (shown instanceof System && data.answer) shown.answered(data.answer);
}

/** @param {number} us */
const time = (us) => (us >= 1000 ? `${(us / 1000).toFixed(2)} ms` : `${us.toFixed(0)} µs`);

/** @param {number} now */
function bar(now) {
  const { standing } = data;
  const state = data.state(now);
  const put = (/** @type {string} */ id, /** @type {string} */ text) => write(get(id), text);
  put("system", standing.system || "no system");
  put("source", standing.source ?? "");
  put("state", state.word);
  get("state").className = `state-${state.kind}`;
  const frame = data.shown();
  put("time", frame ? `${frame.t.toFixed(2)} s` : "–");
  put("rate", standing.rate_hz ? `${standing.rate_hz.toFixed(0)} Hz` : "–");
  const latency = standing.latency_us;
  put("latency", latency ? `p50 ${time(latency.p50)}  p99 ${time(latency.p99)}` : "–");
  const course = (standing.services ?? []).find((/** @type {Message} */ one) => one.status?.service === "course");
  put("lost", course ? String(course.status.lost) : "–");
  get("lost-place").className = course && course.status.lost > 0 ? "loud" : "";
  const flags = data.flagsUp();
  get("flags").hidden = !flags.length;
  put("flags", flags.join(", "));
  get("why").hidden = !state.why;
  put("why", state.why);
  // In the list of vehicles each line has an age of its own.
  get("view").classList.toggle("stale", name !== "fleet" && (state.kind === "stale" || state.kind === "connecting" || state.kind === "ended"));
  put("pause", data.paused ? (data.recording.length ? "Play" : "Go on") : "Pause");
  put("play", data.paused ? "Play" : "Stop");
  if (data.recording.length && frame) put("place-time", `${(frame.t - standing.t_first_ns * 1e-9).toFixed(2)} of ${((standing.t_last_ns - standing.t_first_ns) * 1e-9).toFixed(2)} s`);
}

function pause() {
  data.paused = !data.paused;
  if (data.paused) data.cursor = data.recording.length ? null : data.frames.at(-1)?.t ?? null;
  else data.cursor = null;
  if (!data.paused && data.recording.length && data.place + 1 >= data.recording.length) seek(0);
}

/** Sets the cursor, in a recording the place. @param {number} t */
function go(t) {
  data.paused = true;
  if (!data.recording.length) { data.cursor = t; return; }
  const at = data.recording.findIndex((picture) => ((picture.attitude ?? picture.imu)?.header.t_end_ns ?? -Infinity) * 1e-9 >= t);
  seek(at < 0 ? data.recording.length - 1 : at);
}

/** By which a key turns the scene: azimuth and elevation, rad. @type {Record<string, [number, number]>} */
const TURNS = { Home: [-0.1, 0], End: [0.1, 0], PageUp: [0, 0.1], PageDown: [0, -0.1] };

/** @param {KeyboardEvent} event */
function key(event) {
  const at = /** @type {HTMLElement} */ (event.target);
  if (event.ctrlKey || event.metaKey || event.altKey || at.tagName === "SELECT") return;
  // The slider of a recording takes the keys that move it.
  if (at.tagName === "INPUT" && (input(at.id).type !== "range" || /^(Arrow|Page|Home|End)/.test(event.key))) return;
  const step = event.key === "ArrowLeft" ? -1 : event.key === "ArrowRight" ? 1 : 0;
  if (step && at.getAttribute("role") !== "tab") {
    data.paused = true;
    if (data.recording.length) seek(data.place + step * (event.shiftKey ? Math.max(1, 1 / pictureLength()) : 1));
    else data.step(event.shiftKey ? 0 : step, event.shiftKey ? step : 0);
  } else if (VIEWS[Number(event.key) - 1]) show(VIEWS[Number(event.key) - 1]);
  else if (event.key === " " && at.tagName !== "BUTTON") pause();
  else if (event.key === "l") { data.paused = false; data.cursor = null; }
  else if (event.key === "+" || event.key === "-") data.zoom(event.key === "+" ? 0.5 : 2);
  else if (shown?.scene && TURNS[event.key]) shown.scene.turn(...TURNS[event.key]);
  else if (event.key === "r") shown?.scene?.reset();
  else if (event.key === "c") void timeline.copyValues();
  else if (event.key === "q") void timeline.copyQuaternion();
  else if (event.key === "[" || event.key === "]") timeline.step(event.key === "[" ? -1 : 1);
  else if (event.key === "t") theme();
  else if (event.key === "?") /** @type {HTMLDialogElement} */ (get("keys")).showModal();
  else if (event.key === "s") { show("system"); get("slot").focus(); }
  else return;
  event.preventDefault();
}

/** Between two drawings, ms: as pictures come. */
const DRAWN_MS = 30;
let before = performance.now();
/** Script time of the last frames, ms. @type {number[]} */
const costs = [];
let frames = 0;
/** @param {number} now */
function frame(now) {
  requestAnimationFrame(frame);
  if (now - before < DRAWN_MS) return;
  const began = performance.now();
  if (data.recording.length && !data.paused) play((now - before) / 1000);
  before = now;
  bar(now);
  shown?.draw();
  timeline.draw();
  frames += 1;
  costs.push(performance.now() - began);
  if (costs.length > 600) costs.shift();
}

async function begin() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const follow = () => theme(dark.matches ? "dark" : "light");
  dark.addEventListener("change", follow);
  follow();
  for (const [place, of] of VIEWS.entries()) {
    const tab = element("button", "", `${place + 1} ${of[0].toUpperCase()}${of.slice(1)}`);
    tab.id = `tab-${of}`;
    tab.setAttribute("role", "tab");
    tab.addEventListener("click", () => show(of));
    get("tabs").append(tab);
  }
  get("pause").addEventListener("click", pause);
  get("play").addEventListener("click", pause);
  get("theme").addEventListener("click", () => theme());
  get("help").addEventListener("click", () => /** @type {HTMLDialogElement} */ (get("keys")).showModal());
  input("place").addEventListener("input", () => seek(Number(input("place").value)));
  document.addEventListener("keydown", key);
  const schema = await (await fetch("/schema.json")).json();
  wire = new Wire(schema);
  data.flags = schema.flags;
  data.go = go;
  timeline = new Timeline(get("timeline"), data);
  show("fly");
  connect();
  requestAnimationFrame(frame);
}

/** What is drawn, for tests. */
Object.assign(window, { plumb: { data, costs, frames: () => frames, state: () => data.state(performance.now()), drawn: () => shown?.drawn, told: () => timeline.drawn, view: () => name, seek, why: () => shown?.scene?.why } });
void begin();
