// Colours of the page, for canvases, and small helpers of the document.

/** @type {Map<string, string>} */
const known = new Map();
/** @type {Map<string, number[]>} */
const tints = new Map();

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
  let parts = tints.get(name);
  if (!parts) {
    const text = colour(name);
    parts = [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16) / 255);
    tints.set(name, parts);
  }
  return [parts[0], parts[1], parts[2], alpha];
}

/** The other theme, or the one that is asked for. @param {string} [wanted] */
export function theme(wanted) {
  const root = document.documentElement;
  root.dataset.theme = wanted ?? (root.dataset.theme === "dark" ? "light" : "dark");
  known.clear();
  tints.clear();
}

/** An element with text or children. @param {string} tag @param {string} look @param {...(string | Node)} children */
export function element(tag, look, ...children) {
  const made = document.createElement(tag);
  if (look) made.className = look;
  made.append(...children);
  return made;
}

/** Writes a text where it is another one: a page that writes what stands there is laid out anew for nothing. @param {Element} at @param {string} text */
export function write(at, text) {
  if (at.textContent !== text) at.textContent = text;
}

/** Writes a table; what has not changed is not touched. @param {HTMLElement} body @param {string[][]} rows @param {string[]} looks Of each column. */
export function rows(body, rows, looks) {
  while (body.children.length > rows.length) body.lastElementChild?.remove();
  while (body.children.length < rows.length) body.append(element("tr", "", ...looks.map((look) => element("td", look))));
  rows.forEach((row, at) => row.forEach((text, column) => write(body.children[at].children[column], text)));
}
