// Entry point of the page: connection, views, status bar and keyboard.

import { Data, valueIndex } from "./data.js";
import { Fleet } from "./fleet.js";
import { Fly } from "./fly.js";
import { element, setTheme, store, stored, write } from "./ui.js";
import { Method } from "./method.js";
import { Sensors } from "./sensors.js";
import { System } from "./system.js";
import { Timeline } from "./timeline.js";
import { Wire } from "./wire.js";

/** @typedef {import("./wire.js").Message} Message */

const VIEWS = ["fly", "method", "sensors", "system", "fleet"];
/** Delay before a new connection attempt, ms. */
const RECONNECT_MS = 500;
/** Close code if the token is missing or wrong. */
const CLOSE_UNAUTHORIZED = 1008;
/** Close code if the vehicle is not available. */
const CLOSE_UNKNOWN_VEHICLE = 4404;
/** Number of snapshots of a recording per request. */
const CHUNK = 2000;
/** Shortest duration of a recording's snapshot, s. */
const SNAPSHOT_S = 0.033;

const data = new Data();
const get = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
const input = (/** @type {string} */ id) => /** @type {HTMLInputElement} */ (document.getElementById(id));
// The fragment of the address, which browsers do not send, holds the token and the name of a view, each optional: #TOKEN/VIEW.
const fragment = () => location.hash.slice(1).split("/");
const viewInFragment = () => VIEWS.find((name) => fragment().includes(name));
// A view is never mistaken for a token, because the names of views have other letters than hexadecimal numbers.
const tokenInFragment = fragment().find((part) => /^[0-9a-f]+$/.test(part)) ?? "";
const token = tokenInFragment || stored("sessionStorage", "token") || "";
if (token) store("sessionStorage", "token", token);

/** Name of the selected vehicle; empty if none is selected. */
let vehicle = new URLSearchParams(location.search).get("vehicle") ?? "";
/** @type {Wire} */ let wire;
/** @type {Timeline} */ let timeline;
/** @type {WebSocket | null} */ let socket = null;
/** @type {any} */ let view = null;
let viewName = "";
let requestCount = 0;

/** Handlers of replies by request id. @type {Map<string, (answer: Message) => void>} */
const replyHandlers = new Map();
/** Reason if a recording could not be started or stopped. */
let recordingError = "";

/** Sends a command with the token. @type {import("./wire.js").SendCommand} */
function sendCommand(command, onReply) {
  if (!token) return "commands require a token; open the complete address printed by `plumb up` or `plumb view`";
  if (socket?.readyState !== WebSocket.OPEN) return "not connected";
  const request_id = `page-${++requestCount}`;
  replyHandlers.set(request_id, onReply);
  socket.send(wire.encode("PageCommand", { ...command, request_id, token }));
  return null;
}

/** Opens a connection. The reason for a missing connection is shown until the first message arrives. */
function connect() {
  const opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket${vehicle && `?vehicle=${encodeURIComponent(vehicle)}`}`);
  socket = opened;
  opened.binaryType = "arraybuffer";
  opened.addEventListener("open", () => {
    // A calibration may have ended while disconnected; if not, its progress is sent again.
    data.calibration = null;
    replyHandlers.clear();
    if (token) opened.send(wire.encode("PageCommand", { kind: "KIND_VIEW", request_id: "look", token }));
  });
  opened.addEventListener("message", ({ data: bytes }) => {
    if (opened !== socket) return;
    data.link = "open";
    data.bytes += bytes.byteLength;
    const { snapshot, system_status: systemStatus, answer, calibration, log } = wire.decode("ToPage", new Uint8Array(bytes));
    if (snapshot) data.push(snapshot, performance.now());
    if (systemStatus) {
      // The server now shows a system instead of the recording.
      if (data.recording.length && systemStatus.state !== "STATE_RECORDING") {
        data.clear();
        get("playback").hidden = true;
      }
      const first = data.systemStatus.snapshots !== systemStatus.snapshots;
      // Without a selected vehicle the page shows the list.
      if (systemStatus.state === "STATE_UNSELECTED" && data.systemStatus.state !== systemStatus.state) openView("fleet");
      if (systemStatus.recording?.active !== data.systemStatus.recording?.active) recordingError = "";
      data.systemStatus = systemStatus;
      if (systemStatus.state === "STATE_RECORDING" && first) load(systemStatus.snapshots).catch(() => { data.systemStatus = {}; socket?.close(); });
    }
    if (calibration) data.calibration = calibration.what ? calibration : null;
    const reply = answer ?? log;
    if (reply) replyHandlers.get(reply.request_id)?.(reply);
  });
  opened.addEventListener("close", ({ code, reason }) => {
    if (opened !== socket) return;
    data.link = code === CLOSE_UNAUTHORIZED ? "unauthorized" : code === CLOSE_UNKNOWN_VEHICLE ? "unavailable" : "closed";
    data.unavailableReason = reason;
    setTimeout(() => { if (opened === socket) connect(); }, RECONNECT_MS);
  });
}

/** Switches to another vehicle. @param {string} name */
function selectVehicle(name) {
  vehicle = name;
  history.replaceState(null, "", `?vehicle=${encodeURIComponent(name)}`);
  data.clear();
  data.link = "connecting";
  socket?.close();
  connect();
  openView("fly");
}

/** Loads a recording. @param {number} count Number of its snapshots */
async function load(count) {
  const all = [];
  while (all.length < count) {
    const response = await fetch(`/snapshots?${all.length}+${CHUNK}`, { headers: token ? { authorization: `Bearer ${token}` } : {} });
    if (!response.ok) throw new Error(await response.text());
    const { snapshots } = wire.decode("Snapshots", new Uint8Array(await response.arrayBuffer()));
    if (!snapshots.length) break;
    all.push(...snapshots);
  }
  const { systemStatus } = data;
  data.openRecording(all);
  data.systemStatus = systemStatus;
  get("playback").hidden = false;
  input("position").max = String(Math.max(0, data.recording.length - 1));
  seek(0);
}

/** Shows a recording at a frame. @param {number} position */
function seek(position) {
  data.seek(position);
  input("position").value = String(data.position);
}

/** Advances a recording by the elapsed time. @param {number} seconds */
function play(seconds) {
  data.play(seconds * Number(/** @type {HTMLSelectElement} */ (get("speed")).value));
  input("position").value = String(data.position);
}

/** Returns the duration of a recording's snapshot, s. */
function snapshotLength() {
  const { t_first_ns, t_last_ns } = data.systemStatus;
  return data.recording.length > 1 ? Math.max(SNAPSHOT_S, ((t_last_ns - t_first_ns) * 1e-9) / data.recording.length) : SNAPSHOT_S;
}

/** Whether the page shows several vehicles, or none is selected. */
const hasFleet = () => (data.systemStatus.vehicles?.length ?? 0) > 1 || data.systemStatus.state === "STATE_UNSELECTED";

/** Opens the view that a user has selected, and puts it into the address. @param {string} name */
function selectView(name) {
  if (name === "fleet" && !hasFleet()) return;
  history.replaceState(null, "", `#${[tokenInFragment, name].filter(Boolean).join("/")}`);
  openView(name);
}

/** @param {string} name */
function openView(name) {
  viewName = name;
  for (const tab of get("tabs").children) tab.setAttribute("aria-selected", String(tab.id === `tab-${name}`));
  const parent = get("view");
  view = name === "fly" ? new Fly(parent, data) : name === "method" ? new Method(parent, data) : name === "sensors" ? new Sensors(parent, data, sendCommand) : name === "system" ? new System(parent, data, sendCommand) : new Fleet(parent, data, selectVehicle);
  timeline.setStrips(view.strips ?? null, name);
}

/** @param {number} us */
const duration = (us) => (us >= 1000 ? `${(us / 1000).toFixed(2)} ms` : `${us.toFixed(0)} µs`);

/** @param {number} now */
function drawBar(now) {
  const { systemStatus } = data;
  const state = data.state(now);
  const set = (/** @type {string} */ id, /** @type {string} */ text) => write(get(id), text);
  set("system", systemStatus.system || "no system");
  set("source", systemStatus.source ?? "");
  set("state", state.label);
  get("state").className = `state-${state.kind}`;
  const frame = data.shown();
  set("time", frame ? data.timeText(frame.t) : "–");
  const latency = systemStatus.latency_us;
  set("latency", latency ? `p50 ${duration(latency.p50)}  p99 ${duration(latency.p99)}` : "–");
  const course = (systemStatus.services ?? []).find((service) => service.status?.service === "course");
  // A remote vehicle may not send its samples.
  const rate_hz = systemStatus.rate_hz || course?.rate_hz;
  set("rate", rate_hz ? `${rate_hz.toFixed(0)} Hz` : "–");
  set("lost", course ? String(course.status.lost) : "–");
  // A recording has neither latencies nor lost ticks.
  get("latency-field").hidden = get("lost-field").hidden = data.recording.length > 0;
  get("lost-field").className = course && course.status.lost > 0 ? "loud" : "";
  const { recording } = systemStatus;
  get("record").hidden = !systemStatus.accepts_commands;
  set("record", recording?.active ? "Stop recording" : "Record");
  const size = recording ? `${recording.file}, ${(recording.bytes * 1e-6).toFixed(1)} MB, ${recording.seconds.toFixed(0)} s` : "";
  set("recording", recordingError || (!recording ? "" : recording.active ? `recording ${size}` : `recorded ${size}: ${recording.result}`));
  get("recording").className = recordingError ? "loud" : "";
  const flags = data.activeFaults();
  get("flags").hidden = !flags.length;
  set("flags", flags.join(", "));
  get("reason").hidden = !state.reason;
  set("reason", state.reason);
  // The fleet view marks stale rows itself.
  get("view").classList.toggle("stale", viewName !== "fleet" && (state.kind === "stale" || state.kind === "connecting" || state.kind === "ended"));
  get("tab-fleet").hidden = !hasFleet();
  document.body.classList.toggle("unchosen", systemStatus.state === "STATE_UNSELECTED");
  set("pause", data.paused ? (data.recording.length ? "Play" : "Resume") : "Pause");
  set("play", data.paused ? "Play" : "Pause");
  if (data.recording.length && frame) set("position-time", `${(frame.t - systemStatus.t_first_ns * 1e-9).toFixed(2)} of ${((systemStatus.t_last_ns - systemStatus.t_first_ns) * 1e-9).toFixed(2)} s`);
}

function toggleRecording() {
  const what = data.systemStatus.recording?.active ? "stop" : "start";
  recordingError = sendCommand({ kind: "KIND_RECORD", what }, ({ reason }) => { recordingError = reason; }) ?? "";
}

function togglePause() {
  data.paused = !data.paused;
  if (data.recording.length) {
    if (!data.paused && data.position + 1 >= data.recording.length) seek(0);
  } else data.cursor = data.paused ? data.frames.at(-1)?.t ?? null : null;
}

/** Moves the cursor, in a recording the position, to a time on the source's clock and pauses. @param {number} t */
function goTo(t) {
  data.paused = true;
  if (!data.recording.length) { data.cursor = t; return; }
  seek(data.indexAt(t));
}

const showKeys = () => /** @type {HTMLDialogElement} */ (get("keys")).showModal();

/** Rotation of the scene per key press: azimuth and elevation, rad. @type {Record<string, [number, number]>} */
const ROTATION_KEYS = { Home: [-0.1, 0], End: [0.1, 0], PageUp: [0, 0.1], PageDown: [0, -0.1] };

/** @param {KeyboardEvent} event */
function onKey(event) {
  const target = /** @type {HTMLElement} */ (event.target);
  if (event.ctrlKey || event.metaKey || event.altKey || target.tagName === "SELECT") return;
  // The position slider of a recording handles its own keys.
  if (target instanceof HTMLInputElement && (target.type !== "range" || /^(Arrow|Page|Home|End)/.test(event.key))) return;
  const step = event.key === "ArrowLeft" ? -1 : event.key === "ArrowRight" ? 1 : 0;
  if (step && target.getAttribute("role") !== "tab") {
    data.paused = true;
    if (data.recording.length) seek(data.position + step * (event.shiftKey ? Math.max(1, 1 / snapshotLength()) : 1));
    else data.step(event.shiftKey ? 0 : step, event.shiftKey ? step : 0);
  } else if (VIEWS[Number(event.key) - 1]) selectView(VIEWS[Number(event.key) - 1]);
  else if (event.key === " " && target.tagName !== "BUTTON") togglePause();
  else if (event.key === "l") { data.paused = false; if (!data.recording.length) data.cursor = null; }
  else if (event.key === "a") data.showAll();
  else if (event.key === "+" || event.key === "-") data.zoom(event.key === "+" ? 0.5 : 2);
  else if (view?.scene && ROTATION_KEYS[event.key]) view.scene.rotate(...ROTATION_KEYS[event.key]);
  else if (event.key === "r") view?.scene?.reset();
  else if (event.key === "c") void timeline.copyValues();
  else if (event.key === "q") void timeline.copyQuaternion();
  else if (event.key === "[" || event.key === "]") timeline.step(event.key === "[" ? -1 : 1);
  else if (event.key === "t") setTheme();
  else if (event.key === "?") showKeys();
  else if (event.key === "s") { selectView("system"); get("slot").focus(); }
  else return;
  event.preventDefault();
}

/** Minimum interval between frames, ms. Snapshots arrive at about this interval. */
const FRAME_INTERVAL_MS = 30;
let lastFrame = performance.now();
/** Script time of the last frames, ms. @type {number[]} */
const frameCosts = [];
let frames = 0;
/** @param {number} now */
function frame(now) {
  requestAnimationFrame(frame);
  if (now - lastFrame < FRAME_INTERVAL_MS) return;
  const started = performance.now();
  if (data.recording.length && !data.paused) play((now - lastFrame) / 1000);
  lastFrame = now;
  drawBar(now);
  view?.draw();
  timeline.draw();
  frames += 1;
  frameCosts.push(performance.now() - started);
  if (frameCosts.length > 600) frameCosts.shift();
}

/** Returns the schema of the messages. After a failure it is requested again, as the socket is. */
async function fetchSchema() {
  for (;;) {
    try {
      return await (await fetch("/schema.json")).json();
    } catch {
      await new Promise((resolve) => setTimeout(resolve, RECONNECT_MS));
    }
  }
}

async function start() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const followSystem = () => setTheme(dark.matches ? "dark" : "light");
  dark.addEventListener("change", followSystem);
  followSystem();
  for (const [index, name] of VIEWS.entries()) {
    const tab = element("button", "", element("span", "key", `${index + 1} `), `${name[0].toUpperCase()}${name.slice(1)}`);
    tab.id = `tab-${name}`;
    tab.setAttribute("role", "tab");
    tab.addEventListener("click", () => selectView(name));
    get("tabs").append(tab);
  }
  get("pause").addEventListener("click", togglePause);
  get("play").addEventListener("click", togglePause);
  get("record").addEventListener("click", toggleRecording);
  get("theme").addEventListener("click", () => setTheme());
  get("help").addEventListener("click", showKeys);
  input("position").addEventListener("input", () => seek(Number(input("position").value)));
  document.addEventListener("keydown", onKey);
  const schema = await fetchSchema();
  wire = new Wire(schema);
  data.flags = schema.flags;
  data.parameters = schema.parameters;
  data.goTo = goTo;
  timeline = new Timeline(get("timeline"), data);
  openView(viewInFragment() ?? "fly");
  addEventListener("hashchange", () => openView(viewInFragment() ?? viewName));
  connect();
  requestAnimationFrame(frame);
}

/** State of the page, for tests. */
Object.assign(window, { plumb: { data, valueIndex, frameCosts, frames: () => frames, state: () => data.state(performance.now()), drawn: () => view?.drawn, timeline: () => timeline.drawn, strips: () => view?.strips?.drawn, view: () => viewName, seek, fallbackReason: () => view?.scene?.fallbackReason } });
void start();
