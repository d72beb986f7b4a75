// Colours of the page, for canvases, and small helpers of the document.

/** @type {Map<string, string>} */
const known = new Map();

/** A colour of style.css by its name. @param {string} name */
export function colour(name) {
  let value = known.get(name);
  if (!value) {
    value = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    known.set(name, value);
  }
  return value;
}

/** The same for WebGL. @param {string} name @param {number} [alpha] @returns {[number, number, number, number]} */
export function tint(name, alpha = 1) {
  const text = colour(name);
  const part = (/** @type {number} */ at) => parseInt(text.slice(at, at + 2), 16) / 255;
  return [part(1), part(3), part(5), alpha];
}

/** The other theme, or the one that is asked for. @param {string} [wanted] */
export function theme(wanted) {
  const root = document.documentElement;
  root.dataset.theme = wanted ?? (root.dataset.theme === "dark" ? "light" : "dark");
  known.clear();
}

/** An element with text or children. @param {string} tag @param {string} look @param {...(string | Node)} children */
export function element(tag, look, ...children) {
  const made = document.createElement(tag);
  if (look) made.className = look;
  made.append(...children);
  return made;
}

/** Puts rows in the place of those of a table. @param {HTMLElement} body @param {(string | Node)[][]} rows @param {string[]} looks */
export function rows(body, rows, looks) {
  body.replaceChildren(...rows.map((row) => element("tr", "", ...row.map((cell, place) => element("td", looks[place] ?? "", cell)))));
}
