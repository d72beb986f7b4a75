//! Fuser stages: the gyro's motion and the accelerometer's inclination become one attitude.
//!
//! Input: the motion and the inclination of a tick, either of which may be missing. Output: the fused attitude with the bias of the
//! gyro, the innovation and its standard deviation. Time: the motion's interval. Failure: without a motion the attitude is held,
//! without an inclination it follows the gyro.
//!
//! | stage | what it is | inclination RMSE on S1's scenario, 100 s |
//! | --- | --- | --- |
//! | [`wz`](wz::Wz) | levelled low-pass of second order, Möbius correction, gyro bias | 0.06° |
//! | [`wz-closed`](wz_closed::WzClosed) | w_c' = f(w_c, ω) + (w_acc − w_c)/T | 0.16° |
//! | [`wz-open`](wz_open::WzOpen) | HPF(w_gyro) + LPF(w_acc) as published | 0.21° |

pub mod wz;
pub mod wz_closed;
pub mod wz_open;

use crate::{
    Complex, Vector3,
    accel::Inclination,
    gyro::Motion,
    stage::Stage,
    state::{Attitude, arg},
};
use {wz::Wz, wz_closed::WzClosed, wz_open::WzOpen};

/// What a fuser is offered at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FuserInput {
    /// From the gyro slot.
    pub motion: Option<Motion>,
    /// From the accel slot; only one made from a force that can be used.
    pub inclination: Option<Inclination>,
    /// Both sensors are alive, so that stillness means rest.
    pub rest_credible: bool,
}

/// What a fuser knows after a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fused {
    /// The attitude.
    pub attitude: Attitude,
    /// Body rate less the bias, rad/s.
    pub rate_rad_s: Vector3<f64>,
    /// Gyro bias, rad/s, body axes; zero where the stage does not estimate it.
    pub bias_rad_s: Vector3<f64>,
    /// Angle between the accelerometer's up and the attitude's, rad; 0 without an inclination.
    pub innovation_rad: f64,
    /// Standard deviation of the inclination, rad, as far as the stage's own innovations tell it.
    pub inclination_sd_rad: f64,
    /// Which corrections were used.
    pub corrections: Corrections,
}

/// Which corrections a step used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Corrections {
    /// The tilt moved towards the accelerometer's.
    pub tilt: bool,
    /// The gyro bias was updated.
    pub bias: bool,
    /// The body was found to be at rest.
    pub rest: bool,
    /// The attitude was set anew.
    pub aligned: bool,
}

/// A fuser stage.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "one value per process, held by value because the crate has no allocator")]
pub enum Fuser {
    /// `wz`
    Wz(Wz),
    /// `wz-closed`
    WzClosed(WzClosed),
    /// `wz-open`
    WzOpen(WzOpen),
}

impl Fuser {
    /// The stages of this slot; the first is the default.
    pub const NAMES: [&'static str; 3] = ["wz", "wz-closed", "wz-open"];

    /// The stage of that name.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "wz" => Some(Self::Wz(Wz::default())),
            "wz-closed" => Some(Self::WzClosed(WzClosed::default())),
            "wz-open" => Some(Self::WzOpen(WzOpen::default())),
            _ => None,
        }
    }

    /// Sets the level anew by the next inclination, as after a gap in which the body may have turned anywhere; heading and gyro
    /// bias stay.
    pub fn realign(&mut self) {
        match self {
            Self::Wz(stage) => stage.realign(),
            Self::WzClosed(stage) => stage.realign(),
            Self::WzOpen(stage) => stage.realign(),
        }
    }
}

impl Stage for Fuser {
    type Input = FuserInput;
    type Output = Fused;

    fn name(&self) -> &'static str {
        match self {
            Self::Wz(stage) => stage.name(),
            Self::WzClosed(stage) => stage.name(),
            Self::WzOpen(stage) => stage.name(),
        }
    }

    fn step(&mut self, input: &FuserInput) -> Fused {
        match self {
            Self::Wz(stage) => stage.step(input),
            Self::WzClosed(stage) => stage.step(input),
            Self::WzOpen(stage) => stage.step(input),
        }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        match self {
            Self::Wz(stage) => stage.visit_state(visit),
            Self::WzClosed(stage) => stage.visit_state(visit),
            Self::WzOpen(stage) => stage.visit_state(visit),
        }
    }
}

/// Angle between the accelerometer's up and the attitude's, rad.
pub fn innovation_rad(inclination: &Inclination, attitude: Attitude) -> f64 {
    let up = inclination.up.direction();
    arg(Complex::new(up.dot(&attitude.up.direction()), libm::sqrt(attitude.horizontal(up).norm_sqr())))
}

/// The gain of a first-order low-pass over one step, exact for an input that holds still: 1 − e^{−dt/T}.
fn low_pass_gain(dt_s: f64, time_constant_s: f64) -> f64 {
    -libm::expm1(-dt_s / time_constant_s)
}
