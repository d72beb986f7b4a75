// Connects Foxglove's own client to the cockpit and prints what it received as JSON.
//
//     node foxglove.mjs NPM_FOLDER PAGE_FOLDER HOST:PORT SECONDS
import { copyFileSync, mkdtempSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";

const [folder, page, host, seconds] = process.argv.slice(2);
const require = createRequire(`${folder}/`);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");
// Node recognises a module by its extension.
const copy = mkdtempSync(join(tmpdir(), "foxglove-"));
copyFileSync(join(page, "wire.js"), join(copy, "wire.mjs"));
const { Wire } = await import(join(copy, "wire.mjs"));
rmSync(copy, { recursive: true });
const wire = new Wire(await (await fetch(`http://${host}/schema.json`)).json());

const received = { info: null, schemas: {}, messages: {}, attitude: null, errors: [] };
const topics = new Map();
const client = new FoxgloveClient({ ws: new WebSocket(`ws://${host}/foxglove`, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
client.on("error", (error) => received.errors.push(String(error)));
client.on("status", (status) => received.errors.push(JSON.stringify(status)));
client.on("serverInfo", (info) => { received.info = info; });
client.on("advertise", (channels) => {
  for (const { id, topic, encoding, schemaName } of channels) {
    received.schemas[topic] = `${encoding} ${schemaName}`;
    topics.set(client.subscribe(id), topic);
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const topic = topics.get(subscriptionId);
  received.messages[topic] = (received.messages[topic] ?? 0) + 1;
  if (topic !== "/attitude") return;
  const { header, quaternion } = wire.decode("AttitudeOutput", new Uint8Array(data.buffer, data.byteOffset, data.byteLength));
  received.attitude = { tick: header.tick, quaternion: [quaternion.w, quaternion.x, quaternion.y, quaternion.z], time_s: Number(timestamp / 1_000_000n) / 1e3 };
});
setTimeout(() => {
  client.close();
  console.log(JSON.stringify(received));
  process.exit(0);
}, 1000 * Number(seconds));
