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

/** Returns a stored setting, or null if there is none or the browser denies access to its storage. @param {"localStorage" | "sessionStorage"} storage Storage of the browser or of the tab @param {string} name */
export function stored(storage, name) {
  try {
    return window[storage].getItem(name);
  } catch {
    return null;
  }
}

/** Stores a setting. Without access to the storage it is kept only until the page is closed. @param {"localStorage" | "sessionStorage"} storage @param {string} name @param {string} value */
export function store(storage, name, value) {
  try {
    window[storage].setItem(name, value);
  } catch {
    // The page works without storage.
  }
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

/** Creates a canvas that fills its element. @param {string} [label] */
export function createCanvas(label) {
  const created = element("canvas", "");
  if (label) created.setAttribute("aria-label", label);
  return created;
}

/** Fits a canvas to its element, clears it and resets its context. Returns its context, width and height. @param {HTMLCanvasElement} canvas @returns {[CanvasRenderingContext2D, number, number] | null} */
export function prepareCanvas(canvas) {
  const context = canvas.getContext("2d");
  const ratio = Math.min(devicePixelRatio, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!context || !width || !height) return null;
  const [wide, high] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== wide || canvas.height !== high) { canvas.width = wide; canvas.height = high; }
  context.reset();
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return [context, width, height];
}

/** Draws a line through points, x and y in turn. @param {CanvasRenderingContext2D} context @param {...number} points */
export function strokeLine(context, ...points) {
  context.beginPath();
  for (let at = 0; at < points.length; at += 2) context.lineTo(points[at], points[at + 1]);
  context.stroke();
}

/** Draws the cursor as a dotted line. @param {CanvasRenderingContext2D} context @param {number} x @param {number} height */
export function strokeCursor(context, x, height) {
  context.strokeStyle = colour("ink");
  context.setLineDash([2, 3]);
  strokeLine(context, x, 0, x, height);
  context.setLineDash([]);
}

/** Creates a legend and its entries. @param {[mark: string, className: string, text: string][]} entries @returns {[HTMLUListElement, HTMLLIElement[]]} */
export function legend(entries) {
  const items = entries.map(([mark, className, text]) => {
    const item = element("li", className, text);
    item.dataset.mark = mark;
    return item;
  });
  return [element("ul", "legend", ...items), items];
}

/** Creates a table with a header. @param {string} className @param {[name: string, className: string][]} columns @param {HTMLElement} body */
export function table(className, columns, body) {
  return element("table", className, element("thead", "", element("tr", "", ...columns.map(([name, kind]) => element("th", kind, name)))), body);
}

/** Creates a section with a heading. @param {string} title @param {...(string | Node)} children */
export const section = (title, ...children) => element("section", "", element("h2", "", title), ...children);

/** Fills a table; unchanged cells are not touched. @param {HTMLElement} body @param {string[][]} rows @param {string[]} classNames Class of each column. */
export function fillTable(body, rows, classNames) {
  while (body.children.length > rows.length) body.lastElementChild?.remove();
  while (body.children.length < rows.length) body.append(element("tr", "", ...classNames.map((name) => element("td", name))));
  rows.forEach((row, at) => row.forEach((text, column) => write(body.children[at].children[column], text)));
}
