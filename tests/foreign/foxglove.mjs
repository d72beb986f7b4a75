// The client that Foxglove publishes, at the cockpit: `node foxglove.mjs NPM_FOLDER PAGE_FOLDER HOST:PORT SECONDS`. Prints what it saw.
import { copyFileSync, mkdtempSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";

const [folder, page, host, seconds] = process.argv.slice(2);
const require = createRequire(`${folder}/`);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");
// Node takes a module for one by its ending.
const place = mkdtempSync(join(tmpdir(), "foxglove-"));
copyFileSync(join(page, "wire.js"), join(place, "wire.mjs"));
const { Wire } = await import(join(place, "wire.mjs"));
rmSync(place, { recursive: true });
const wire = new Wire(await (await fetch(`http://${host}/schema.json`)).json());

const seen = { info: null, schemas: {}, messages: {}, attitude: null, errors: [] };
const topics = new Map();
const client = new FoxgloveClient({ ws: new WebSocket(`ws://${host}/foxglove`, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
client.on("error", (error) => seen.errors.push(String(error)));
client.on("status", (status) => seen.errors.push(JSON.stringify(status)));
client.on("serverInfo", (info) => { seen.info = info; });
client.on("advertise", (channels) => {
  for (const { id, topic, encoding, schemaName } of channels) {
    seen.schemas[topic] = `${encoding} ${schemaName}`;
    topics.set(client.subscribe(id), topic);
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const topic = topics.get(subscriptionId);
  seen.messages[topic] = (seen.messages[topic] ?? 0) + 1;
  if (topic !== "/attitude") return;
  const { header, quaternion } = wire.decode("AttitudeOutput", new Uint8Array(data.buffer, data.byteOffset, data.byteLength));
  seen.attitude = { tick: header.tick, quaternion: [quaternion.w, quaternion.x, quaternion.y, quaternion.z], time_s: Number(timestamp / 1_000_000n) / 1e3 };
});
setTimeout(() => {
  client.close();
  console.log(JSON.stringify(seen));
  process.exit(0);
}, 1000 * Number(seconds));
