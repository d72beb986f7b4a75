//! State of the fuser stage `levelling-pi`, and the bounds of its bias.

use core::f64::consts::PI;

use super::{aiding::Aiding, heading::Heading, settings::PiSettings, standstill::StandstillDetector};
use crate::{Complex, Vector3, fuser::bias_handover::HandedOverBias, state::Attitude};

/// Standard deviation of an unknown bias, rad/s (0.1 °/s).
pub(super) const UNKNOWN_BIAS_SD_RAD_S: f64 = 0.1 * PI / 180.0;
/// Standard deviation below which the bias counts as known, rad/s.
pub(super) const KNOWN_BIAS_SD_RAD_S: f64 = 0.05 * PI / 180.0;
/// Largest component of the bias, rad/s (5 °/s). A larger estimate does not come from a gyro bias.
pub(super) const MAX_BIAS_RAD_S: f64 = 5.0 * PI / 180.0;

/// Fuser stage `levelling-pi`.
///
/// | input | correction of tilt or azimuth | correction of the bias |
/// | --- | --- | --- |
/// | fix | (∫ f_P dt − ΔV)/(g τ) over the interval between the validity times of the fixes, τ = 20 s | this correction in body axes, divided by 4 τ |
/// | track | azimuth by (H − H_track)/T, T = 50 s, or 100 s after turns | about the vertical: this correction divided by 4 T |
/// | acceleration | azimuth by the angle between ∫ f_P dt and ΔV, with a time constant of 10 s of turning | about the vertical |
/// | gap | low-pass filtered f_P minus V H' of the last speed, with a time constant of 100 s and less weight in a turn | this correction divided by 4000 s |
/// | cold start | low-pass filtered f_P with a time constant of 60 s, as in S4 | unchanged |
/// | standstill | as in a gap | the mean rate |
///
/// Here f_P is the force in platform axes, ΔV the velocity change between the fixes, V the speed, H
/// the course, H' the turn rate and H_track the track.
///
/// Each velocity increment is used once. After an interruption of the force, or a gap between
/// fixes, the next increment lies between the two fixes that follow. The first two tracks that
/// agree rotate the platform to north, so the heading jumps and from then on refers to true north.
/// A handed-over magnetic heading is not used.
///
/// The bias is integrated only once fixes or a standstill have determined it. Before that, the
/// integral would follow accelerations instead of the bias, so the stage uses S4's autonomous law.
#[derive(Debug, Clone, PartialEq)]
pub struct LevellingPi {
    pub(super) settings: PiSettings,
    pub(super) attitude: Attitude,
    pub(super) started: bool,
    /// Time since the last force, s.
    pub(super) since_force_s: f64,
    pub(super) bias_rad_s: Vector3<f64>,
    pub(super) bias_variance_rad2_s2: f64,
    /// Averaged clockwise turn rate H', rad/s.
    pub(super) turn_rate_rad_s: f64,
    pub(super) aiding: Aiding,
    pub(super) heading: Heading,
    /// Tilt correction that has not been applied yet, in platform axes, rad.
    pub(super) pending_rad: Complex<f64>,
    /// Low-pass filtered force minus V H' in platform axes without fixes, m/s².
    pub(super) low_pass_m_s2: Complex<f64>,
    /// Time for which the low-pass filter of `low_pass_m_s2` still computes a plain mean, s. After
    /// that, the filter uses its time constant.
    pub(super) averaging_deficit_s: f64,
    /// Tilt measured by levelling, in platform axes, low-pass filtered over the levelling time
    /// constant, rad.
    pub(super) lag_rad: Complex<f64>,
    pub(super) standstill: StandstillDetector,
    pub(super) bias_handover: HandedOverBias,
}

impl Default for LevellingPi {
    fn default() -> Self {
        let zero = Complex::new(0.0, 0.0);
        Self {
            settings: PiSettings::default(),
            attitude: Attitude::default(),
            started: false,
            since_force_s: 0.0,
            bias_rad_s: Vector3::zeros(),
            bias_variance_rad2_s2: UNKNOWN_BIAS_SD_RAD_S * UNKNOWN_BIAS_SD_RAD_S,
            turn_rate_rad_s: 0.0,
            aiding: Aiding::default(),
            heading: Heading::default(),
            pending_rad: zero,
            low_pass_m_s2: zero,
            averaging_deficit_s: 0.0,
            lag_rad: zero,
            standstill: StandstillDetector::default(),
            bias_handover: HandedOverBias::default(),
        }
    }
}
