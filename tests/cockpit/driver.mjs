// A browser on strings: one JSON object a line in, one out, for any number of pages. `node driver.mjs FOLDER`, whose node_modules has playwright-core.
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const { chromium } = createRequire(`${process.argv[2]}/`)("playwright-core");
const software = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-rasterization", "--disable-accelerated-2d-canvas"];
/** How long a browser may take to begin, and to show an empty page, and how often that is tried: on a busy machine one has been seen that never did. */
const BEGIN_LIMIT_MS = 20_000;
const BEGIN_TRIES = 3;
const END_LIMIT_MS = 5_000;
/** How long anything that is asked may take, a browser that begins three times included. */
const LIMIT_MS = 180_000;

/** The browser of all pages, from the first one on; after one that has ended another one. */
let browser;
/** By number: the page, its context, its troubles (errors, and requests to others), and the session that counts, for each begins at 0. */
const pages = new Map();

const verbs = {
  async open(own, { url, look: { width, height, scheme, webgl, seldom } }) {
    await own.context?.close();
    const look = { viewport: { width, height }, colorScheme: scheme, ignoreHTTPSErrors: true, permissions: ["clipboard-read", "clipboard-write"] };
    own.context = await (await (browser ??= begun())).newContext(look);
    const page = (own.page = await own.context.newPage());
    // Whoever asked waits no more.
    if (own.closed) return own.context.close();
    own.counting = undefined;
    page.on("console", (said) => ["error", "warning"].includes(said.type()) && own.troubles.push(said.text()));
    page.on("pageerror", (error) => own.troubles.push(String(error)));
    page.on("request", (request) => {
      const at = new URL(request.url());
      if (at.hostname !== "127.0.0.1") own.troubles.push(`a request to ${at.host}`);
    });
    await page.addInitScript(() => {
      globalThis.written = [];
      const own = CanvasRenderingContext2D.prototype.fillText;
      CanvasRenderingContext2D.prototype.fillText = function (text, ...more) {
        if (globalThis.written.length < 2000) globalThis.written.push({ canvas: this.canvas, text, style: this.fillStyle });
        own.call(this, text, ...more);
      };
    });
    // Without a graphics card pictures take most of the processor: six a second show what thirty would.
    if (seldom) await page.addInitScript(() => {
      const own = globalThis.requestAnimationFrame;
      globalThis.requestAnimationFrame = (draw) => setTimeout(() => own(draw), 140);
    });
    if (!webgl) await page.addInitScript(() => {
      const own = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...more) { return kind === "webgl2" ? null : own.call(this, kind, ...more); };
    });
    const answer = await page.goto(url);
    return answer.headers();
  },
  async eval({ page }, { code }) { return (await page.evaluate(code)) ?? null; },
  // The page's policy forbids what waitForFunction does.
  async until({ page }, { code }) {
    for (const end = Date.now() + 60_000; Date.now() < end; await page.waitForTimeout(50)) {
      if (await page.evaluate(code)) return null;
    }
    throw new Error("waited in vain");
  },
  async key({ page }, { key }) { await page.keyboard.press(key); return null; },
  async click({ page }, { at }) { await page.click(at); return null; },
  async shot({ page }, { file }) { await page.screenshot({ path: file }); return null; },
  async heap({ page }) {
    const session = await page.context().newCDPSession(page);
    await session.send("HeapProfiler.collectGarbage");
    return (await session.send("Runtime.getHeapUsage")).usedSize;
  },
  /** Texts that stand out too little from what is behind them: below a contrast ratio of 4.5 (WCAG 2.2, 1.4.3). */
  async contrast({ page }) { return page.evaluate(tooPale); },
  /** Script time since this was first asked, s, and what else Chromium counts; of the page's thread, not of the clock. */
  async metrics(own) {
    if (!own.counting) {
      own.counting = await own.context.newCDPSession(own.page);
      await own.counting.send("Performance.enable", { timeDomain: "threadTicks" });
    }
    const { metrics } = await own.counting.send("Performance.getMetrics");
    return Object.fromEntries(metrics.map(({ name, value }) => [name, value]));
  },
  async troubles({ troubles }) { return troubles; },
  async close(own, asked) {
    pages.delete(asked.page);
    own.closed = true;
    await own.context?.close();
    return null;
  },
};

/** A browser that has shown an empty page. */
async function begun() {
  for (let tries = 1; ; tries += 1) {
    let one;
    try {
      one = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", ...software], timeout: BEGIN_LIMIT_MS });
      await within(BEGIN_LIMIT_MS, one.newPage().then((page) => page.close()));
      one.on("disconnected", () => { browser = undefined; });
      return one;
    } catch (error) {
      if (one) await within(END_LIMIT_MS, one.close()).catch(() => {});
      if (tries === BEGIN_TRIES) {
        browser = undefined;
        throw error;
      }
    }
  }
}

/** The same, or an error when it takes longer. */
function within(limit_ms, promise) {
  let timer;
  const late = new Promise((_, reject) => { timer = setTimeout(() => reject(new Error(`not within ${limit_ms / 1000} s`)), limit_ms); });
  return Promise.race([promise, late]).finally(() => clearTimeout(timer));
}

/** Answers under the number of the question. */
async function answer(asked) {
  if (!pages.has(asked.page)) pages.set(asked.page, { troubles: [] });
  const { number } = asked;
  try {
    console.log(JSON.stringify({ number, ok: await within(LIMIT_MS, verbs[asked.do](pages.get(asked.page), asked)) }));
  } catch (error) {
    console.log(JSON.stringify({ number, error: String(error) }));
  }
}

/** Runs in the page: of its text, and of what its canvases were told to write since the last time. */
function tooPale() {
  const parts = (text) => (text.startsWith("#") ? [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16)).concat(1) : [...text.matchAll(/[\d.]+/g)].map(Number).concat(1).slice(0, 4));
  const over = ([r, g, b, a], under) => [r, g, b].map((part, i) => a * part + (1 - a) * under[i]);
  const light = (rgb) => rgb.map((part) => part / 255).map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4)).reduce((sum, part, i) => sum + part * [0.2126, 0.7152, 0.0722][i], 0);
  const ratio = (a, b) => { const [x, y] = [light(a), light(b)]; return (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05); };
  const behind = (at) => {
    const layers = [];
    for (let one = at; one; one = one.parentElement) layers.push(parts(getComputedStyle(one).backgroundColor));
    return layers.reverse().reduce((under, layer) => over(layer, under), [255, 255, 255]);
  };
  // What is stale is shown without colour.
  const shown = (colour, at) => {
    const grey = colour.reduce((sum, part, i) => sum + part * [0.2126, 0.7152, 0.0722][i], 0);
    return at.closest(".stale") && getComputedStyle(at.closest(".stale")).filter === "grayscale(1)" ? [grey, grey, grey] : colour;
  };
  const own = (name) => parts(getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  const found = [];
  let looked = 0;
  const look = (what, colour, under, at) => { looked += 1; const seen = ratio(shown(over(colour, under), at), shown(under, at)); if (seen < 4.5) found.push(`${what}: ${seen.toFixed(2)}`); };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const at = walker.currentNode.parentElement;
    const text = walker.currentNode.textContent.trim();
    if (text && at.checkVisibility({ visibilityProperty: true }) && !["SCRIPT", "STYLE"].includes(at.tagName)) look(text, parts(getComputedStyle(at).color), behind(at), at);
  }
  for (const { canvas, text, style } of globalThis.written.splice(0)) {
    if (!canvas.isConnected) continue;
    const under = canvas.getAttribute("aria-label") === "Artificial horizon" ? [own("sky"), own("ground")] : [behind(canvas)];
    under.forEach((one) => look(`${text}, on a canvas`, parts(style), one.slice(0, 3), canvas));
  }
  return { looked, found: [...new Set(found)] };
}

// The pages do not wait for each other.
for await (const line of createInterface({ input: process.stdin })) answer(JSON.parse(line));
// What has not ended by then ends with this process.
await within(END_LIMIT_MS, Promise.resolve(browser).then((one) => one?.close())).catch(() => {});
process.exit(0);
