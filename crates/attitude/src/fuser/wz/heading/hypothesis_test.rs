//! Three hypotheses about one field, and which of them gives the heading.
//!
//! | | hypothesis | beginning |
//! | --- | --- | --- |
//! | M | the hard iron is what it was | gives the heading |
//! | B | something was put on the body, or taken off | a copy of M with b open by 15 µT |
//! | E | the field of the place has changed | a copy of M with e open by 15 µT |
//!
//! M passes what fits by a gate, so a disturbance leaves its heading to the gyro. A step fixed to the body fits B and nothing else, a
//! new field fits E as well, and magnets that pass by fit nobody. Evidence is a sum of log-likelihood ratios while the body turns, for at
//! rest nothing tells the three apart. Each update gives away an allowance, since no hypothesis knows the soft iron and the
//! slope of the field, and B with more freedom explains a little of both; the sum does not fall below zero.
//! When B leads both by the margin, with a hard iron of its own and after a turn, it becomes M. What fails is begun anew from M, and so is what has not won in 50 s.

use super::{
    filter::{B, BETA, E, Filter, Propagation, TAU},
    levelled::Interval,
};
use crate::{fuser::wz::settings::Settings, numbers::Numbers};

/// By how much a challenger is opened, µT: a magnet at some centimetres, a loudspeaker in the same room.
const CHALLENGE_UT: f64 = 15.0;
/// Largest normalised square of an innovation that is believed; a chance of 1 %.
const GATE: f64 = 11.0;
/// The same, where a likelihood is counted: more would be one disturbance deciding all.
const NIS_MAX: f64 = 30.0;
/// Twice the log-likelihood ratio at which B wins.
const MARGIN: f64 = 85.0;
/// How far its hard iron is from that of M when it wins, at least, µT, and how far the body has turned since the challenge, rad.
const APART_UT: f64 = 3.0;
const TURNED_RAD: f64 = 2.0;
/// What each update gives away of it, 1/s.
const ALLOWANCE_PER_S: f64 = 5.5;
/// From this rate on the body turns, rad/s.
const TURNING_RAD_S: f64 = 0.3;
/// After so long outside the gate a challenger has failed, s; after so long without a win it is too old.
const FAILED_S: f64 = 0.2;
const CHALLENGE_S: f64 = 50.0;
/// After so long outside the gate, in turns, everything about the field begins anew, s.
const REJECTED_S: f64 = 60.0;
/// A hypothesis that was not right for so long is a beginner, s: it begins anew after as long outside the gate as inside, and at least
/// the shorter time.
const BEGINNER_S: f64 = 10.0;
const BEGINNER_REJECTED_S: f64 = 2.0;
/// The drift rate of the gyro's heading, once its bias was seen at rest, rad/s.
const DRIFT_SD_AT_REST_RAD_S: f64 = 6.5e-4;

/// What became of an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Outcome {
    /// M used it.
    pub(super) accepted: bool,
    /// M is another, or begun anew.
    pub(super) replaced: bool,
}

/// The hypotheses and the evidence.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct HypothesisTest {
    pub(super) main: Filter,
    body: Filter,
    place: Filter,
    /// Lead of B over M and over E.
    over_main: f64,
    over_place: f64,
    failing_s: f64,
    age_s: f64,
    turned_rad: f64,
    accepted_s: f64,
    rejected_s: f64,
    /// North was lost, and what was found since has not been outside the gate for long.
    lost: bool,
}

impl HypothesisTest {
    /// Begins with a hypothesis M that has seen nothing.
    pub(super) fn of(main: Filter) -> Self {
        let mut hypothesis_test = Self {
            main,
            body: main,
            place: main,
            over_main: 0.0,
            over_place: 0.0,
            failing_s: 0.0,
            age_s: 0.0,
            turned_rad: 0.0,
            accepted_s: 0.0,
            rejected_s: 0.0,
            lost: false,
        };
        hypothesis_test.challenge();
        hypothesis_test
    }

    /// The first interval, which all must believe. B has field and hard iron open together.
    pub(super) fn begin(&mut self, interval: &Interval, delay_s: f64, variance_ut2: f64) {
        self.each(|filter| {
            filter.measure(interval, delay_s, variance_ut2, f64::INFINITY);
        });
    }

    /// Time passes.
    pub(super) fn pass(&mut self, propagation: &Propagation) {
        self.each(|filter| filter.predict(propagation));
    }

    /// The gyro's heading may have turned by this variance more.
    pub(super) fn loosen(&mut self, variance_rad2: f64) {
        self.each(|filter| filter.turn_walk(variance_rad2));
    }

    /// North may be anywhere.
    pub(super) fn lose_direction(&mut self) {
        self.each(Filter::lose_direction);
        (self.accepted_s, self.rejected_s, self.lost) = (0.0, 0.0, true);
    }

    /// The gyro's bias was seen at rest for the first time: what had drifted before says nothing about what will.
    pub(super) fn rested(&mut self) {
        self.each(|filter| filter.reset(BETA, DRIFT_SD_AT_REST_RAD_S));
    }

    /// An interval with a field of this variance.
    pub(super) fn judge(&mut self, interval: &Interval, settings: &Settings, variance_ut2: f64) -> Outcome {
        let (t_s, delay_s) = (interval.duration_s, self.main.x[TAU]);
        let main = self.main.measure(interval, delay_s, variance_ut2, GATE);
        let body = self.body.measure(interval, delay_s, variance_ut2, GATE);
        let place = self.place.measure(interval, delay_s, variance_ut2, GATE);
        let turning = interval.turning_rad_s > TURNING_RAD_S;
        if turning {
            let lead = |nis: f64, determinant: f64| {
                nis.min(NIS_MAX) - body.nis.min(NIS_MAX) + libm::log(determinant / body.determinant)
                    - ALLOWANCE_PER_S * t_s
            };
            self.over_main = (self.over_main + lead(main.nis, main.determinant)).max(0.0);
            self.over_place = (self.over_place + lead(place.nis, place.determinant)).max(0.0);
        }
        self.failing_s = if body.accepted { 0.0 } else { self.failing_s + t_s };
        self.age_s += t_s;
        self.turned_rad += interval.turning_rad_s * t_s;
        let beginner = self.accepted_s < BEGINNER_S;
        if main.accepted {
            self.accepted_s = (self.accepted_s + t_s).min(BEGINNER_S);
            self.rejected_s = (self.rejected_s - 2.0 * t_s).max(0.0);
        } else if turning || beginner {
            self.rejected_s += t_s;
        }
        let patience_s = if beginner { self.accepted_s.max(BEGINNER_REJECTED_S) } else { REJECTED_S };
        let mut replaced = false;
        if self.over_main > MARGIN && self.over_place > MARGIN && self.is_another() {
            self.main = self.body;
            self.rejected_s = 0.0;
            self.challenge();
            replaced = true;
        } else if self.rejected_s > patience_s && self.lost && beginner {
            // What the first fields said on a level that was wrong.
            self.lose_direction();
            self.lost = false;
            replaced = true;
        } else if self.rejected_s > patience_s {
            let mut anew = Filter::begun(settings);
            if !beginner {
                anew.keep_clockwork(&self.main, CHALLENGE_UT);
            }
            *self = Self::of(anew);
            self.begin(interval, delay_s, variance_ut2);
            replaced = true;
        } else if self.failing_s > FAILED_S || self.age_s > CHALLENGE_S {
            self.challenge();
        }
        Outcome { accepted: main.accepted, replaced }
    }

    /// B and E begin anew from M.
    fn challenge(&mut self) {
        (self.body, self.place) = (self.main, self.main);
        self.body.open(B, CHALLENGE_UT);
        self.place.open(E, CHALLENGE_UT);
        (self.over_main, self.over_place) = (0.0, 0.0);
        (self.failing_s, self.age_s, self.turned_rad) = (0.0, 0.0, 0.0);
    }

    /// B has another hard iron than M, and the body turned enough to tell.
    fn is_another(&self) -> bool {
        let apart2 = self.body.hard_iron_apart2(&self.main);
        apart2 > APART_UT * APART_UT && self.turned_rad > TURNED_RAD
    }

    /// The body rests where it rested before; false where M does not believe it.
    pub(super) fn is_place(&mut self) -> bool {
        let believed = self.main.is_place();
        if believed {
            self.body.is_place();
            self.place.is_place();
        }
        believed
    }

    /// The place where the body rests is the one to know again.
    pub(super) fn know_place(&mut self) {
        self.each(Filter::know_place);
    }

    fn each(&mut self, mut act: impl FnMut(&mut Filter)) {
        [&mut self.main, &mut self.body, &mut self.place].into_iter().for_each(&mut act);
    }

    /// What is wrong with the state.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        [&self.main, &self.body, &self.place].into_iter().find_map(Filter::flaw)
    }
}

impl Numbers for HypothesisTest {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.each(|filter| filter.visit(visit));
        let Self { over_main, over_place, failing_s, age_s, turned_rad, accepted_s, rejected_s, .. } = self;
        [over_main, over_place, failing_s, age_s, turned_rad, accepted_s, rejected_s].into_iter().for_each(&mut *visit);
        self.lost.visit(visit);
    }
}
