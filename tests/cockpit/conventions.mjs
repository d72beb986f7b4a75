// The mathematics of the page against docs/conventions.json: `node conventions.mjs PAGE_FOLDER CONVENTIONS`. Prints the largest differences.
import { copyFileSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

const [folder, file] = process.argv.slice(2);
// Node takes a module for one by its ending.
const place = mkdtempSync(join(tmpdir(), "conventions-"));
copyFileSync(join(folder, "attitude.js"), join(place, "attitude.mjs"));
const { FRAMES, angleBetween, angles, attitudeOf, pointOf, up, upOf } = await import(join(place, "attitude.mjs"));
rmSync(place, { recursive: true });
const cases = JSON.parse(readFileSync(file));
const most = { angles: 0, up: 0, attitude: 0, point: 0, frames: 0 };
const worse = (name, value) => { most[name] = Math.max(most[name], value); };
for (const known of cases) {
  const q = known.quaternion_wxyz;
  const [yaw, pitch, roll] = angles(q);
  const turn = (a, b) => Math.abs(Math.sin((a - b) / 2)) * 2;
  worse("angles", Math.abs(pitch - known.pitch_rad));
  if (!known.near_gimbal) worse("angles", Math.max(turn(yaw, known.yaw_rad), turn(roll, known.roll_rad)));
  const inverted = known.chart === "inverted";
  const own = upOf(known.u, known.v, inverted);
  const above = up(q);
  worse("up", Math.hypot(...own.map((part, i) => part - above[i])));
  worse("attitude", angleBetween(attitudeOf(own, known.z_rad, inverted), q));
  const [u, v] = pointOf(inverted ? [above[0], -above[1], -above[2]] : above);
  worse("point", Math.hypot(u - known.u, v - known.v));
  for (const [name, { quaternion_wxyz }] of Object.entries({ ...known.frames, "enu-rfu": known })) worse("frames", angleBetween(FRAMES[name](q), quaternion_wxyz));
}
console.log(JSON.stringify({ cases: cases.length, names: Object.keys(FRAMES), ...most }));
