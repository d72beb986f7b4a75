// Compares the page's attitude mathematics with docs/reference/conventions.json and prints the largest
// differences.
//
//     node conventions.mjs PAGE_FOLDER CONVENTIONS
import { copyFileSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

const [folder, file] = process.argv.slice(2);
// Node recognises a module by its extension.
const copy = mkdtempSync(join(tmpdir(), "conventions-"));
copyFileSync(join(folder, "attitude.js"), join(copy, "attitude.mjs"));
const { FRAMES, angleBetween, angles, attitudeOf, pointOf, up, upOf } = await import(join(copy, "attitude.mjs"));
rmSync(copy, { recursive: true });
const cases = JSON.parse(readFileSync(file));
const largest = { angles: 0, up: 0, attitude: 0, point: 0, frames: 0 };
const record = (name, difference) => { largest[name] = Math.max(largest[name], difference); };
for (const known of cases) {
  const q = known.quaternion_wxyz;
  const [yaw, pitch, roll] = angles(q);
  const angleDifference = (a, b) => Math.abs(Math.sin((a - b) / 2)) * 2;
  record("angles", Math.abs(pitch - known.pitch_rad));
  if (!known.near_gimbal) record("angles", Math.max(angleDifference(yaw, known.yaw_rad), angleDifference(roll, known.roll_rad)));
  const inverted = known.chart === "inverted";
  const upFromPoint = upOf(known.u, known.v, inverted);
  const upVector = up(q);
  record("up", Math.hypot(...upFromPoint.map((part, i) => part - upVector[i])));
  record("attitude", angleBetween(attitudeOf(upFromPoint, known.z_rad, inverted), q));
  const [u, v] = pointOf(inverted ? [upVector[0], -upVector[1], -upVector[2]] : upVector);
  record("point", Math.hypot(u - known.u, v - known.v));
  for (const [name, { quaternion_wxyz }] of Object.entries({ ...known.frames, "enu-rfu": known })) record("frames", angleBetween(FRAMES[name](q), quaternion_wxyz));
}
console.log(JSON.stringify({ cases: cases.length, names: Object.keys(FRAMES), ...largest }));
