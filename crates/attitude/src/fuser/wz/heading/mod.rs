//! Heading by the magnetic field, beside a level that the field does not touch.
//!
//! Input: the attitude with the gyro's own heading, the rate, the field where there is a sample. Output: the angle a by which the
//! attitude is to be turned about the vertical, counted from magnetic north, with its standard deviation. Time: the ticks'
//! intervals. Failure: without a field, or with one that nothing explains, a stays and the heading is the gyro's.
//!
//! In the frame of the gyro's heading north stands still, up to a slow drift, so that the field is a linear measurement of what is
//! unknown: the field of the place e, the drift β, the delay of the magnetometer τ, the hard iron b, what the place adds d, the error
//! of the gyro's scale κ, the field p where it rested before (see `filter`). a = atan2(e_ξ, e_η).
//!
//! | file | what it does |
//! | --- | --- |
//! | `levelled` | means of the field in the reference frame, with the attitude of a delay ago |
//! | `filter` | one Kalman filter: the equations |
//! | `vibration` | whether the body vibrates |
//! | `place` | whether it rests where it rested before |
//! | `hypothesis_test` | three of them, for the same field: nothing new, a magnet on the body, a new field |
//!
//! Why so. The delay matters: 13 ms at 7 rad/s are 5° of a field. A gate alone, by strength and dip or by the innovation, keeps
//! passing magnets out and then stays for ever outside a magnet that was put on the body; at a dip of 70° a microtesla is 4° of
//! heading. A hard iron left open always takes the slopes of the field for iron: where a body hardly turns, b and e cannot be told
//! apart, and degrees are lost. So b is opened only where a likelihood, held against that of a new field, demands it.

mod filter;
mod hypothesis_test;
mod input;
mod levelled;
mod place;
mod vibration;

pub(super) use input::HeadingInput;

use core::f64::consts::PI;

use crate::{
    Vector3,
    course::Reference,
    fuser::{
        estimate::Estimate,
        hard_iron::HardIron,
        wz::{ease, settings::Settings},
    },
    numbers::Numbers,
    state::{Attitude, wrapped_rad},
};
use {
    filter::{BETA, DRIFT_SD_RAD_S, Filter, Propagation, TAU},
    hypothesis_test::HypothesisTest,
    levelled::{Interval, Levelled},
    place::{KnownPlace, Seen},
};

/// Fields that a magnetometer on earth may read, µT; others are no sample.
const READING_MIN_UT: f64 = 1.0;
const READING_MAX_UT: f64 = 500.0;
/// Noise of a magnetometer over 20 ms, µT.
const NOISE_UT: f64 = 0.46;
/// What a rate adds to it, as a part of the field, s: half a millisecond by which samples and attitude do not fit.
const NOISE_BY_RATE_S: f64 = 4.5e-4;
/// The tilt where a body begins in motion, rad, and how fast that settles, s.
const SETTLING_RAD: f64 = 0.3;
const SETTLING_S: f64 = 3.0;
/// A tilt that is settled, rad.
const SETTLED_RAD: f64 = 4e-4;
/// A slower turn is no beginning in motion, rad/s.
const STILL_RAD_S: f64 = 0.1;
/// Standard deviation of a heading that says nothing, rad.
const LOST_RAD: f64 = 1.0;
/// A rate that a body may have while nobody measures it, rad/s: a hand that turns it over.
const UNKNOWN_RATE_RAD_S: f64 = 3.0;
/// An unknown turn beyond which the field is no longer linear in it, rad; its direction is open then.
const LINEAR_RAD: f64 = 0.3;
/// A heading that is found so far from where it was jumps there, rad: 1°.
const JUMP_RAD: f64 = 0.017_453_293;

/// What a tick did to the heading.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct News {
    /// A field was used.
    pub(super) magnetic: bool,
    /// The heading jumps here.
    pub(super) aligned: bool,
}

/// The heading.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Heading {
    levelled: Levelled,
    hypothesis_test: HypothesisTest,
    known_place: KnownPlace,
    /// In the last interval.
    was_at_rest: bool,
    /// A field was seen.
    begun: bool,
    /// The heading was known once: what another stage or the field said of it was more than nothing.
    found: bool,
    rested: bool,
    disturbed: bool,
    /// What the tilt may still be off after a start in motion, rad.
    settling_rad: f64,
    turn_rad: f64,
    /// What of the turn is not yet in the attitude, rad.
    left_rad: f64,
    sd_rad: f64,
    /// Of the gyro's heading before the first field, rad/s.
    drift_sd_rad_s: f64,
    /// The reference of a heading that another stage found.
    magnetic: bool,
    by_track: bool,
}

impl Default for Heading {
    fn default() -> Self {
        Self::of(&Settings::default(), &Estimate::UNKNOWN)
    }
}

impl Heading {
    /// Goes on from a heading that is already in the attitude, with the giver's bias and hard iron.
    pub(super) fn of(settings: &Settings, common: &Estimate) -> Self {
        let Estimate { reference, heading_sd_rad, bias_sd_rad_s, hard_iron, .. } = *common;
        let mut main = Filter::begun(settings);
        main.know(hard_iron);
        Self {
            levelled: Levelled::default(),
            hypothesis_test: HypothesisTest::of(main),
            known_place: KnownPlace::default(),
            was_at_rest: false,
            begun: false,
            found: reference == Reference::Magnetic && heading_sd_rad < LOST_RAD,
            rested: false,
            disturbed: false,
            settling_rad: 0.0,
            turn_rad: 0.0,
            left_rad: 0.0,
            sd_rad: heading_sd_rad.min(PI),
            drift_sd_rad_s: bias_sd_rad_s.min(DRIFT_SD_RAD_S),
            magnetic: reference == Reference::Magnetic,
            by_track: reference == Reference::True,
        }
    }

    /// The attitude with the heading that the field gave it.
    #[inline]
    pub(super) fn with_heading(&self, attitude: Attitude) -> Attitude {
        if !self.begun {
            return attitude;
        }
        Attitude { z_rad: wrapped_rad(attitude.z_rad + self.turn_rad - self.left_rad), ..attitude }
    }

    /// Standard deviation of the heading, rad.
    pub(super) fn sd_rad(&self) -> f64 {
        self.sd_rad
    }

    /// What the heading is counted from.
    pub(super) fn reference(&self) -> Reference {
        match (self.begun || self.magnetic, self.by_track) {
            (true, _) => Reference::Magnetic,
            (_, true) => Reference::True,
            _ => Reference::Arbitrary,
        }
    }

    /// The last field was not that of the place.
    pub(super) fn disturbed(&self) -> bool {
        self.disturbed
    }

    /// Hard iron; where it is taken to be none it is not estimated.
    pub(super) fn hard_iron(&self) -> HardIron {
        self.hypothesis_test.main.hard_iron()
    }

    /// How late the magnetometer is on the gyro, s.
    pub(super) fn delay_s(&self) -> f64 {
        self.hypothesis_test.main.x[TAU]
    }

    /// The level was lost, and with it the gyro's heading.
    pub(super) fn realign(&mut self) {
        self.levelled = Levelled::default();
        // Before the first field there is no north to lose.
        if self.begun {
            self.lose();
            self.publish();
        }
    }

    /// The body may face anywhere, on a level that has to settle.
    fn lose(&mut self) {
        self.hypothesis_test.lose_direction();
        self.known_place = KnownPlace::default();
        self.settling_rad = SETTLING_RAD;
    }

    /// The body has turned while nobody looked. What the interval's field says is of use where all of it was like that: else it is
    /// the mean of two directions.
    fn turned_unseen(&mut self, interval: &Interval) -> bool {
        let turned_rad = UNKNOWN_RATE_RAD_S * interval.gyro_outage_s;
        if turned_rad <= LINEAR_RAD {
            self.hypothesis_test.loosen(turned_rad * turned_rad);
            return true;
        }
        self.lose();
        interval.gyro_outage_s >= interval.duration_s
    }

    /// One tick.
    #[inline]
    pub(super) fn step(&mut self, input: &HeadingInput, settings: &Settings) -> News {
        let readable = |field: &Vector3<f64>| {
            (READING_MIN_UT * READING_MIN_UT..READING_MAX_UT * READING_MAX_UT).contains(&field.norm_squared())
        };
        let field_ut = input.field_ut.filter(readable);
        if input.gyro_outage_s > 0.0 {
            self.sd_rad = libm::hypot(self.sd_rad, UNKNOWN_RATE_RAD_S * input.gyro_outage_s).min(PI);
        }
        if !self.begun && field_ut.is_none() && self.levelled.is_empty() {
            return News::default();
        }
        self.left_rad -= self.left_rad * ease::share(self.left_rad * self.left_rad, input.dt_s);
        match self.levelled.step(input, field_ut, self.hypothesis_test.main.x[TAU], !self.begun) {
            Some(interval) => self.update(&interval, settings),
            None => News::default(),
        }
    }

    #[inline(never)]
    fn update(&mut self, interval: &Interval, settings: &Settings) -> News {
        if interval.at_rest && !self.rested {
            self.rested = true;
            self.hypothesis_test.rested();
        }
        let elsewhere = core::mem::replace(&mut self.was_at_rest, interval.at_rest) != interval.at_rest;
        if elsewhere {
            self.known_place.leave();
        }
        let usable = interval.gyro_outage_s == 0.0 || self.turned_unseen(interval);
        if interval.windows == 0.0 || !usable {
            if !self.begun {
                return News::default();
            }
            self.hypothesis_test.pass(&Propagation::of(interval, elsewhere));
            return News { magnetic: false, aligned: self.publish() };
        }
        let [x, y, z] = interval.field_ut;
        let strength_ut = libm::sqrt(x * x + y * y + z * z);
        let first = !self.begun;
        if first {
            let still = interval.at_rest || interval.turning_rad_s < STILL_RAD_S;
            self.settling_rad = if still { 0.0 } else { SETTLING_RAD };
        }
        let unfit_ut = NOISE_BY_RATE_S * strength_ut * interval.turning_rad_s;
        let settling_ut = self.settling_rad * strength_ut;
        let variance_ut2 = NOISE_UT * NOISE_UT / interval.windows + unfit_ut * unfit_ut + settling_ut * settling_ut;
        if self.settling_rad > 0.0 {
            self.settling_rad *= libm::exp(-interval.duration_s / SETTLING_S);
            self.settling_rad = if self.settling_rad < SETTLED_RAD { 0.0 } else { self.settling_rad };
        }
        if first {
            return self.begin(interval, settings, variance_ut2);
        }
        self.hypothesis_test.pass(&Propagation::of(interval, elsewhere));
        let outcome = self.hypothesis_test.judge(interval, settings, variance_ut2);
        self.disturbed = !(outcome.accepted || outcome.replaced);
        if outcome.replaced {
            self.known_place = KnownPlace::default();
        } else if outcome.accepted && interval.at_rest {
            self.rests(interval);
        }
        News { magnetic: !self.disturbed, aligned: self.publish() }
    }

    /// An interval at rest: where the body rested before, that tells how far the gyro has drifted.
    fn rests(&mut self, interval: &Interval) {
        let field_ut = self.hypothesis_test.main.without_hard_iron(interval);
        match self.known_place.observe(field_ut, interval.axes[2]) {
            Seen::Nothing => {}
            Seen::Again if self.hypothesis_test.is_place() => {}
            Seen::Again | Seen::Place => self.hypothesis_test.know_place(),
        }
    }

    /// The first field: from a heading that is known to be magnetic it need not jump.
    fn begin(&mut self, interval: &Interval, settings: &Settings, variance_ut2: f64) -> News {
        let mut main = Filter::begun(settings);
        if self.found && self.sd_rad < LOST_RAD {
            main.face_north(interval.field_ut, self.sd_rad);
        }
        main.reset(BETA, self.drift_sd_rad_s);
        main.know(self.hard_iron());
        self.hypothesis_test = HypothesisTest::of(main);
        if self.rested {
            self.hypothesis_test.rested();
        }
        self.hypothesis_test.begin(interval, settings.magnetometer_delay_s, variance_ut2);
        self.begun = true;
        let aligned = self.publish();
        News { magnetic: true, aligned }
    }

    /// The attitude is to face where the field says. A heading that was known is left to the gyro where the field does not tell it; before,
    /// the field's is the better one, however little it says. The heading jumps.
    fn publish(&mut self) -> bool {
        let (turn_rad, variance_rad2) = self.hypothesis_test.main.turn_rad();
        self.sd_rad = libm::sqrt(variance_rad2).min(PI);
        if self.sd_rad >= LOST_RAD && self.found {
            return false;
        }
        self.found |= self.sd_rad < LOST_RAD;
        self.left_rad = wrapped_rad(self.left_rad + turn_rad - self.turn_rad);
        self.turn_rad = turn_rad;
        let jumps = libm::fabs(self.left_rad) > JUMP_RAD;
        self.left_rad = if jumps { 0.0 } else { self.left_rad };
        jumps
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let Self { settling_rad, turn_rad, left_rad, sd_rad, drift_sd_rad_s, .. } = self;
        let bounds = (0.0..=PI).contains(sd_rad) && libm::fabs(*turn_rad) <= PI && libm::fabs(*left_rad) <= PI;
        let bounds = bounds && *settling_rad >= 0.0 && *drift_sd_rad_s >= 0.0;
        self.levelled
            .flaw()
            .or_else(|| self.known_place.flaw())
            .or((!bounds).then_some("a heading that is no angle"))
            .or_else(|| self.hypothesis_test.flaw())
    }
}

impl Numbers for Heading {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.levelled.visit(visit);
        self.hypothesis_test.visit(visit);
        self.known_place.visit(visit);
        let Self { was_at_rest, begun, found, rested, disturbed, magnetic, by_track, .. } = self;
        [was_at_rest, begun, found, rested, disturbed, magnetic, by_track]
            .into_iter()
            .for_each(|flag| flag.visit(visit));
        let Self { settling_rad, turn_rad, left_rad, sd_rad, drift_sd_rad_s, .. } = self;
        [settling_rad, turn_rad, left_rad, sd_rad, drift_sd_rad_s].into_iter().for_each(visit);
    }
}
