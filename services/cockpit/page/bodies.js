// Bodies that the scene can show, as triangles in body axes: x right, y forward, z up.

/** @typedef {import("./attitude.js").Vec} Vec */
/** @typedef {[Vec, Vec, Vec]} Triangle */

/** Returns the triangles of a flat convex outline. @param {...Vec} corners @returns {Triangle[]} */
const face = (...corners) => corners.slice(2).map((corner, at) => [corners[0], corners[at + 1], corner]);

/** Returns triangles of the right side with their mirror images. @param {Triangle[]} right @returns {Triangle[]} */
const mirrored = (right) => right.flatMap((shape) => [shape, /** @type {Triangle} */ (shape.map(([x, y, z]) => /** @type {Vec} */ ([-x, y, z])))]);

/** Returns the triangles of a cuboid that is symmetric about x = 0. @param {number} x Half width @param {[number, number]} y @param {[number, number]} z */
const cuboid = (x, [y, front], [z, top]) => [
  ...mirrored(face([x, y, z], [x, front, z], [x, front, top], [x, y, top])),
  ...[y, front].flatMap((at) => face([-x, at, z], [x, at, z], [x, at, top], [-x, at, top])),
  ...[z, top].flatMap((at) => face([-x, y, at], [x, y, at], [x, front, at], [-x, front, at])),
];

/** Returns the triangles of a horizontal disc. @param {Vec} centre @param {number} radius */
const disc = ([x, y, z], radius) => face(...[...Array(12).keys()].map((at) => /** @type {Vec} */ ([x + radius * Math.cos((at * Math.PI) / 6), y + radius * Math.sin((at * Math.PI) / 6), z])));

/** Bodies by name. @type {Record<string, Triangle[]>} */
export const BODIES = {
  aeroplane: mirrored([
    [[0, 1.15, 0], [0.16, 0.35, 0.1], [0.16, 0.35, -0.06]], [[0, 1.15, 0], [0, 0.35, 0.1], [0.16, 0.35, 0.1]], [[0, 1.15, 0], [0.16, 0.35, -0.06], [0, 0.35, -0.06]],
    [[0.16, 0.35, 0.1], [0, 0.35, 0.1], [0, -0.95, 0.08]], [[0.16, 0.35, -0.06], [0, -0.95, 0.08], [0, 0.35, -0.06]], [[0.16, 0.35, -0.06], [0.16, 0.35, 0.1], [0, -0.95, 0.08]],
    [[0.12, 0.4, 0.02], [1.1, -0.15, 0.02], [0.1, -0.1, 0.02]], [[0, -0.6, 0.08], [0, -0.98, 0.42], [0, -0.98, 0.08]], [[0, -0.7, 0.08], [0.38, -0.98, 0.08], [0, -0.98, 0.08]],
  ]),
  multirotor: [
    ...cuboid(0.22, [-0.3, 0.3], [-0.1, 0.12]),
    ...mirrored([1, -1].flatMap((end) => [
      ...face([0.1, end * 0.18, 0.04], [0.18, end * 0.1, 0.04], [0.76, end * 0.68, 0.04], [0.68, end * 0.76, 0.04]),
      ...face([0.72, end * 0.68, 0.04], [0.72, end * 0.76, 0.04], [0.72, end * 0.76, 0.14], [0.72, end * 0.68, 0.14]),
      ...disc([0.72, end * 0.72, 0.14], 0.4),
    ])),
    // A cone marks the front.
    ...mirrored([[[0.16, 0.3, -0.08], [0, 0.3, 0.1], [0, 0.75, 0]], [[0.16, 0.3, -0.08], [0, 0.3, -0.08], [0, 0.75, 0]]]),
  ],
  boat: [
    ...mirrored([
      // Side, bottom, stern and deck of the hull.
      ...face([0.4, -1, 0.16], [0.42, 0.2, 0.18], [0.24, 0.15, -0.22], [0.26, -1, -0.2]), ...face([0.42, 0.2, 0.18], [0, 1.15, 0.28], [0, 0.85, -0.14], [0.24, 0.15, -0.22]),
      ...face([0.26, -1, -0.2], [0.24, 0.15, -0.22], [0, 0.85, -0.14], [0, -1, -0.3]), ...face([0.4, -1, 0.16], [0.26, -1, -0.2], [0, -1, -0.3], [0, -1, 0.16]),
      ...face([0.4, -1, 0.16], [0.42, 0.2, 0.18], [0, 1.15, 0.28], [0, -1, 0.16]),
    ]),
    ...cuboid(0.24, [-0.65, 0.1], [0.16, 0.5]),
    ...cuboid(0.02, [-0.5, -0.46], [0.5, 0.85]),
  ],
  box: [
    ...cuboid(0.5, [-0.7, 0.7], [-0.25, 0.25]),
    // A pyramid marks the front.
    ...mirrored([[[0.25, 0.7, -0.15], [0.25, 0.7, 0.15], [0, 1.1, 0]], [[0.25, 0.7, 0.15], [0, 0.7, 0.15], [0, 1.1, 0]], [[0.25, 0.7, -0.15], [0, 0.7, -0.15], [0, 1.1, 0]]]),
  ],
};
