// System: whether the machine keeps up, what happened, and who fills the slots.

import { DEGREE } from "./attitude.js";
import { ENDED_AS_ASKED } from "./data.js";
import { element, rows, write } from "./look.js";
import { Strips } from "./strips.js";

/** @typedef {import("./data.js").Data} Data */
/** @typedef {import("./wire.js").Message} Message */
/** @typedef {(command: { kind: string, slot: string, stage: string, expected_epoch: number }) => string | null} Ask Sends a command; why not, where it cannot. */

/** So long a service that has died and runs again is shown red, ms. */
const RED_MS = 3000;
const PATH = ["ingest", "gyro", "accel", "fuser", "course"];

export class System {
  /** @param {HTMLElement} place @param {Data} data @param {Ask} ask */
  constructor(place, data, ask) {
    this.data = data;
    this.ask = ask;
    this.boxes = element("div", "boxes");
    this.slot = /** @type {HTMLSelectElement} */ (element("select", ""));
    this.stage = /** @type {HTMLSelectElement} */ (element("select", ""));
    this.slot.id = "slot";
    this.stage.id = "stage";
    this.outcome = element("p", "");
    this.outcome.id = "outcome";
    this.outcome.setAttribute("role", "status");
    this.difference = element("p", "number c-shadow");
    this.events = element("tbody", "");
    this.quiet = element("p", "c-quiet", "Nothing since the page's program joined the system.");
    const button = (/** @type {string} */ id, /** @type {string} */ text, /** @type {string} */ kind) => {
      const made = /** @type {HTMLButtonElement} */ (element("button", "", text));
      made.id = id;
      made.type = "button";
      made.addEventListener("click", () => this.command(kind));
      return made;
    };
    this.buttons = [button("swap", "Swap…", "KIND_SWAP"), button("shadow", "Shadow…", "KIND_SHADOW"), button("promote", "Promote the shadow", "PROMOTE"), button("cancel", "End the shadow", "KIND_CANCEL")];
    this.confirm = /** @type {HTMLDialogElement} */ (element("dialog", ""));
    this.slot.addEventListener("change", () => this.fillStages());
    const label = (/** @type {string} */ text, /** @type {HTMLElement} */ inner) => element("label", "", `${text} `, inner, " ");
    const strips = element("div", "panel short");
    this.strips = new Strips(strips, data, [{ title: "latency", unit: "ms", scale: 1e3, digits: 3, lines: [{ of: "latency_s", name: "birth to attitude", colour: "fused" }] }]);
    place.replaceChildren(
      element("h2", "", "Services"), this.boxes, strips,
      element("div", "columns",
        element("section", "", element("h2", "", "Stages"), label("slot", this.slot), label("stage", this.stage), element("div", "actions", ...this.buttons), this.outcome, this.difference),
        element("section", "events", element("h2", "", "What happened, newest first"), this.quiet, element("table", "", this.events))),
      this.confirm);
    /** What is drawn, for tests. @type {Record<string, any>} */ this.drawn = {};
    this.slots = "";
    this.told = -1;
    /** A command is under way. */ this.waits = false;
    /** Restarts seen of each service, and when the last was seen, ms. @type {Map<string, { restarts: number, at: number }>} */ this.lives = new Map();
  }

  /** Shows what would be done, and does it when that is confirmed. @param {string} asked */
  command(asked) {
    const slot = this.slot.value;
    // The shadow takes over where it is asked for as the stage.
    const kind = asked === "PROMOTE" ? "KIND_SWAP" : asked;
    const stage = asked === "PROMOTE" ? this.shadowOf(slot) : this.stage.value;
    const what = asked === "PROMOTE" ? `Let the shadow ${stage} take over ${slot}?` : { KIND_SWAP: `Swap the stage of ${slot} to ${stage}?`, KIND_SHADOW: `Let ${stage} compute beside the owner of ${slot}?`, KIND_CANCEL: `End the shadow of ${slot}?` }[kind] ?? kind;
    const yes = /** @type {HTMLButtonElement} */ (element("button", "", "Yes"));
    const no = /** @type {HTMLButtonElement} */ (element("button", "", "No"));
    yes.id = "yes";
    yes.addEventListener("click", () => {
      this.confirm.close();
      const status = this.statusOf(slot);
      this.outcome.className = "";
      this.outcome.textContent = `asked: ${what.replace("?", "")} …`;
      const refused = this.ask({ kind, slot, stage: kind === "KIND_CANCEL" ? "" : stage, expected_epoch: status?.epoch ?? 0 });
      // The answer about a shadow comes at its end.
      this.waits = !refused && kind !== "KIND_SHADOW";
      if (refused) this.say("c-fault", refused);
    });
    no.addEventListener("click", () => this.confirm.close());
    this.confirm.replaceChildren(element("p", "", what), element("p", "c-quiet", "The old stage goes on until the new one has caught up; no tick is lost."), element("div", "actions", yes, no));
    this.confirm.showModal();
  }

  /** @param {string} look @param {string} text */
  say(look, text) {
    this.outcome.className = look;
    this.outcome.textContent = text;
  }

  /** The outcome of a command. @param {Message} answer */
  answered(answer) {
    const { outcome, slot, from, to, commit_tick, lost, duplicated, gap_s, jump_rad, reason } = answer;
    // That of an earlier request, as of the shadow that was promoted, does not take the place of the last one's.
    if (this.data.asked && answer.request_id !== this.data.asked) return;
    this.waits = false;
    if (reason === ENDED_AS_ASKED) {
      this.say("", `ended: the shadow of ${slot}, as asked`);
    } else if (outcome === "OUTCOME_COMMITTED") {
      this.say("c-field", `committed: ${slot}: ${from} → ${to} from tick ${commit_tick}; lost ${lost}, duplicated ${duplicated}, longest interval ${(gap_s * 1e3).toFixed(1)} ms, jump ${(jump_rad / DEGREE).toFixed(3)}°`);
    } else {
      const word = outcome.replace("OUTCOME_", "").toLowerCase();
      this.say("c-fault", `${word}: ${slot}: ${reason || "the old stage never stopped"}`);
    }
  }

  /** @param {string} slot @returns {Message | undefined} */
  statusOf(slot) {
    return (this.data.standing.services ?? []).map((/** @type {Message} */ one) => one.status).find((/** @type {Message} */ status) => status?.service === slot && status.state !== "candidate");
  }

  /** The stage that runs as a slot's shadow; empty where there is none. @param {string} slot */
  shadowOf(slot) {
    const runs = (this.data.shown()?.picture.differences ?? []).some((/** @type {Message} */ one) => one.service === `SERVICE_${slot.toUpperCase()}`);
    const begun = this.data.events.filter((told) => told.kind === "EVENT_KIND_CANDIDATE" && told.service === slot);
    return runs ? begun.at(-1)?.stage ?? "" : "";
  }

  fillStages() {
    const slot = (this.data.standing.slots ?? []).find((/** @type {Message} */ one) => one.slot === this.slot.value);
    const owner = this.statusOf(this.slot.value)?.stage;
    this.stage.replaceChildren(...(slot?.stages ?? []).map((/** @type {string} */ name) => {
      const option = /** @type {HTMLOptionElement} */ (element("option", "", name === owner ? `${name} (runs)` : name));
      option.value = name;
      return option;
    }));
    const other = (slot?.stages ?? []).find((/** @type {string} */ name) => name !== owner);
    if (other) this.stage.value = other;
  }

  /** It died since the page last looked: a restart takes milliseconds, and is to be seen. @param {Message} status */
  hasJustDied(status) {
    const known = this.lives.get(status.service);
    const now = performance.now();
    if (!known) this.lives.set(status.service, { restarts: status.restarts, at: -Infinity });
    else if (known.restarts !== status.restarts) this.lives.set(status.service, { restarts: status.restarts, at: now });
    return now - (this.lives.get(status.service)?.at ?? -Infinity) < RED_MS;
  }

  draw() {
    const { standing, events } = this.data;
    const services = standing.services ?? [];
    const slots = JSON.stringify(standing.slots ?? []);
    if (slots !== this.slots) {
      this.slots = slots;
      const before = this.slot.value;
      this.slot.replaceChildren(...(standing.slots ?? []).map((/** @type {Message} */ one) => element("option", "", one.slot)));
      this.slot.value = standing.slots?.some((/** @type {Message} */ one) => one.slot === before) ? before : "fuser";
      this.fillStages();
    }
    this.strips.draw();
    const shadow = this.shadowOf(this.slot.value);
    for (const button of this.buttons) button.disabled = !standing.takes_commands || (this.waits && this.data.link === "open") || (button.id === "promote" && !shadow);
    this.drawn = { services: services.map((/** @type {Message} */ one) => [one.status?.service, one.status?.state, one.status?.stage, one.status?.restarts]), events: events.length };
    this.boxes.replaceChildren(...(services.length ? services.map((/** @type {Message} */ one) => box(one, this.hasJustDied(one.status))) : [element("p", "c-quiet", this.data.recording.length ? "A recording has no processes; its events are below." : "No services answer: `plumb up` starts a system.")]));
    const difference = (this.data.shown()?.picture.differences ?? [])[0];
    write(this.difference, difference?.now_rad ? `shadow: ${(difference.now_rad.x / DEGREE).toFixed(3)}° from the owner now, ${(difference.rms_rad.x / DEGREE).toFixed(3)}° RMS over ${difference.ticks} ticks` : "");
    if (this.told !== this.data.revision) {
      this.told = this.data.revision;
      this.quiet.hidden = events.length > 0;
      rows(this.events, [...events].reverse().slice(0, 60).map((told) => [told.t === null || Number.isNaN(told.t) ? "before" : `${told.t.toFixed(2)} s`, told.text]), ["number c-quiet", ""]);
      [...events].reverse().slice(0, 60).forEach((told, at) => this.events.children[at].classList.toggle("fault", told.fault));
    }
  }
}

/** A service. @param {Message} standing @param {boolean} hasDied */
function box(standing, hasDied) {
  const { status, rate_hz, latency_us, cpu_percent, resident_mib } = standing;
  const up = !hasDied && ["running", "ready", "finished"].includes(status.state);
  const number = (/** @type {number | null} */ value, /** @type {number} */ digits, /** @type {string} */ unit) => (value === null ? "–" : `${value.toFixed(digits)} ${unit}`);
  const pairs = [
    ["rate", number(rate_hz, 0, "Hz")],
    ...["p50", "p99", "max"].map((name) => [name, latency_us ? `${latency_us[name].toFixed(0)} µs` : "–"]),
    ["lost", String(status.lost)], ["restarts", String(status.restarts)],
    ["CPU", number(cpu_percent, 1, "%")], ["memory", number(resident_mib, 1, "MiB")],
  ];
  const list = element("dl", "", ...pairs.flatMap(([name, value]) => [element("dt", "", name), element("dd", "number", value)]));
  const made = element("article", `box${PATH.includes(status.service) ? " path" : ""}${up ? "" : " down"}`, element("h3", "", status.stage ? `${status.service}: ${status.stage}` : status.service), element("span", "word", hasDied ? "died, runs again" : status.state), list);
  made.dataset.service = status.service;
  return made;
}
