//! Fuser stages: motion, inclination and, where they are there, the magnetic field and a velocity become one attitude.
//!
//! Input: what the slot is offered at a tick, any part of which may be missing. Output: the fused attitude with the bias of the
//! gyro, the innovation and standard deviations. Time: the motion's interval. Failure: without a motion the attitude is held,
//! without an inclination it follows the gyro; what is not a finite number is missing.
//!
//! | stage | what it is |
//! | --- | --- |
//! | [`wz`](wz::Wz) | levelled low-pass of second order, Möbius correction, gyro bias; heading by the magnetic field |
//! | [`wz-closed`](wz_closed::WzClosed) | w_c' = f(w_c, ω) + (w_acc − w_c)/T |
//! | [`wz-open`](wz_open::WzOpen) | HPF(w_gyro) + LPF(w_acc) as published |
//! | [`madgwick`](madgwick::Madgwick), `madgwick-improved` | gradient descent on the quaternion, normalised or not |
//! | [`levelling`](levelling::Levelling) | a platform levelled by the specific force less the motion a receiver tells |
//! | [`levelling-pi`](levelling::LevellingPi) | the same by matched increments of velocity, with the gyro's bias |
//! | [`aided`](aided::Aided) | error-state filter with satellite velocity |
//! | [`vqf`](vqf::Vqf) | VQF, the yardstick |

pub mod aided;
mod carried;
mod compass;
mod finite;
mod hard_iron;
pub mod levelling;
pub mod madgwick;
mod rest;
mod spread;
pub mod vqf;
pub mod wz;
pub mod wz_closed;
pub mod wz_open;

pub use hard_iron::HardIron;

use core::f64::consts::PI;

use crate::{
    Complex, Vector3,
    accel::Inclination,
    course::Reference,
    gnss::Fix,
    gyro::Motion,
    parameters::{Parameter, ParameterError},
    point::{Chart, Point},
    stage::{RestoreError, Stage, bias_flaw},
    state::{Attitude, arg},
};
use {
    aided::Aided,
    levelling::{Levelling, LevellingPi},
    madgwick::Madgwick,
    vqf::Vqf,
    wz::Wz,
    wz_closed::WzClosed,
    wz_open::WzOpen,
};

/// Random walk of a gyro's bias, rad/s/√s: 1 °/s in half a day, 0.1 °/s while a consumer MEMS gyro warms up for an hour.
pub const BIAS_WALK_RAD_S: f64 = 3e-5;
/// Below this a field has no direction, µT: a thousandth of the earth's.
const FIELD_MIN_UT: f64 = 0.05;

/// What a fuser is offered at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FuserInput {
    /// From the gyro slot.
    pub motion: Option<Motion>,
    /// From the accel slot; only one made from a force that can be used.
    pub inclination: Option<Inclination>,
    /// The magnetic field, µT, body axes; only where it is a new sample.
    pub field_ut: Option<Vector3<f64>>,
    /// Of the satellite receiver; only at the tick at which it arrived.
    pub fix: Option<Fix>,
    /// Gyro and accelerometer are alive, so that stillness means rest.
    pub rest_credible: bool,
    /// The motion is what the body did: its rate is neither missing nor stuck nor at the end of the gyro's range.
    pub rate_credible: bool,
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
    /// Standard deviation of the heading, rad; π where nothing is known.
    pub heading_sd_rad: f64,
    /// What the heading is counted from.
    pub reference: Reference,
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
    /// The heading moved towards the magnetic field's.
    pub magnetic: bool,
    /// A satellite velocity was used.
    pub velocity: bool,
    /// The magnetic field is not that of the place; heading follows the gyro.
    pub disturbed: bool,
    /// The body was found to be at rest.
    pub rest: bool,
    /// The attitude was set anew: its level, its heading or both jump here.
    pub aligned: bool,
}

/// What every fuser can hand over to every other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The attitude.
    pub attitude: Attitude,
    /// What its heading is counted from.
    pub reference: Reference,
    /// Gyro bias, rad/s, body axes; that of an earlier giver where this one does not estimate it.
    pub bias_rad_s: Vector3<f64>,
    /// Standard deviation of the inclination, rad.
    pub inclination_sd_rad: f64,
    /// Standard deviation of the heading, rad; π where nothing is known.
    pub heading_sd_rad: f64,
    /// Standard deviation of each component of the bias, rad/s; infinite where nobody estimated it.
    pub bias_sd_rad_s: f64,
    /// Hard iron of the magnetometer; that of an earlier giver where this one does not estimate it.
    pub hard_iron: HardIron,
}

impl Estimate {
    /// Nothing is known: the body may be anywhere, the sensors may be anything.
    pub const UNKNOWN: Self = Self {
        attitude: Attitude { up: Point { w: Complex::new(0.0, 0.0), chart: Chart::Upright }, z_rad: 0.0 },
        reference: Reference::Arbitrary,
        bias_rad_s: Vector3::new(0.0, 0.0, 0.0),
        inclination_sd_rad: PI,
        heading_sd_rad: PI,
        bias_sd_rad_s: f64::INFINITY,
        hard_iron: HardIron::UNKNOWN,
    };

    /// Refuses what is not an estimate.
    pub fn checked(&self) -> Result<(), RestoreError> {
        self.attitude.checked()?;
        if let Some(index) = self.bias_rad_s.iter().position(|x| !x.is_finite()) {
            return Err(RestoreError::NotFinite { index });
        }
        if let Some(flaw) = bias_flaw(self.bias_rad_s) {
            return Err(RestoreError::Flaw { flaw });
        }
        let sds = [self.inclination_sd_rad, self.heading_sd_rad, self.bias_sd_rad_s];
        if !sds.iter().all(|sd| *sd >= 0.0) {
            return Err(RestoreError::Flaw { flaw: "a standard deviation below zero" });
        }
        self.hard_iron.flaw().map_or(Ok(()), |flaw| Err(RestoreError::Flaw { flaw }))
    }
}

macro_rules! fusers {
    ($($name:literal => $Variant:ident($Stage:ty) = $new:expr,)*) => {
        impl Fuser {
            /// The stages of this slot; the first is the default.
            pub const NAMES: [&'static str; [$($name),*].len()] = [$($name),*];

            /// The stage of that name.
            pub fn named(name: &str) -> Option<Self> {
                match name {
                    $($name => Some(Self::$Variant($new)),)*
                    _ => None,
                }
            }
        }
    };
}

fusers! {
    "wz" => Wz(Wz) = Wz::default(),
    "wz-closed" => WzClosed(WzClosed) = WzClosed::default(),
    "wz-open" => WzOpen(WzOpen) = WzOpen::default(),
    "madgwick" => Madgwick(Madgwick) = Madgwick::original(),
    "madgwick-improved" => Madgwick(Madgwick) = Madgwick::improved(),
    "levelling" => Levelling(Levelling) = Levelling::default(),
    "levelling-pi" => LevellingPi(LevellingPi) = LevellingPi::default(),
    "aided" => Aided(Aided) = Aided::default(),
    "vqf" => Vqf(Vqf) = Vqf::default(),
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
    /// `madgwick`, `madgwick-improved`
    Madgwick(Madgwick),
    /// `levelling`
    Levelling(Levelling),
    /// `levelling-pi`
    LevellingPi(LevellingPi),
    /// `aided`
    Aided(Aided),
    /// `vqf`
    Vqf(Vqf),
}

macro_rules! each {
    ($fuser:expr, $stage:ident => $do:expr) => {
        match $fuser {
            Fuser::Wz($stage) => $do,
            Fuser::WzClosed($stage) => $do,
            Fuser::WzOpen($stage) => $do,
            Fuser::Madgwick($stage) => $do,
            Fuser::Levelling($stage) => $do,
            Fuser::LevellingPi($stage) => $do,
            Fuser::Aided($stage) => $do,
            Fuser::Vqf($stage) => $do,
        }
    };
}

/// A stage that the slot `fuser` takes.
pub trait FuserStage: Stage<Input = FuserInput, Output = Fused, Common = Estimate> + Clone {
    /// Sets the level anew by the next inclination, as after a gap in which the body may have turned anywhere; heading and gyro
    /// bias stay.
    fn realign(&mut self);

    /// Begins with what was known of the sensors before: bias and hard iron. The attitude is as unknown as at any beginning, whatever
    /// `known` says of it. What cannot be taken over leaves the stage as it was.
    fn begin_with(&mut self, known: &Estimate) -> Result<(), RestoreError> {
        let Estimate { bias_rad_s, bias_sd_rad_s, hard_iron, .. } = *known;
        self.adopt(&Estimate { bias_rad_s, bias_sd_rad_s, hard_iron, ..Estimate::UNKNOWN })?;
        self.realign();
        Ok(())
    }
}

impl FuserStage for Fuser {
    fn realign(&mut self) {
        each!(self, stage => stage.realign());
    }
}

impl Stage for Fuser {
    type Input = FuserInput;
    type Output = Fused;
    type Common = Estimate;

    fn name(&self) -> &'static str {
        each!(self, stage => stage.name())
    }

    fn parameters(&self) -> &'static [Parameter] {
        each!(self, stage => stage.parameters())
    }

    fn set(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        each!(self, stage => stage.set(name, value))
    }

    // What the other stages made stays in registers on its way here.
    #[inline(always)]
    fn step(&mut self, input: &FuserInput) -> Fused {
        each!(self, stage => stage.step(input))
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        each!(self, stage => stage.visit_state(visit));
    }

    fn flaw(&self) -> Option<&'static str> {
        each!(self, stage => stage.flaw())
    }

    fn common(&self) -> Estimate {
        each!(self, stage => stage.common())
    }

    fn adopt(&mut self, common: &Estimate) -> Result<(), RestoreError> {
        each!(self, stage => stage.adopt(common))
    }
}

/// Angle between the accelerometer's up and the attitude's, rad.
pub fn innovation_rad(inclination: &Inclination, attitude: Attitude) -> f64 {
    let up = inclination.up.direction();
    arg(Complex::new(up.dot(&attitude.up.direction()), libm::sqrt(attitude.horizontal(up).norm_sqr())))
}

/// By how much the heading of an attitude must grow for the field to point to η0, rad, (−π, π].
///
/// z_mag − z, z_mag = atan2(m'_ξ, m'_η) of the levelled field m' = A(w)ᵀ m, which is here turned by z too.
fn north_rad(attitude: Attitude, field: Vector3<f64>) -> f64 {
    let h = attitude.horizontal(field);
    let (sin, cos) = libm::sincos(attitude.z_rad);
    // Turned by z into the reference frame, whose η0 is north.
    arg(Complex::new(h.re * sin + h.im * cos, h.re * cos - h.im * sin))
}

/// The direction of a field that has one.
fn field_direction(field_ut: Vector3<f64>) -> Option<Vector3<f64>> {
    let norm_ut = field_ut.norm();
    (norm_ut > FIELD_MIN_UT && norm_ut.is_finite()).then(|| field_ut / norm_ut)
}

/// The gain of a first-order low-pass over one step, exact for an input that holds still: 1 − e^{−dt/T}.
fn low_pass_gain(dt_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s > 0.0 { -libm::expm1(-dt_s / time_constant_s) } else { 1.0 }
}
