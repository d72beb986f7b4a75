//! Drawings of S1: the two finite rotations, the stereographic projection and the block diagram of
//! the fusion.

use crate::picture::drawings;

drawings! {
    "s1":
    rotations = "figure-1-2",
        "Figures 1 and 2: the two finite rotations",
        "The attitude is reached by a rotation z about ζ0, followed by a rotation δ about an axis e in the horizontal plane: A = A(w) A(z), (1), (7), (15).";

    projection = "figure-3",
        "Figure 3: the tip of k'' on the unit sphere and its stereographic image w",
        "The ray from the pole −ζ' through the tip of k'' meets the plane at w: (11), (12).";

    fusion = "figure-9",
        "Figure 9: block diagram of the fusion",
        "T = 1 s. As published, the gyro channel integrates in open loop (stage wz-open of the fuser slot). With the loop closed, the exact step is applied to w_c itself (stage wz-closed).";
}
