//! Heading by the magnetic field.

mod filter;
mod levelled;

use crate::{Complex, Vector3, course::Reference, parameters::settings, stage::Numbers, state::Attitude};
use core::f64::consts::PI;
use filter::{B, BETA, E, Filter, TAU};
use levelled::{Interval, Levelled};

settings! {
    /// Settings of the heading.
    pub struct Settings {
        /// Standard deviation of the hard iron at the start; 0 where the magnetometer is calibrated.
        hard_iron_sd_ut: 0.0 in 0.0 .. 200.0, "µT";
        /// How late the magnetometer is on the gyro, where the estimate begins.
        delay_s: 0.0 in -0.01 .. 0.04, "s";
        /// Standard deviation of that; 0 where it is known.
        delay_sd_s: 0.01 in 0.0 .. 0.02, "s";
        /// t
        e_sd_ut: 60.0 in 0.0 .. 1e9, "";
        /// t
        d_sd_ut: 1.0 in 0.0 .. 1e9, "";
        /// t
        restart_b_ut: 15.0 in 0.0 .. 1e9, "";
        /// t
        beta0_rad_s: 0.01 in 0.0 .. 1e9, "";
        /// t
        beta1_rad_s: 5e-4 in 0.0 .. 1e9, "";
        /// t
        beta_walk: 1e-4 in 0.0 .. 1e9, "";
        /// t
        nu0: 0.02 in 0.0 .. 1e9, "";
        /// t
        nu1: 0.35 in 0.0 .. 1e9, "";
        /// t
        turn0: 5e-4 in 0.0 .. 1e9, "";
        /// t
        turn1: 5e-4 in 0.0 .. 1e9, "";
        /// t
        e_walk: 0.01 in 0.0 .. 1e9, "";
        /// t
        b_walk: 0.0 in 0.0 .. 1e9, "";
        /// t
        sd_ut: 0.65 in 0.0 .. 1e9, "";
        /// t
        sd_turning: 0.02 in 0.0 .. 1e9, "";
        /// t
        gate: 16.0 in 0.0 .. 1e9, "";
        /// t
        penalty: 1.0 in 0.0 .. 1e9, "";
        /// t
        margin: 150.0 in 0.0 .. 1e9, "";
        /// t
        challenge_ut: 15.0 in 0.0 .. 1e9, "";
        /// t
        renew_s: 60.0 in 0.0 .. 1e9, "";
        /// t
        restart_s: 60.0 in 0.0 .. 1e9, "";
        /// t
        young_s: 2.0 in 0.0 .. 1e9, "";
        /// t
        turning: 0.3 in 0.0 .. 1e9, "";
        /// t
        fail_s: 0.2 in 0.0 .. 1e9, "";
    }
}

/// What the heading sees at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sighting {
    /// The attitude, its heading that of the gyro alone.
    pub(super) attitude: Attitude,
    /// Body rate less the bias, rad/s.
    pub(super) rate_rad_s: Vector3<f64>,
    /// Horizontal part of the specific force, m/s².
    pub(super) force_m_s2: Complex<f64>,
    /// Magnetic field, µT, body axes.
    pub(super) field_ut: Option<Vector3<f64>>,
    /// The body rests.
    pub(super) at_rest: bool,
    /// Length of the tick's interval, s.
    pub(super) dt_s: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct News {
    pub(super) magnetic: bool,
    pub(super) aligned: bool,
}

#[derive(Debug, Clone, PartialEq)]
struct Challenger {
    filter: Filter,
    lead_of_main: f64,
    lead_of_other: f64,
    rejecting_s: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Heading {
    pub(super) settings: Settings,
    levelled: Levelled,
    main: Filter,
    body: Filter,
    place: Filter,
    begun: bool,
    rested: bool,
    settle: f64,
    over_main: f64,
    over_place: f64,
    failing_s: f64,
    challenge_s: f64,
    rejecting_s: f64,
    rejected: bool,
    accepted_s: f64,
    turn_rad: f64,
    sd_rad: f64,
}

impl Default for Heading {
    fn default() -> Self {
        let settings = Settings::default();
        let main = Filter::begun(&settings);
        Self {
            settings,
            levelled: Levelled::default(),
            body: main.clone(),
            place: main.clone(),
            main,
            begun: false,
            rested: false,
            settle: 0.0,
            over_main: 0.0,
            over_place: 0.0,
            failing_s: 0.0,
            challenge_s: 0.0,
            rejecting_s: 0.0,
            rejected: false,
            accepted_s: 0.0,
            turn_rad: 0.0,
            sd_rad: PI,
        }
    }
}

impl Heading {
    pub(super) fn turn_rad(&self) -> f64 {
        self.turn_rad
    }
    pub(super) fn sd_rad(&self) -> f64 {
        self.sd_rad
    }
    pub(super) fn reference(&self) -> Reference {
        if self.begun { Reference::Magnetic } else { Reference::Arbitrary }
    }
    pub(super) fn disturbed(&self) -> bool {
        self.rejected
    }
    pub(super) fn debug(&self) -> ([f64; 11], [f64; 6]) {
        (self.main.x, [self.over_main, self.over_place, self.rejecting_s, self.failing_s, self.challenge_s, self.sd_rad.to_degrees()])
    }

    pub(super) fn step(&mut self, sighting: &Sighting) -> News {
        let mut news = News::default();
        if !self.begun && sighting.field_ut.is_none() {
            return news;
        }
        let delay_s = self.main.x[TAU];
        if let Some(interval) = self.levelled.step(sighting, delay_s) {
            self.update(&interval, delay_s, &mut news);
        }
        news
    }

    fn renew(&mut self) {
        self.body = self.main.clone();
        self.body.open(B, self.settings.challenge_ut);
        self.place = self.main.clone();
        self.place.open(E, self.settings.challenge_ut);
        self.over_main = 0.0;
        self.over_place = 0.0;
        self.failing_s = 0.0;
        self.challenge_s = 0.0;
    }

    fn update(&mut self, interval: &Interval, delay_s: f64, news: &mut News) {
        let s = self.settings;
        let t = interval.duration_s;
        let turning = interval.turning_rad_s > s.turning;
        if interval.windows == 0.0 {
            for filter in [&mut self.main, &mut self.body, &mut self.place] {
                filter.predict(interval, &s);
            }
            return;
        }
        let norm = {
            let f = interval.field_ut;
            libm::sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
        };
        let first = !self.begun;
        if first {
            self.main = Filter::begun(&s);
            self.settle = if interval.turning_rad_s < 0.1 { 0.0 } else { 0.3 };
        }
        if interval.at_rest && !self.rested {
            self.rested = true;
            for filter in [&mut self.main, &mut self.body, &mut self.place] {
                filter.reset(BETA, s.beta1_rad_s);
            }
        }
        let mut noise = s.sd_ut * s.sd_ut / interval.windows + square(s.sd_turning * interval.turning_rad_s);
        if self.settle > 0.0 {
            noise += square(norm * self.settle);
            self.settle *= libm::exp(-t / 3.0);
            if self.settle < 4e-4 {
                self.settle = 0.0;
            }
        }
        if first {
            // At the start the challenger has field and hard iron open together.
            self.renew();
            self.main.measure(interval, delay_s, noise, f64::INFINITY);
            self.body.measure(interval, delay_s, noise, f64::INFINITY);
            self.place.measure(interval, delay_s, noise, f64::INFINITY);
            self.begun = true;
            news.aligned = true;
            news.magnetic = true;
            self.publish();
            return;
        }
        for filter in [&mut self.main, &mut self.body, &mut self.place] {
            filter.predict(interval, &s);
        }
        let main = self.main.measure(interval, delay_s, noise, s.gate);
        let body = self.body.measure(interval, delay_s, noise, s.gate);
        let place = self.place.measure(interval, delay_s, noise, s.gate);
        self.rejected = !main.accepted;
        news.magnetic = main.accepted;
        if turning {
            self.over_main = (self.over_main + main.cost - body.cost - s.penalty).max(0.0);
            self.over_place = (self.over_place + place.cost - body.cost - s.penalty).max(0.0);
        }
        let young = self.accepted_s < 10.0;
        let limit_s = if young { self.accepted_s.max(s.young_s) } else { s.restart_s };
        if main.accepted {
            self.accepted_s += t;
            self.rejecting_s = (self.rejecting_s - 2.0 * t).max(0.0);
        } else if turning || young {
            self.rejecting_s += t;
        }
        self.failing_s = if body.accepted { 0.0 } else { self.failing_s + t };
        self.challenge_s += t;
        if self.over_main > s.margin && self.over_place > s.margin {
            self.main = self.body.clone();
            self.renew();
            self.rejecting_s = 0.0;
            news.aligned = true;
        } else if self.failing_s > s.fail_s || self.challenge_s > s.renew_s {
            self.renew();
        } else if self.rejecting_s > limit_s {
            self.main.restart(&s, young);
            self.renew();
            self.rejecting_s = 0.0;
            self.accepted_s = 0.0;
            for filter in [&mut self.main, &mut self.body, &mut self.place] {
                filter.measure(interval, delay_s, noise, f64::INFINITY);
            }
            news.aligned = true;
        }
        self.publish();
    }

    fn publish(&mut self) {
        self.turn_rad = self.main.turn_rad();
        self.sd_rad = libm::sqrt(self.main.turn_variance_rad2()).min(PI);
    }

    pub(super) fn flaw(&self) -> Option<&'static str> {
        [&self.main, &self.body, &self.place].into_iter().find_map(|filter| filter.flaw())
    }
}

impl Numbers for Heading {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.levelled.visit(visit);
        for filter in [&mut self.main, &mut self.body, &mut self.place] {
            filter.visit(visit);
        }
        for flag in [&mut self.begun, &mut self.rested, &mut self.rejected] {
            flag.visit(visit);
        }
        for number in [
            &mut self.settle,
            &mut self.over_main,
            &mut self.over_place,
            &mut self.failing_s,
            &mut self.challenge_s,
            &mut self.rejecting_s,
            &mut self.accepted_s,
            &mut self.turn_rad,
            &mut self.sd_rad,
        ] {
            number.visit(visit);
        }
    }
}

fn square(x: f64) -> f64 {
    x * x
}
