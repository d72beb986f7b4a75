//! One hypothesis about the field: a Kalman filter of sixteen states.
//!
//! x = [e(3) field of the place, β drift rate of the gyro's heading, τ delay of the magnetometer, b(3) hard iron, d(3) what the
//! place adds where the body is, κ(3) error of the gyro's scale, each axis, p(2) horizontal field where the body rested before], all but
//! b and κ in the reference frame. Of an interval's means y, R', Ω:
//!
//! y = e + (τ − τ') Ω × e + R' b + d + v,
//!
//! τ' being the delay that R' was taken back by. Between intervals e turns about the vertical by βT + Σ κ_i ψ_i, ψ_i = ∫ u_i ω_i dt
//! being the turn about the vertical that body axis i made (u: up in body axes), with a random walk along ζ0 × e, for the gyro turns
//! it and stretches nothing. Without κ a body that keeps turning one way has a drift that is none when it stops or turns back: half a
//! per cent of a turn is 2°, and β, which stands for what does not depend on the motion, follows it for a minute. d fades with the
//! way the body has gone and little while it stays: a sensor that does not move learns nothing about the field beyond its place. Where
//! a movement or a rest begins it is another. κ is what the level left of the scale, which it finds as well: as unknown as there, no
//! more. p turns as e does; where the body rests again as it did there, 0 = e + d − p + v tells how far the gyro has drifted.
//!
//! The three components of y are used in one step by the Cholesky factor of S = H P Hᵀ + R: W = P Hᵀ L⁻ᵀ, x += W L⁻¹ν, P −= W Wᵀ.
//!
//! Arrays, and a factor of three rows written out, where nalgebra's `SMatrix` and `Cholesky` read better: with those the update of the whole
//! chain costs 0.42 of VQF's in the same chain, with these 0.39 (`plumb score --fuser wz --fuser vqf`, four runs of each in turn), 8 % more.

use super::levelled::Interval;
use crate::{
    Vector3,
    fuser::{hard_iron::HardIron, wz::settings::Settings},
    numbers::Numbers,
};

/// Numbers in the state, and where its parts begin.
pub(super) const STATES: usize = 16;
pub(super) const E: usize = 0;
pub(super) const BETA: usize = 3;
pub(super) const TAU: usize = 4;
pub(super) const B: usize = 5;
const D: usize = 8;
pub(super) const KAPPA: usize = 11;
const PLACE: usize = 14;

/// Standard deviation of the field of a place that is not known, µT: the strongest on earth.
const FIELD_SD_UT: f64 = 60.0;
/// The drift rate before the gyro was seen at rest, rad/s: a consumer MEMS gyro. It is also the most that may be believed.
pub(super) const DRIFT_SD_RAD_S: f64 = 0.01;
/// Random walk of the drift rate while the body moves, rad/s/√s; what it adds for each rad/s of the rate, 1/√s; and what a body that
/// vibrates adds: its bias is not that of its rest.
const DRIFT_WALK_RAD_S: f64 = 6e-5;
const DRIFT_WALK_BY_RATE: f64 = 1.5e-5;
const DRIFT_WALK_SHAKEN_RAD_S: f64 = 2.2e-4;
/// Most that κ is less known than the scale from the level, as its multiple and beside it.
const SCALE_SD_OF_LEVEL: f64 = 1.5;
const SCALE_SD_BESIDE: f64 = 3e-4;
/// Error of the gyro's scale, each axis: data sheets of MEMS gyros allow 0.5 to 1 % at most.
const SCALE_SD: f64 = 0.003;
/// Its random walk, 1/√s: what a few degrees of warming make of it in an hour.
const SCALE_WALK: f64 = 1e-5;
/// Random walk of the gyro's heading, rad/√s, and what it adds for each rad/s of the rate.
const TURN_WALK_RAD: f64 = 2e-4;
const TURN_WALK_BY_RATE: f64 = 6e-4;
/// Random walk of the field, µT/√s.
const FIELD_WALK_UT: f64 = 0.01;
/// What the place adds: iron in a building, and the sensor's own soft iron.
const PLACE_SD_UT: f64 = 1.23;
/// How fast that fades: 1/s of a body that rests, 1/rad of its turns, and for accelerations beyond the first by 1 m/s², 1/s.
const FADE_AT_REST: f64 = 0.06;
const FADE_BY_TURN: f64 = 0.2;
const FADE_BY_ACCELERATION: f64 = 0.15;
const ACCELERATION_OF_REST_M_S2: f64 = 0.3;
/// Noise of the field of a place where the body rests again, each axis, µT, and the largest normalised square of an innovation that is
/// believed there: the field of another place may be alike.
const AGAIN_SD_UT: f64 = 0.2;
const AGAIN_GATE: f64 = 4.0;
/// The delays of magnetometers there are, s.
const DELAY_MIN_S: f64 = -0.01;
const DELAY_MAX_S: f64 = 0.04;

/// What passes between two measurements, the same for every hypothesis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Propagation {
    duration_s: f64,
    /// Turn about the vertical by each body axis, rad.
    turned_rad: [f64; 3],
    /// The body moved, so that the gyro's heading drifted.
    moved: bool,
    /// A movement or a rest began: d is another.
    elsewhere: bool,
    /// Variances that come: of the drift rate, rad²/s², and the most there is of the scale.
    drift_variance_rad2_s2: f64,
    scale_variance_max: [f64; 3],
    /// What is left of d, and the variance that comes for it, µT².
    kept: f64,
    place_variance_ut2: f64,
    turn_variance_rad2: f64,
    field_variance_ut2: f64,
}

impl Propagation {
    /// The interval's; `elsewhere` where it begins a movement or a rest.
    pub(super) fn of(interval: &Interval, elsewhere: bool) -> Self {
        let (t_s, turning) = (interval.duration_s, interval.turning_rad_s);
        let acceleration = (interval.acceleration_m_s2 - ACCELERATION_OF_REST_M_S2).max(0.0);
        let fade = FADE_AT_REST + FADE_BY_TURN * turning + FADE_BY_ACCELERATION * acceleration;
        let kept = libm::exp(-fade * t_s);
        let square = |x: f64| x * x;
        let drift_walk2 = square(DRIFT_WALK_RAD_S)
            + square(DRIFT_WALK_BY_RATE * turning)
            + if interval.shaken { square(DRIFT_WALK_SHAKEN_RAD_S) } else { 0.0 };
        let walk_rad = TURN_WALK_RAD + TURN_WALK_BY_RATE * turning;
        Self {
            duration_s: t_s,
            turned_rad: interval.turned_rad,
            moved: !interval.at_rest,
            elsewhere,
            drift_variance_rad2_s2: drift_walk2 * t_s,
            scale_variance_max: interval
                .scale_variance
                .map(|variance| square(SCALE_SD_OF_LEVEL) * variance + square(SCALE_SD_BESIDE)),
            kept,
            place_variance_ut2: PLACE_SD_UT * PLACE_SD_UT * (1.0 - kept * kept),
            turn_variance_rad2: walk_rad * walk_rad * t_s,
            field_variance_ut2: FIELD_WALK_UT * FIELD_WALK_UT * t_s,
        }
    }
}

/// What an interval said about a hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Verdict {
    /// Normalised square of the innovation, three degrees of freedom.
    pub(super) nis: f64,
    /// Determinant of its covariance, µT⁶.
    pub(super) determinant: f64,
    /// It passed the gate and was used.
    pub(super) accepted: bool,
}

/// A hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Filter {
    pub(super) x: [f64; STATES],
    /// Symmetric, both halves kept.
    p: [[f64; STATES]; STATES],
}

impl Filter {
    /// Nothing is known but what the settings say.
    pub(super) fn begun(settings: &Settings) -> Self {
        let mut filter = Self { x: [0.0; STATES], p: [[0.0; STATES]; STATES] };
        filter.x[TAU] = settings.magnetometer_delay_s;
        filter.open(E, FIELD_SD_UT);
        filter.open(B, settings.hard_iron_sd_ut);
        filter.open(D, PLACE_SD_UT);
        filter.open(KAPPA, SCALE_SD);
        filter.reset(BETA, DRIFT_SD_RAD_S);
        filter.p[TAU][TAU] = settings.magnetometer_delay_sd_s * settings.magnetometer_delay_sd_s;
        filter
    }

    /// The field and the hard iron, within `hard_iron_sd_ut`, begin anew; the drift, the gyro's scale and the delay of `known` stay.
    pub(super) fn keep_clockwork(&mut self, known: &Self, hard_iron_sd_ut: f64) {
        for i in [BETA, TAU, KAPPA, KAPPA + 1, KAPPA + 2] {
            self.x[i] = known.x[i];
            self.p[i][i] = known.p[i][i];
        }
        self.open(B, hard_iron_sd_ut);
    }

    /// The hard iron is what somebody has found before; what is not known stays what the settings say.
    pub(super) fn know(&mut self, hard_iron: HardIron) {
        let HardIron { field_ut, sd_ut } = hard_iron;
        if sd_ut.is_finite() {
            for (i, part_ut) in (B..).zip(field_ut.iter()) {
                self.reset(i, sd_ut);
                self.x[i] = *part_ut;
            }
        }
    }

    /// The hard iron; unknown where it is taken to be none.
    pub(super) fn hard_iron(&self) -> HardIron {
        let variance_ut2 = (B..B + 3).map(|i| self.p[i][i]).fold(0.0, f64::max);
        if variance_ut2 == 0.0 {
            return HardIron::UNKNOWN;
        }
        let field_ut = Vector3::new(self.x[B], self.x[B + 1], self.x[B + 2]);
        HardIron { field_ut, sd_ut: libm::sqrt(variance_ut2) }
    }

    /// How far the hard iron is from another hypothesis's, µT, squared.
    pub(super) fn hard_iron_apart2(&self, other: &Self) -> f64 {
        (B..B + 3).map(|i| (self.x[i] - other.x[i]) * (self.x[i] - other.x[i])).sum()
    }

    /// The field less the hard iron, µT, reference axes.
    pub(super) fn without_hard_iron(&self, interval: &Interval) -> [f64; 3] {
        let of = |[a, b, c]: [f64; 3]| a * self.x[B] + b * self.x[B + 1] + c * self.x[B + 2];
        core::array::from_fn(|i| interval.field_ut[i] - of(interval.axes[i]))
    }

    /// Three states from `first` on may be off by `sd` more.
    pub(super) fn open(&mut self, first: usize, sd: f64) {
        for i in first..first + 3 {
            self.p[i][i] += sd * sd;
        }
    }

    /// A state is zero within `sd`, whatever was believed of it.
    pub(super) fn reset(&mut self, i: usize, sd: f64) {
        self.x[i] = 0.0;
        self.p[i] = [0.0; STATES];
        self.p.iter_mut().for_each(|row| row[i] = 0.0);
        self.p[i][i] = sd * sd;
    }

    /// North is where it is within `sd_rad`, and within what the place adds to the field by which it was found; of the field's strength
    /// nothing is known but the sample.
    pub(super) fn face_north(&mut self, field_ut: [f64; 3], sd_rad: f64) {
        let horizontal = libm::hypot(field_ut[0], field_ut[1]);
        (self.x[E], self.x[E + 1], self.x[E + 2]) = (0.0, horizontal, field_ut[2]);
        self.p[E][E] = horizontal * horizontal * sd_rad * sd_rad + PLACE_SD_UT * PLACE_SD_UT;
    }

    /// The gyro's heading may have turned by `variance_rad2` more.
    pub(super) fn turn_walk(&mut self, variance_rad2: f64) {
        let turn = [(E, -self.x[E + 1]), (E + 1, self.x[E]), (PLACE, -self.x[PLACE + 1]), (PLACE + 1, self.x[PLACE])];
        for (i, by_i) in turn {
            for (j, by_j) in turn {
                self.p[i][j] += variance_rad2 * (by_i * by_j);
            }
        }
    }

    /// The body rests where it rested before: what e and d add up to is p. It is used if the innovation passes the gate.
    pub(super) fn is_place(&mut self) -> bool {
        const VARIANCE_UT2: f64 = AGAIN_SD_UT * AGAIN_SD_UT;
        let [across, along] = [0, 1].map(|i| self.at_place(i));
        let s = |of: &[f64; STATES], i: usize| of[E + i] + of[D + i] - of[PLACE + i];
        let r0 = libm::sqrt(s(&across, 0).max(0.0) + VARIANCE_UT2).recip();
        let l10 = s(&across, 1) * r0;
        let r1 = libm::sqrt((s(&along, 1) - l10 * l10).max(0.0) + VARIANCE_UT2).recip();
        let z0 = -s(&self.x, 0) * r0;
        let z1 = (-s(&self.x, 1) - l10 * z0) * r1;
        if z0 * z0 + z1 * z1 >= AGAIN_GATE {
            return false;
        }
        let w0 = across.map(|part| part * r0);
        let w1: [f64; STATES] = core::array::from_fn(|i| (along[i] - l10 * w0[i]) * r1);
        for i in 0..STATES {
            self.x[i] += w0[i] * z0 + w1[i] * z1;
            for j in 0..STATES {
                self.p[i][j] -= w0[i] * w0[j] + w1[i] * w1[j];
            }
            self.p[i][i] = self.p[i][i].max(0.0);
        }
        true
    }

    /// Column of the covariance of component `i` of e + d − p with the state.
    fn at_place(&self, i: usize) -> [f64; STATES] {
        core::array::from_fn(|j| self.p[E + i][j] + self.p[D + i][j] - self.p[PLACE + i][j])
    }

    /// The place where the body rests is the one to know again: p is what e and d add up to.
    pub(super) fn know_place(&mut self) {
        for i in 0..2 {
            self.x[PLACE + i] = self.x[E + i] + self.x[D + i];
            self.p[PLACE + i] = core::array::from_fn(|j| self.p[E + i][j] + self.p[D + i][j]);
            for row in &mut self.p {
                row[PLACE + i] = row[E + i] + row[D + i];
            }
        }
    }

    /// The horizontal field may point anywhere: open by its own strength in both components, it passes the gate from every side.
    pub(super) fn lose_direction(&mut self) {
        let horizontal2 = self.x[E] * self.x[E] + self.x[E + 1] * self.x[E + 1];
        self.p[E][E] += horizontal2;
        self.p[E + 1][E + 1] += horizontal2;
    }

    /// Angle that turns the horizontal field to north, rad, and its variance.
    pub(super) fn turn_rad(&self) -> (f64, f64) {
        let (x, y) = (self.x[E], self.x[E + 1]);
        let across = self.p[0][0] * y * y - 2.0 * self.p[0][1] * x * y + self.p[1][1] * x * x;
        let square = x * x + y * y;
        (libm::atan2(x, y), across.max(0.0) / (square * square).max(1e-12))
    }

    /// Time passes.
    pub(super) fn predict(&mut self, propagation: &Propagation) {
        if propagation.elsewhere {
            (D..D + 3).for_each(|i| self.reset(i, PLACE_SD_UT));
        }
        for (i, most) in (KAPPA..).zip(propagation.scale_variance_max) {
            self.bound(i, most);
        }
        if propagation.moved {
            self.drift(propagation);
        }
        for i in D..D + 3 {
            self.x[i] *= propagation.kept;
            self.p[i].iter_mut().for_each(|part| *part *= propagation.kept);
        }
        for row in &mut self.p {
            row[D..D + 3].iter_mut().for_each(|part| *part *= propagation.kept);
        }
        for i in 0..3 {
            self.p[D + i][D + i] += propagation.place_variance_ut2;
            self.p[E + i][E + i] += propagation.field_variance_ut2;
        }
        for i in [PLACE, PLACE + 1] {
            self.p[i][i] += propagation.field_variance_ut2;
        }
        self.turn_walk(propagation.turn_variance_rad2);
    }

    /// A state is known at least within this variance.
    fn bound(&mut self, i: usize, most: f64) {
        if self.p[i][i] > most {
            let scale = libm::sqrt(most / self.p[i][i]);
            self.p[i].iter_mut().for_each(|part| *part *= scale);
            self.p.iter_mut().for_each(|row| row[i] *= scale);
        }
    }

    /// e and p turn by βT + Σ κψ.
    fn drift(&mut self, propagation: &Propagation) {
        let Propagation { duration_s: t_s, turned_rad: [psi_x, psi_y, psi_z], .. } = *propagation;
        let drift = |of: &[f64]| t_s * of[BETA] + psi_x * of[KAPPA] + psi_y * of[KAPPA + 1] + psi_z * of[KAPPA + 2];
        let sin = drift(&self.x).clamp(-0.1, 0.1);
        let cos = 1.0 - 0.5 * sin * sin;
        // F P Fᵀ: the rows, then the columns.
        let (by_beta, [by_x, by_y, by_z]) = (self.p[BETA], [self.p[KAPPA], self.p[KAPPA + 1], self.p[KAPPA + 2]]);
        let turn: [f64; STATES] =
            core::array::from_fn(|j| t_s * by_beta[j] + psi_x * by_x[j] + psi_y * by_y[j] + psi_z * by_z[j]);
        let turned = [E, PLACE].map(|i| (i, self.x[i], self.x[i + 1]));
        for (i, x, y) in turned {
            (self.x[i], self.x[i + 1]) = (cos * x - sin * y, cos * y + sin * x);
            let (p0, p1) = (self.p[i], self.p[i + 1]);
            self.p[i] = core::array::from_fn(|j| cos * p0[j] - sin * p1[j] - y * turn[j]);
            self.p[i + 1] = core::array::from_fn(|j| cos * p1[j] + sin * p0[j] + x * turn[j]);
        }
        for row in &mut self.p {
            let c = drift(row);
            for (i, x, y) in turned {
                let (a, b) = (row[i], row[i + 1]);
                row[i] = cos * a - sin * b - y * c;
                row[i + 1] = cos * b + sin * a + x * c;
            }
        }
        for i in KAPPA..KAPPA + 3 {
            self.p[i][i] += SCALE_WALK * SCALE_WALK * t_s;
        }
        // Both halves alike to the last bit: a snapshot holds one.
        let summed = [E, E + 1, PLACE, PLACE + 1];
        for (k, i) in summed.into_iter().enumerate() {
            summed[k + 1..].iter().for_each(|j| self.p[*j][i] = self.p[i][*j]);
        }
        let drift = &mut self.p[BETA][BETA];
        if *drift < DRIFT_SD_RAD_S * DRIFT_SD_RAD_S {
            *drift += propagation.drift_variance_rad2_s2;
        }
    }

    /// An interval's field, of this variance on each axis; it is used if the innovation passes the gate.
    pub(super) fn measure(&mut self, interval: &Interval, delay_s: f64, variance_ut2: f64, gate: f64) -> Verdict {
        let (rate, e) = (interval.rate_rad_s, [self.x[0], self.x[1], self.x[2]]);
        let swept = [rate[1] * e[2] - rate[2] * e[1], rate[2] * e[0] - rate[0] * e[2], rate[0] * e[1] - rate[1] * e[0]];
        let late_s = self.x[TAU] - delay_s;
        let mut innovation = [0.0; 3];
        let mut w = [[0.0; STATES]; 3];
        for i in 0..3 {
            let [a, b, c] = interval.axes[i];
            let hard_iron = a * self.x[B] + b * self.x[B + 1] + c * self.x[B + 2];
            innovation[i] = interval.field_ut[i] - (e[i] + late_s * swept[i] + hard_iron + self.x[D + i]);
            for (j, w) in w[i].iter_mut().enumerate() {
                *w = self.p[E + i][j]
                    + self.p[D + i][j]
                    + swept[i] * self.p[TAU][j]
                    + a * self.p[B][j]
                    + b * self.p[B + 1][j]
                    + c * self.p[B + 2][j];
            }
        }
        let s = |i: usize, j: usize| {
            let ([a, b, c], w) = (interval.axes[j], &w[i]);
            w[E + j] + w[D + j] + swept[j] * w[TAU] + a * w[B] + b * w[B + 1] + c * w[B + 2]
        };
        // S = L Lᵀ; rounding may not take more than the noise leaves.
        let d0 = s(0, 0).max(0.0) + variance_ut2;
        let r0 = libm::sqrt(d0).recip();
        let (l10, l20) = (s(0, 1) * r0, s(0, 2) * r0);
        let d1 = (s(1, 1) - l10 * l10).max(0.0) + variance_ut2;
        let r1 = libm::sqrt(d1).recip();
        let l21 = (s(1, 2) - l10 * l20) * r1;
        let d2 = (s(2, 2) - l20 * l20 - l21 * l21).max(0.0) + variance_ut2;
        let r2 = libm::sqrt(d2).recip();
        let z0 = innovation[0] * r0;
        let z1 = (innovation[1] - l10 * z0) * r1;
        let z2 = (innovation[2] - l20 * z0 - l21 * z1) * r2;
        let nis = z0 * z0 + z1 * z1 + z2 * z2;
        let accepted = nis < gate;
        if accepted {
            let [w0, w1, w2] = &mut w;
            for ((w0, w1), w2) in w0.iter_mut().zip(&mut *w1).zip(&mut *w2) {
                *w0 *= r0;
                *w1 = (*w1 - l10 * *w0) * r1;
                *w2 = (*w2 - l20 * *w0 - l21 * *w1) * r2;
            }
            for i in 0..STATES {
                self.x[i] += w0[i] * z0 + w1[i] * z1 + w2[i] * z2;
                for j in 0..STATES {
                    self.p[i][j] -= w0[i] * w0[j] + w1[i] * w1[j] + w2[i] * w2[j];
                }
                self.p[i][i] = self.p[i][i].max(0.0);
            }
            self.x[TAU] = self.x[TAU].clamp(DELAY_MIN_S, DELAY_MAX_S);
        }
        Verdict { nis, determinant: d0 * d1 * d2, accepted }
    }

    /// What is wrong with the state: a covariance that no random numbers have, found by its factors L D Lᵀ.
    pub(super) fn flaw(&self) -> Option<&'static str> {
        let mut left = self.p;
        for k in 0..STATES {
            let (pivot, least) = (left[k][k], -1e-9 * self.p[k][k].max(0.0));
            if self.p[k][k] < 0.0 || pivot < least {
                return Some("a covariance of the field that is not positive");
            }
            let row = left[k];
            for i in k + 1..STATES {
                let share = if pivot > -least { row[i] / pivot } else { 0.0 };
                if share == 0.0 && row[i] * row[i] > 1e-9 * self.p[k][k] * self.p[i][i] {
                    return Some("a covariance of the field that is not positive");
                }
                left[i].iter_mut().zip(row).for_each(|(part, of_row)| *part -= share * of_row);
            }
        }
        (self.x.iter().any(|x| x.abs() > 1e4)).then_some("a field beyond every magnet")
    }
}

impl Numbers for Filter {
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.x.iter_mut().for_each(&mut *visit);
        for i in 0..STATES {
            for j in i..STATES {
                visit(&mut self.p[i][j]);
                self.p[j][i] = self.p[i][j];
            }
        }
    }
}
