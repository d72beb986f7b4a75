//! The state of the fuser stage `levelling-pi`, and the bounds of its bias.

use core::f64::consts::PI;

use super::{aiding::Aiding, heading::Heading, settings::PiSettings, still::Still};
use crate::{Complex, Vector3, fuser::carried::Carried, state::Attitude};

/// Standard deviation of a bias of which nothing is known, rad/s: 0.1 °/s.
pub(super) const BIAS_SD_RAD_S: f64 = 0.1 * PI / 180.0;
/// Standard deviation up to which the bias counts as known, rad/s.
pub(super) const BIAS_KNOWN_SD_RAD_S: f64 = 0.05 * PI / 180.0;
/// Largest component of the bias, rad/s: 5 °/s. A loop that asks for more is not following a bias.
pub(super) const BIAS_MAX_RAD_S: f64 = 5.0 * PI / 180.0;

/// The fuser stage `levelling-pi`.
///
/// | | tilt | bias |
/// | --- | --- | --- |
/// | fix | (∫ f_P dt − ΔV)/(g τ) over the interval between the moments at which the fixes were valid, τ = 20 s | its integral in body axes over 4 τ |
/// | track | azimuth by (H − H_track)/T, T = 50 s, 100 s after turns | about the vertical, over 4 T |
/// | acceleration | azimuth by the angle between ∫ f_P dt and ΔV, over 10 s of turning | about the vertical |
/// | gap | low-pass of f_P less V H' of the remembered speed, over 100 s, less in a turn | its integral over 4000 s |
/// | cold | low-pass of f_P over 60 s, as S4 | none |
/// | standstill | as in a gap | the mean rate |
///
/// An increment of velocity counts once; after a lost interval the next two fixes begin a new one. Two tracks that agree turn the
/// platform to north, which is a jump, and the heading is true from then on. A magnetic heading that is handed over is none here.
///
/// Without a receiver the integral would follow accelerations instead of the bias; it starts when fixes or a standstill have told
/// the bias. Until then the stage is S4's autonomous law.
#[derive(Debug, Clone, PartialEq)]
pub struct LevellingPi {
    pub(super) settings: PiSettings,
    pub(super) attitude: Attitude,
    pub(super) started: bool,
    /// Time since the last force, s.
    pub(super) unlevelled_s: f64,
    pub(super) bias_rad_s: Vector3<f64>,
    pub(super) bias_variance_rad2_s2: f64,
    /// H', averaged.
    pub(super) turn_rate_rad_s: f64,
    pub(super) aiding: Aiding,
    pub(super) heading: Heading,
    /// Tilt that is still to be taken away, platform, rad.
    pub(super) pending_rad: Complex<f64>,
    /// What is left of the force in a gap, low-passed, platform, m/s².
    pub(super) low_pass_m_s2: Complex<f64>,
    /// How much less than its time constant that has averaged, s.
    pub(super) unaveraged_s: f64,
    /// What levelling took for tilt, low-passed over its own time constant, platform, rad.
    pub(super) lag_rad: Complex<f64>,
    pub(super) still: Still,
    pub(super) carried: Carried,
}

impl Default for LevellingPi {
    fn default() -> Self {
        let none = Complex::new(0.0, 0.0);
        Self {
            settings: PiSettings::default(),
            attitude: Attitude::default(),
            started: false,
            unlevelled_s: 0.0,
            bias_rad_s: Vector3::zeros(),
            bias_variance_rad2_s2: BIAS_SD_RAD_S * BIAS_SD_RAD_S,
            turn_rate_rad_s: 0.0,
            aiding: Aiding::default(),
            heading: Heading::default(),
            pending_rad: none,
            low_pass_m_s2: none,
            unaveraged_s: 0.0,
            lag_rad: none,
            still: Still::default(),
            carried: Carried::default(),
        }
    }
}
