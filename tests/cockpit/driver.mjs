// A browser on strings: one JSON object a line in, one out. `node driver.mjs FOLDER`, whose node_modules has playwright-core.
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const { chromium } = createRequire(`${process.argv[2]}/`)("playwright-core");
const software = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", ...software] });
/** What must not be: errors, and requests to others. */
const troubles = [];
let page;

const verbs = {
  async open({ url, width, height, scheme, webgl }) {
    const context = await browser.newContext({ viewport: { width, height }, colorScheme: scheme, ignoreHTTPSErrors: true });
    page = await context.newPage();
    page.on("console", (said) => ["error", "warning"].includes(said.type()) && troubles.push(said.text()));
    page.on("pageerror", (error) => troubles.push(String(error)));
    page.on("request", (request) => {
      const at = new URL(request.url());
      if (at.hostname !== "127.0.0.1") troubles.push(`a request to ${at.host}`);
    });
    if (!webgl) await page.addInitScript(() => {
      const own = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...more) { return kind === "webgl2" ? null : own.call(this, kind, ...more); };
    });
    const answer = await page.goto(url);
    return answer.headers();
  },
  async eval({ code }) { return (await page.evaluate(code)) ?? null; },
  // The page's policy forbids what waitForFunction does.
  async until({ code }) {
    for (const end = Date.now() + 60_000; Date.now() < end; await page.waitForTimeout(50)) {
      if (await page.evaluate(code)) return null;
    }
    throw new Error("waited in vain");
  },
  async key({ key }) { await page.keyboard.press(key); return null; },
  async click({ at }) { await page.click(at); return null; },
  async shot({ file }) { await page.screenshot({ path: file }); return null; },
  async heap() {
    const session = await page.context().newCDPSession(page);
    await session.send("HeapProfiler.collectGarbage");
    return (await session.send("Runtime.getHeapUsage")).usedSize;
  },
  async troubles() { return troubles; },
  async close() { await browser.close(); return null; },
};

for await (const line of createInterface({ input: process.stdin })) {
  const asked = JSON.parse(line);
  try {
    console.log(JSON.stringify({ ok: await verbs[asked.do](asked) }));
  } catch (error) {
    console.log(JSON.stringify({ error: String(error) }));
  }
  if (asked.do === "close") process.exit(0);
}
await browser.close();
