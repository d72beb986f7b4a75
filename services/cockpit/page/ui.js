// Colours of the page for canvases, and helpers for the document.

/** @type {Map<string, string>} */
const colours = new Map();
/** @type {Map<string, number[]>} */
const tints = new Map();

/** Returns a colour defined in style.css. @param {string} name */
export function colour(name) {
  let value = colours.get(name);
  if (!value) {
    value = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    colours.set(name, value);
  }
  return value;
}

/** Returns a colour defined in style.css for WebGL. @param {string} name @param {number} [alpha] @returns {[number, number, number, number]} */
export function tint(name, alpha = 1) {
  let parts = tints.get(name);
  if (!parts) {
    const text = colour(name);
    parts = [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16) / 255);
    tints.set(name, parts);
  }
  return [parts[0], parts[1], parts[2], alpha];
}

/** Sets the theme, or toggles it. @param {string} [name] */
export function setTheme(name) {
  const root = document.documentElement;
  root.dataset.theme = name ?? (root.dataset.theme === "dark" ? "light" : "dark");
  colours.clear();
  tints.clear();
}

/** Creates an element with text or children. @template {keyof HTMLElementTagNameMap} T @param {T} tag @param {string} className @param {...(string | Node)} children */
export function element(tag, className, ...children) {
  const created = document.createElement(tag);
  if (className) created.className = className;
  created.append(...children);
  return created;
}

/** Creates a button. @param {string} id @param {string} text @param {() => void} onClick */
export function button(id, text, onClick) {
  const created = element("button", "", text);
  created.id = id;
  created.type = "button";
  created.addEventListener("click", onClick);
  return created;
}

/** Creates a list to select from. @param {string} id @param {[value: string, text: string][]} options */
export function select(id, options = []) {
  const created = element("select", "");
  created.id = id;
  setOptions(created, options);
  return created;
}

/** Replaces the options of a list. The selected one stays selected if it is still there. @param {HTMLSelectElement} list @param {[value: string, text: string][]} options */
export function setOptions(list, options) {
  const selected = list.value;
  list.replaceChildren(...options.map(([value, text]) => new Option(text, value, false, value === selected)));
}

/** Creates a line of text that is announced when it changes. @param {string} id */
export function statusLine(id) {
  const created = element("p", "");
  created.id = id;
  created.setAttribute("role", "status");
  return created;
}

/** Sets the text of an element, only if it differs, to avoid layout. @param {Element} target @param {string} text */
export function write(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

/** Fills a table; unchanged cells are not touched. @param {HTMLElement} body @param {string[][]} rows @param {string[]} classNames Class of each column. */
export function fillTable(body, rows, classNames) {
  while (body.children.length > rows.length) body.lastElementChild?.remove();
  while (body.children.length < rows.length) body.append(element("tr", "", ...classNames.map((name) => element("td", name))));
  rows.forEach((row, at) => row.forEach((text, column) => write(body.children[at].children[column], text)));
}
