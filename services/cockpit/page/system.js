// System view: services, events, and swaps of stages.

import { DEGREE } from "./attitude.js";
import { CANCELLED_REASON } from "./data.js";
import { Parameters } from "./parameters.js";
import { button, element, fillTable, section, select, setOptions, statusLine, table, write } from "./ui.js";
import { Strips, line } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./wire.js").Message} Message */

/** Time for which a restarted service stays marked, ms. */
const RESTART_MARK_MS = 3000;
/** States in which a service works. */
const UP_STATES = ["running", "ready", "finished"];
/** Name and class of each column of the services. @type {[string, string][]} */
const COLUMNS = [
  ["service", ""], ["stage", ""], ["state", "word"], ["rate", "number detail"], ["p50", "number detail"], ["p99", "number"], ["max", "number detail"],
  ["lost", "number"], ["restarts", "number"], ["CPU", "number detail"], ["memory", "number detail"],
];

export class System {
  /** @param {HTMLElement} parent @param {Data} data @param {import("./wire.js").SendCommand} sendCommand */
  constructor(parent, data, sendCommand) {
    this.data = data;
    this.sendCommand = sendCommand;
    this.services = element("tbody", "");
    this.servicesNote = element("p", "c-quiet");
    this.slot = select("slot");
    this.stage = select("stage");
    this.outcome = statusLine("outcome");
    this.difference = element("p", "c-shadow");
    this.events = element("tbody", "");
    this.emptyNote = element("p", "c-quiet", "No events yet.");
    this.buttons = [["swap", "Swap…", "KIND_SWAP"], ["shadow", "Shadow…", "KIND_SHADOW"], ["promote", "Promote shadow…", "PROMOTE"], ["cancel", "Cancel shadow…", "KIND_CANCEL"]].map(([id, text, kind]) => button(id, text, () => this.command(kind)));
    this.confirm = element("dialog", "");
    this.slot.addEventListener("change", () => this.fillStages());
    this.logError = statusLine("log-error");
    this.logError.className = "c-fault";
    this.log = element("pre", "log");
    this.log.hidden = true;
    const parameters = element("section", "");
    this.parameters = new Parameters(parameters);
    const label = (/** @type {string} */ text, /** @type {HTMLElement} */ inner) => element("label", "", `${text} `, inner, " ");
    const strips = element("div", "panel short");
    this.strips = new Strips(strips, data, "system", [{ title: "latency", unit: "ms", scale: 1e3, digits: 3, least: 0, lines: [line("latency_s", "end to end", "fused")] }]);
    this.servicesTable = table("services", COLUMNS, this.services);
    this.stages = section("Stages", label("slot", this.slot), label("stage", this.stage), element("div", "actions", ...this.buttons), this.outcome, this.difference);
    this.logSection = section("Log", element("div", "actions", button("show-log", "Show the last lines", () => this.readLog())), this.logError, this.log);
    parent.replaceChildren(
      element("h2", "", "Services"),
      element("div", "scrolls", this.servicesTable),
      this.servicesNote, strips,
      element("div", "columns",
        this.stages,
        element("section", "events", element("h2", "", "Events"), this.emptyNote, element("table", "", this.events))),
      this.logSection, parameters, this.confirm);
    /** Content shown, for tests. @type {Record<string, any>} */ this.drawn = {};
    /** Slots and stages in the lists, as JSON. */ this.slots = "";
    /** Revision of the events in the table. */ this.shownRevision = -1;
    /** Reply shown. @type {Message | null} */ this.answer = null;
    /** Whether a command awaits its reply. */ this.isWaiting = false;
    /** Restarts of each service and the time of the last change, ms. @type {Map<string, { restarts: number, changed_ms: number }>} */ this.restarts = new Map();
  }

  /** Asks for confirmation and sends a command. @param {string} action */
  command(action) {
    const slot = this.slot.value, set = action === "PROMOTE" ? this.data.shadowSet[slot] ?? [] : action === "KIND_CANCEL" ? [] : this.parameters.settings();
    if (typeof set === "string") { this.showOutcome("c-fault", set); return; }
    const given = set.length ? ` with ${set.map(({ name, value }) => `${name} = ${value}`).join(", ")}` : "";
    // A swap to the stage of the shadow promotes the shadow.
    const kind = action === "PROMOTE" ? "KIND_SWAP" : action;
    const stage = action === "PROMOTE" ? this.shadowOf(slot) : this.stage.value;
    const question = action === "PROMOTE" ? `Promote the shadow ${stage} to owner of ${slot}?` : { KIND_SWAP: `Swap the stage of ${slot} to ${stage}${given}?`, KIND_SHADOW: `Run ${stage}${given} as a shadow of ${slot}?`, KIND_CANCEL: `Cancel the shadow of ${slot}?` }[kind] ?? kind;
    const yes = element("button", "", "Yes");
    const no = element("button", "", "No");
    yes.id = "yes";
    yes.addEventListener("click", () => {
      this.confirm.close();
      const status = this.statusOf(slot);
      this.showOutcome("", `requested: ${question.replace("?", "")} …`);
      const command = { kind, slot, stage: kind === "KIND_CANCEL" ? "" : stage, expected_epoch: status?.epoch ?? 0, set };
      Object.assign(this.data, { command, answer: null });
      // A late reply to an earlier command is ignored, for example the reply about a shadow that has been promoted.
      const error = this.sendCommand(command, (answer) => { if (this.data.command === command) this.data.answer = answer; });
      if (kind === "KIND_SHADOW") this.data.shadowSet[slot] = set;
      // The reply about a shadow is sent at its end.
      this.isWaiting = !error && kind !== "KIND_SHADOW";
      if (error) this.showOutcome("c-fault", error);
    });
    no.addEventListener("click", () => this.confirm.close());
    const effect = { KIND_SWAP: "The current stage keeps running until the new one has caught up. No tick is lost.", KIND_SHADOW: "The output does not change.", KIND_CANCEL: "The output does not change." }[kind] ?? "";
    this.confirm.replaceChildren(element("p", "", question), element("p", "c-quiet", effect), element("div", "actions", yes, no));
    this.confirm.showModal();
  }

  /** Requests the last lines of the log, and shows them or the reason why there are none. */
  readLog() {
    const error = this.sendCommand({ kind: "KIND_LOG" }, ({ lines, reason }) => {
      this.log.hidden = !lines;
      write(this.log, (lines ?? []).join("\n"));
      write(this.logError, reason ?? "");
      this.log.scrollTop = this.log.scrollHeight;
    });
    write(this.logError, error ?? "");
  }

  /** @param {string} className @param {string} text */
  showOutcome(className, text) {
    this.outcome.className = className;
    this.outcome.textContent = text;
  }

  /** Shows the outcome of a command. @param {Message} answer */
  showReply(answer) {
    const { outcome, slot, from, to, commit_tick, lost, duplicated, gap_s, jump_rad, reason } = answer;
    this.isWaiting = false;
    if (reason === CANCELLED_REASON) {
      this.showOutcome("", `cancelled: the shadow of ${slot}, as requested`);
    } else if (outcome === "OUTCOME_COMMITTED") {
      this.showOutcome("c-field", `committed: ${slot}: ${from} → ${to} from tick ${commit_tick}; lost ${lost}, duplicated ${duplicated}, longest interval ${(gap_s * 1e3).toFixed(1)} ms, jump ${(jump_rad / DEGREE).toFixed(3)}°`);
    } else {
      const label = outcome.replace("OUTCOME_", "").toLowerCase();
      this.showOutcome("c-fault", `${label}: ${slot}: ${reason || "the current stage kept running"}`);
    }
  }

  /** @param {string} slot @returns {Message | undefined} */
  statusOf(slot) {
    return (this.data.systemStatus.services ?? []).map((service) => service.status).find((status) => status?.service === slot && status.state !== "candidate");
  }

  /** Returns the stage of a slot's shadow, or an empty string. @param {string} slot */
  shadowOf(slot) {
    const isRunning = (this.data.shown()?.snapshot.differences ?? []).some((/** @type {Message} */ difference) => difference.service === `SERVICE_${slot.toUpperCase()}`);
    const candidates = this.data.events.filter((event) => event.kind === "EVENT_KIND_CANDIDATE" && event.service === slot);
    return isRunning ? candidates.at(-1)?.stage ?? "" : "";
  }

  /** Lists the stages of the selected slot, and selects the current one if it is another slot. */
  fillStages() {
    const owner = this.statusOf(this.slot.value)?.stage ?? "";
    if (this.stage.dataset.slot !== this.slot.value) setOptions(this.stage, []);
    const isFirst = !this.stage.value && owner;
    if (owner) this.stage.dataset.slot = this.slot.value;
    setOptions(this.stage, (this.slotShown()?.stages ?? []).map((/** @type {string} */ name) => [name, name === owner ? `${name} (current)` : name]));
    if (isFirst) this.stage.value = owner;
  }

  /** @returns {Message | undefined} */
  slotShown() {
    return (this.data.systemStatus.slots ?? []).find((one) => one.slot === this.slot.value);
  }

  /** Shows the parameters of the selected stage. */
  showParameters() {
    const slot = this.slotShown(), stage = this.stage.value, runs = stage === this.statusOf(this.slot.value)?.stage;
    const known = this.data.parameters[this.slot.value]?.[stage];
    const note = runs && slot && !slot.is_set_known ? "The values are unknown, because the vehicle is remote. The fields show the defaults." : known ? "" : "The stage is a program. It checks its parameters itself; the launch file sets them.";
    if (stage) this.parameters.show(`${this.slot.value}: ${stage}${runs ? "" : " (not running)"}`, known, runs && slot?.is_set_known ? slot.set : null, note);
    return runs;
  }

  /** Returns whether a service was restarted recently. A restart takes only milliseconds and would otherwise go unnoticed. @param {Message} status */
  wasJustRestarted(status) {
    const known = this.restarts.get(status.service);
    const now = performance.now();
    if (!known) this.restarts.set(status.service, { restarts: status.restarts, changed_ms: -Infinity });
    else if (known.restarts !== status.restarts) this.restarts.set(status.service, { restarts: status.restarts, changed_ms: now });
    return now - (this.restarts.get(status.service)?.changed_ms ?? -Infinity) < RESTART_MARK_MS;
  }

  draw() {
    const { systemStatus, events } = this.data;
    const services = systemStatus.services ?? [];
    const slots = JSON.stringify((systemStatus.slots ?? []).map((slot) => [slot, this.statusOf(slot.slot)?.stage]));
    if (slots !== this.slots) {
      this.slots = slots;
      const isFirst = !this.slot.value;
      setOptions(this.slot, (systemStatus.slots ?? []).map(({ slot }) => [slot, slot]));
      if (isFirst) this.slot.value = "fuser";
      this.fillStages();
    }
    if (this.answer !== this.data.answer) {
      this.answer = this.data.answer;
      if (this.answer) this.showReply(this.answer);
    }
    const runs = this.showParameters();
    this.strips.draw();
    const shadow = this.shadowOf(this.slot.value), hasCandidate = shadow || services.some(({ status }) => status?.service === this.slot.value && status.state === "candidate");
    for (const button of this.buttons) button.disabled = !systemStatus.accepts_commands || (this.isWaiting && this.data.link === "open") || (button.id === "promote" && !shadow) || (button.id === "cancel" && !hasCandidate) || (button.id === "swap" && runs && !this.parameters.isChanged());
    write(this.buttons[0], runs ? "Set parameters…" : "Swap…");
    this.drawn = { services: services.map((service) => [service.status?.service, service.status?.state, service.status?.stage, service.status?.restarts]), events: events.length };
    fillTable(this.services, services.map(serviceCells), COLUMNS.map(([, className]) => className));
    services.forEach(({ status }, at) => {
      const row = /** @type {HTMLElement} */ (this.services.children[at]), wasRestarted = this.wasJustRestarted(status);
      row.dataset.service = status.service;
      row.classList.toggle("down", wasRestarted || !UP_STATES.includes(status.state));
      if (wasRestarted) write(row.children[2], "restarted");
    });
    this.servicesTable.hidden = !services.length;
    this.stages.hidden = this.logSection.hidden = this.data.recording.length > 0;
    write(this.servicesNote, services.length ? "" : this.data.recording.length ? "A recording has no services. Its events are listed below." : "No services respond. Start a system with `plumb up`.");
    const difference = (this.data.shown()?.snapshot.differences ?? [])[0];
    write(this.difference, difference?.now_rad ? `shadow: current difference from the owner ${(difference.now_rad.x / DEGREE).toFixed(3)}°, RMS ${(difference.rms_rad.x / DEGREE).toFixed(3)}° over ${difference.ticks} ticks` : "");
    if (this.shownRevision !== this.data.revision) {
      this.shownRevision = this.data.revision;
      this.emptyNote.hidden = events.length > 0;
      const newest = events.slice(-60).reverse();
      fillTable(this.events, newest.map((event) => [event.t === null || Number.isNaN(event.t) ? "earlier" : this.data.timeText(event.t), event.text]), ["number c-quiet", ""]);
      newest.forEach((event, at) => this.events.children[at].classList.toggle("fault", event.fault));
    }
  }
}

/** Returns the cells of a service. @param {Message} systemStatus @returns {string[]} */
function serviceCells({ status, rate_hz, latency_us, cpu_percent, resident_mib }) {
  const number = (/** @type {number | null} */ value, /** @type {number} */ digits, /** @type {string} */ unit) => (value === null ? "–" : `${value.toFixed(digits)} ${unit}`);
  return [
    status.service, status.stage, status.state, number(rate_hz, 0, "Hz"),
    ...["p50", "p99", "max"].map((name) => (latency_us ? `${latency_us[name].toFixed(0)} µs` : "–")),
    String(status.lost), String(status.restarts), number(cpu_percent, 1, "%"), number(resident_mib, 1, "MiB"),
  ];
}
