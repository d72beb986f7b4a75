//! Drawings of S4: axes, platform and the three block diagrams.

use crate::picture::drawings;

drawings! {
    "s4":
    axes = "figure-1-2",
        "Figures 1 and 2: axes, and misalignment of the platform",
        "The platform is a horizontal frame with free azimuth. Levelling rotates it at the rate ω_c until its tilt is removed. Here it is the reference frame of (w, z), and C = Aᵀ.";

    aided = "figure-3",
        "Figure 3: block diagram with GNSS correction",
        "(3), (4): the platform is levelled by the force minus the vehicle's acceleration, which is derived from GNSS. K g is the inverse of the time constant. Stage levelling while fixes are available, and P1 of levelling-unified.";

    autonomous = "figure-5",
        "Figure 5: block diagram without GNSS",
        "The low-pass filtered force replaces the force without the vehicle's acceleration. Time constants here: low-pass 20 s, levelling 60 s.";

    unified = "figure-7",
        "Figure 7: block diagram of the unified scheme",
        "Stage levelling-unified. HΓ starts at an arbitrary direction of its platform. The offset is recomputed at each change of k, so the course is continuous. Roll and pitch jump by the difference between the platforms, which is flagged as `aligned`.";
}
