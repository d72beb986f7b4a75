// Parameters of a stage: values to change, defaults, ranges and meanings.

import { element, table, write } from "./ui.js";

/** Name, unit, default, minimum, maximum and meaning. @typedef {[string, string, number, number, number, string]} Parameter */
/** @typedef {{ name: string, value: number }} Setting */

export class Parameters {
  /** @param {HTMLElement} parent */
  constructor(parent) {
    this.title = element("h2", "");
    this.note = element("p", "c-quiet");
    this.rows = element("tbody", "");
    this.table = table("parameters", [["parameter", ""], ["value", ""], ["unit", ""], ["default", "number"], ["range", "number"]], this.rows);
    this.table.hidden = true;
    parent.append(this.title, this.note, this.table);
    /** Parameters shown, each with its field. @type {{ name: string, standard: number | null, field: HTMLInputElement }[]} */ this.fields = [];
    /** Values of the running stage; null if unknown or another stage is shown. @type {Setting[] | null} */ this.running = null;
    /** Content shown, as JSON. */ this.shown = "";
  }

  /** Shows the parameters of a stage. Values that were typed in are kept until something else is to be shown.
   * @param {string} title @param {Parameter[] | undefined} known The parameters; undefined for a program @param {Setting[] | null} running Values that differ from the defaults if the stage runs, otherwise null @param {string} note */
  show(title, known, running, note) {
    const content = JSON.stringify([title, known?.length, running, note]);
    if (content === this.shown) return;
    this.shown = content;
    this.running = running;
    write(this.title, `Parameters of ${title}`);
    /** @type {Parameter[]} */
    const all = known ?? (running ?? []).map(({ name }) => [name, "", NaN, NaN, NaN, ""]);
    write(this.note, note || (all.length ? "" : "This stage has no parameters."));
    this.table.hidden = !all.length;
    this.fields = all.map(([name, , standard]) => {
      const field = element("input", "number");
      field.id = `parameter-${name}`;
      field.inputMode = "decimal";
      field.value = String(running?.find((one) => one.name === name)?.value ?? (Number.isNaN(standard) ? "" : standard));
      field.setAttribute("aria-label", name);
      return { name, standard, field };
    });
    this.rows.replaceChildren(...all.map(([name, unit, standard, least, most, meaning], at) => element("tr", "",
      element("td", "", name, element("div", "c-quiet", meaning)), element("td", "", this.fields[at].field), element("td", "", unit),
      ...[Number.isNaN(standard) ? "–" : String(standard), Number.isNaN(least) ? "–" : `${least} to ${most}`.replace("-", "−")].map((text) => element("td", "number", text)))));
  }

  /** Returns the parameters whose values differ from their defaults, or the reason why a field has no value. @returns {Setting[] | string} */
  settings() {
    const all = this.fields.map(({ name, standard, field }) => ({ name, standard, text: field.value.trim(), value: Number(field.value.trim()) }));
    const wrong = all.find(({ value }) => !Number.isFinite(value));
    if (wrong) return `${wrong.name}: expected a number, found ${wrong.text}`;
    return all.filter(({ text, value, standard }) => text && value !== standard).map(({ name, value }) => ({ name, value }));
  }

  /** Returns whether a field differs from the value of the running stage. */
  isChanged() {
    const settings = this.settings(), { running } = this;
    return !running || typeof settings === "string" || settings.length !== running.length || settings.some(({ name, value }) => running.find((one) => one.name === name)?.value !== value);
  }
}
