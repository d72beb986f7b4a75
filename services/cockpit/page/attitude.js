// Attitude mathematics for drawing, see docs/reference/conventions.md. A quaternion [w, x, y, z] rotates body axes to the reference frame, whose z axis is up.

/** @typedef {[number, number, number]} Vec */
/** @typedef {[number, number, number, number]} Quat */

export const DEGREE = Math.PI / 180;

/** Rotates a vector from body axes to the reference frame. @param {Quat} q @param {Vec} v @returns {Vec} */
export function rotate([w, x, y, z], [a, b, c]) {
  const s = y * c - z * b + w * a, t = z * a - x * c + w * b, u = x * b - y * a + w * c;
  return [a + 2 * (y * u - z * t), b + 2 * (z * s - x * u), c + 2 * (x * t - y * s)];
}

/** @param {Quat} q @returns {Quat} */
export const conjugate = ([w, x, y, z]) => [w, -x, -y, -z];

/** @param {Quat} p @param {Quat} q @returns {Quat} */
export function product([a, b, c, d], [w, x, y, z]) {
  return [a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w];
}

/** Returns the up vector in body axes. @param {Quat} q */
export const up = (q) => rotate(conjugate(q), [0, 0, 1]);

/** Returns the point w = u + jv of an up vector in body axes: its stereographic projection from the nadir. It is not finite upside down. @param {Vec} up @returns {[number, number]} */
export const pointOf = ([a, b, c]) => [a / (1 + c), b / (1 + c)];

/** Returns the up vector of a point w in its chart. @param {number} u @param {number} v @param {boolean} inverted @returns {Vec} */
export function upOf(u, v, inverted) {
  const square = u * u + v * v, scale = 2 / (1 + square);
  const [a, b, c] = [u * scale, v * scale, (1 - square) / (1 + square)];
  return inverted ? [a, -b, -c] : [a, b, c];
}

/** Returns the attitude with this up vector and the rotation z about the vertical. @param {Vec} up @param {number} z @param {boolean} inverted @returns {Quat} */
export function attitudeOf(up, z, inverted) {
  const [a, b, c] = inverted ? [up[0], -up[1], -up[2]] : up;
  // The shortest rotation from the body's up vector to the vertical; the rotation z follows.
  const length = Math.hypot(1 + c, a, b);
  /** @type {Quat} */
  const tilt = [(1 + c) / length, b / length, -a / length, 0];
  const q = product([Math.cos(z / 2), 0, 0, Math.sin(z / 2)], tilt);
  return inverted ? product(q, [0, 1, 0, 0]) : q;
}

/** Returns the angle of the rotation between two attitudes, rad, 0 to π. @param {Quat} p @param {Quat} q */
export function angleBetween(p, q) {
  const [w, x, y, z] = product(conjugate(p), q);
  return 2 * Math.atan2(Math.hypot(x, y, z), Math.abs(w));
}

/** Returns yaw, pitch and roll, rad. @param {Quat} q @returns {Vec} */
export function angles(q) {
  const [x, y] = [rotate(q, [1, 0, 0]), rotate(q, [0, 1, 0])];
  const z = rotate(q, [0, 0, 1]);
  return [Math.atan2(-y[0], y[1]), Math.atan2(y[2], Math.hypot(x[2], z[2])), Math.atan2(-x[2], z[2])];
}

/** Conversions of an attitude to the output frames, named as in `[output]` of the launch file. The results are quaternions w x y z.
 * @type {Record<string, (q: Quat) => Quat>} */
export const FRAMES = {
  "enu-rfu": (q) => q,
  "enu-flu": ([w, x, y, z]) => [(w - z) * Math.SQRT1_2, (x + y) * Math.SQRT1_2, (y - x) * Math.SQRT1_2, (z + w) * Math.SQRT1_2],
  "nwu-flu": ([w, x, y, z]) => [w, y, -x, z],
  "ned-frd": ([w, x, y, z]) => [w, y, x, -z],
};
