// Browser driver for tests. It reads requests and writes replies, one JSON object per line. A driver
// can open any number of pages.
//
//     node driver.mjs FOLDER
//
// The folder's node_modules contains playwright-core.
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const { chromium } = createRequire(`${process.argv[2]}/`)("playwright-core");
const software = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-rasterization", "--disable-accelerated-2d-canvas"];
/**
 * Timeout for starting a browser and showing an empty page. On a busy machine a start can hang, so
 * that it is attempted several times.
 */
const START_TIMEOUT_MS = 20_000;
const MAX_START_ATTEMPTS = 3;
const CLOSE_TIMEOUT_MS = 5_000;
/** Time limit of a request, including three attempts to start the browser. */
const REQUEST_TIMEOUT_MS = 180_000;

/** The browser of all pages, started on demand and replaced if it ends. */
let browser;
/**
 * Pages by number: the page, its context, the session that collects its metrics, its errors,
 * including requests to other hosts, and its requests that failed.
 */
const pages = new Map();

const verbs = {
  async open(own, { url, options: { width, height, scheme, webgl, low_rate, lost_files } }) {
    await own.context?.close();
    const settings = { viewport: { width, height }, colorScheme: scheme, ignoreHTTPSErrors: true, permissions: ["clipboard-read", "clipboard-write"] };
    own.context = await (await (browser ??= startBrowser())).newContext(settings);
    const page = (own.page = await own.context.newPage());
    // The test has closed the page meanwhile.
    if (own.closed) return own.context.close();
    own.metricsSession = undefined;
    page.on("console", (message) => ["error", "warning"].includes(message.type()) && own.errors.push(message.text()));
    page.on("pageerror", (error) => own.errors.push(String(error)));
    page.on("request", (request) => {
      const target = new URL(request.url());
      if (target.hostname !== "127.0.0.1") own.errors.push(`a request to ${target.host}`);
    });
    page.on("requestfailed", (request) => own.failed.push(`${request.url()}: ${request.failure()?.errorText}`));
    await page.addInitScript(() => {
      globalThis.written = [];
      const own = CanvasRenderingContext2D.prototype.fillText;
      CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
        if (globalThis.written.length < 2000) {
          const { actualBoundingBoxLeft: left, actualBoundingBoxRight: right, actualBoundingBoxAscent: ascent, actualBoundingBoxDescent: descent } = this.measureText(text);
          const corners = [[-left, -ascent], [right, -ascent], [-left, descent], [right, descent]].map(([dx, dy]) => this.getTransform().transformPoint({ x: x + dx, y: y + dy }));
          const [xs, ys] = ["x", "y"].map((axis) => corners.map((corner) => corner[axis]));
          const box = { left: Math.min(...xs), right: Math.max(...xs), top: Math.min(...ys), bottom: Math.max(...ys) };
          globalThis.written.push({ canvas: this.canvas, text, style: this.fillStyle, box, frame: globalThis.plumb?.frames() });
        }
        own.call(this, text, x, y);
      };
    });
    // Without a graphics card, rendering takes most of the CPU. Six frames per second suffice.
    if (low_rate) await page.addInitScript(() => {
      const own = globalThis.requestAnimationFrame;
      globalThis.requestAnimationFrame = (draw) => setTimeout(() => own(draw), 140);
    });
    if (!webgl) await page.addInitScript(() => {
      const own = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...more) { return kind === "webgl2" ? null : own.call(this, kind, ...more); };
    });
    // The first request for each of these files fails.
    for (const file of lost_files) await page.route(`**/${file}`, (route) => route.abort("connectionreset"), { times: 1 });
    const response = await page.goto(url);
    return response.headers();
  },
  async eval({ page }, { code }) { return (await page.evaluate(code)) ?? null; },
  // waitForFunction is forbidden by the page's content security policy.
  async until({ page, errors, failed }, { code }) {
    for (const end = Date.now() + 60_000; Date.now() < end; await page.waitForTimeout(50)) {
      // A page that is loading again has no condition to check yet.
      const holds = await page.evaluate(code).catch((error) => { if (!String(error).includes("context was destroyed")) throw error; });
      if (holds) return null;
    }
    const state = await page.evaluate("document.getElementById('state')?.textContent");
    throw new Error(`condition not met within 60 s: ${code}; state ${state}, errors ${JSON.stringify(errors)}, failed requests ${JSON.stringify(failed)}`);
  },
  async key({ page }, { key }) { await page.keyboard.press(key); return null; },
  async click({ page }, { at }) { await page.click(at); return null; },
  /** Loads the page again; with `denied`, the browser denies access to its storage. */
  async reload({ page }, { denied }) {
    if (denied) await page.addInitScript(() => {
      for (const name of ["localStorage", "sessionStorage"]) Object.defineProperty(globalThis, name, { get() { throw new DOMException("denied", "SecurityError"); } });
    });
    await page.reload();
    return null;
  },
  async shot({ page }, { file }) { await page.screenshot({ path: file }); return null; },
  async heap({ page }) {
    const session = await page.context().newCDPSession(page);
    await session.send("HeapProfiler.collectGarbage");
    return (await session.send("Runtime.getHeapUsage")).usedSize;
  },
  /** Returns the texts whose contrast ratio to their background is below 4.5 (WCAG 2.2, 1.4.3). */
  async contrast({ page }) { return page.evaluate(findLowContrast); },
  /** Returns the texts that are cut off or that cover each other. */
  async layout({ page }) { return page.evaluate(findLayoutFaults); },
  /** Returns Chromium's metrics of the page's thread since the first call, such as script time, s. */
  async metrics(own) {
    if (!own.metricsSession) {
      own.metricsSession = await own.context.newCDPSession(own.page);
      await own.metricsSession.send("Performance.enable", { timeDomain: "threadTicks" });
    }
    const { metrics } = await own.metricsSession.send("Performance.getMetrics");
    return Object.fromEntries(metrics.map(({ name, value }) => [name, value]));
  },
  async errors({ errors }) { return errors; },
  async close(own, request) {
    pages.delete(request.page);
    own.closed = true;
    await own.context?.close();
    return null;
  },
};

/** Starts a browser and verifies that it can show an empty page. */
async function startBrowser() {
  for (let attempt = 1; ; attempt += 1) {
    let started;
    try {
      started = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", ...software], timeout: START_TIMEOUT_MS });
      await within(START_TIMEOUT_MS, started.newPage().then((page) => page.close()));
      started.on("disconnected", () => { browser = undefined; });
      return started;
    } catch (error) {
      if (started) await within(CLOSE_TIMEOUT_MS, started.close()).catch(() => {});
      if (attempt === MAX_START_ATTEMPTS) {
        browser = undefined;
        throw error;
      }
    }
  }
}

/** Returns the result of a promise, or fails after a time limit. */
function within(timeout_ms, promise) {
  let timer;
  const late = new Promise((_, reject) => { timer = setTimeout(() => reject(new Error(`not within ${timeout_ms / 1000} s`)), timeout_ms); });
  return Promise.race([promise, late]).finally(() => clearTimeout(timer));
}

/** Executes a request and writes its reply. */
async function handle(request) {
  if (!pages.has(request.page)) pages.set(request.page, { errors: [], failed: [] });
  const { number } = request;
  try {
    console.log(JSON.stringify({ number, ok: await within(REQUEST_TIMEOUT_MS, verbs[request.do](pages.get(request.page), request)) }));
  } catch (error) {
    console.log(JSON.stringify({ number, error: String(error) }));
  }
}

/** Runs in the page. Checks its visible texts and the texts drawn on canvases since the last call. */
function findLowContrast() {
  const parts = (text) => (text.startsWith("#") ? [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16)).concat(1) : [...text.matchAll(/[\d.]+/g)].map(Number).concat(1).slice(0, 4));
  const over = ([r, g, b, a], under) => [r, g, b].map((part, i) => a * part + (1 - a) * under[i]);
  const light = (rgb) => rgb.map((part) => part / 255).map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4)).reduce((sum, part, i) => sum + part * [0.2126, 0.7152, 0.0722][i], 0);
  const ratio = (a, b) => { const [x, y] = [light(a), light(b)]; return (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05); };
  const behind = (at) => {
    const layers = [];
    for (let one = at; one; one = one.parentElement) layers.push(parts(getComputedStyle(one).backgroundColor));
    return layers.reverse().reduce((under, layer) => over(layer, under), [255, 255, 255]);
  };
  // Stale content is shown in greyscale.
  const shown = (colour, at) => {
    const grey = colour.reduce((sum, part, i) => sum + part * [0.2126, 0.7152, 0.0722][i], 0);
    return at.closest(".stale") && getComputedStyle(at.closest(".stale")).filter === "grayscale(1)" ? [grey, grey, grey] : colour;
  };
  const own = (name) => parts(getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  const found = [];
  let checked = 0;
  const check = (what, colour, under, at) => { checked += 1; const found_ratio = ratio(shown(over(colour, under), at), shown(under, at)); if (found_ratio < 4.5) found.push(`${what}: ${found_ratio.toFixed(2)}`); };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const at = walker.currentNode.parentElement;
    const text = walker.currentNode.textContent.trim();
    if (text && at.checkVisibility({ visibilityProperty: true }) && !["SCRIPT", "STYLE"].includes(at.tagName)) check(text, parts(getComputedStyle(at).color), behind(at), at);
  }
  for (const { canvas, text, style } of globalThis.written.splice(0)) {
    if (!canvas.isConnected) continue;
    const under = canvas.getAttribute("aria-label") === "Artificial horizon" ? [own("sky"), own("ground")] : [behind(canvas)];
    under.forEach((one) => check(`${text}, on a canvas`, parts(style), one.slice(0, 3), canvas));
  }
  return { checked, found: [...new Set(found)] };
}

/** Runs in the page. Checks its visible texts and those that its canvases show. */
function findLayoutFaults() {
  const found = [];
  const tolerance_px = 1.5;
  const check = (what, box, limits) => {
    for (const [side, sign] of [["left", -1], ["right", 1], ["top", -1], ["bottom", 1]]) {
      if (sign * (box[side] - (limits[side] ?? sign * Infinity)) > tolerance_px) found.push(`${what}: cut off, ${side}`);
    }
  };
  const cover = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > tolerance_px && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > tolerance_px;
  const checkPairs = (texts) => texts.forEach(([text, box], at) => texts.slice(0, at).forEach(([other, under]) => { if (cover(box, under)) found.push(`${text} covers ${other}`); }));
  // The part of the page in which an element is visible, or can be scrolled into view without horizontal scrolling.
  const limitsOf = (element) => {
    const limits = { left: 0, right: document.documentElement.clientWidth };
    for (let at = element; at !== document.body; at = at.parentElement) {
      const { overflowX, overflowY, textOverflow } = getComputedStyle(at), box = at.getBoundingClientRect();
      if (at.className === "scrolls" || textOverflow === "ellipsis") return {};
      if (overflowX !== "visible") { limits.left = Math.max(limits.left, box.left); limits.right = Math.min(limits.right, box.right); }
      if (overflowY === "hidden") { limits.top = Math.max(limits.top ?? -Infinity, box.top); limits.bottom = Math.min(limits.bottom ?? Infinity, box.bottom); }
      else if (overflowY !== "visible") { delete limits.top; delete limits.bottom; break; }
    }
    return limits;
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const range = document.createRange();
  /** Texts that must keep clear of each other, by their container. */
  const groups = new Map();
  while (walker.nextNode()) {
    const at = walker.currentNode.parentElement, text = walker.currentNode.textContent.trim();
    if (!text || !at.checkVisibility({ visibilityProperty: true }) || ["SCRIPT", "STYLE", "OPTION"].includes(at.tagName)) continue;
    range.selectNodeContents(walker.currentNode);
    const box = range.getBoundingClientRect();
    check(text, box, limitsOf(at));
    const group = at.closest(".strip-legends") ?? at.closest(".labels, .note")?.parentElement;
    if (group) groups.set(group, [...(groups.get(group) ?? []), [text, box]]);
  }
  groups.forEach(checkPairs);
  for (const entry of document.querySelectorAll(".strip-legends button:not([hidden])")) {
    const next = entry.nextElementSibling;
    if (next?.matches("button:not([hidden])") && next.getBoundingClientRect().left - entry.getBoundingClientRect().right < 3 && parseFloat(getComputedStyle(entry).paddingRight) < 3) found.push(`${entry.textContent}: no space before ${next.textContent}`);
  }
  const shown = globalThis.written.filter(({ canvas }) => canvas.isConnected);
  const last = Math.max(...shown.map(({ frame }) => frame));
  const onCanvas = new Map();
  for (const { canvas, text, box, frame } of shown) {
    if (frame !== last || !text) continue;
    check(`${text}, on a canvas`, box, { left: 0, top: 0, right: canvas.width, bottom: canvas.height });
    onCanvas.set(canvas, [...(onCanvas.get(canvas) ?? []), [text, box]]);
  }
  onCanvas.forEach(checkPairs);
  return [...new Set(found)];
}

// Requests run concurrently, so that pages do not wait for each other.
for await (const line of createInterface({ input: process.stdin })) handle(JSON.parse(line));
// If the browser does not close in time, it is killed with this process.
await within(CLOSE_TIMEOUT_MS, Promise.resolve(browser).then((started) => started?.close())).catch(() => {});
process.exit(0);
