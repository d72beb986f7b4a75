//! Whether the gyro turns gravity as the accelerometer sees it.
//!
//! Turned back by what the gyro tells, the force stays where it is: gravity alone has a mean. Over windows in which the force turns in the
//! body's axes, its spread about that mean is compared between the rate as it is and every other choice of the gyro's axes and unit: all
//! signed permutations, in rad/s, as °/s and as rad/s divided twice.

use attitude::{Matrix3, Vector3};

use crate::finding::{self, Finding};

/// Length of a step, s, one turn of the force: 250 Hz are as good as 8 kHz for two seconds, and cost a thirtieth.
const STEP_S: f64 = 0.004;
/// A sample farther apart than this says nothing of what was between, s: the slowest sensors that keep an attitude have 10 Hz.
const SAMPLE_MAX_S: f64 = 0.12;
/// Length of a window, s: accelerations of a hand or a vehicle turn around within it.
const WINDOW_S: f64 = 2.0;
/// Spread of the force in the body's axes from which the window has turned: by some 20°, above what shaking at rest makes.
const TURNED: f64 = 0.04;
/// Windows that a finding needs: one may hold a blow, two one of them.
const WINDOWS_MIN: u32 = 3;
/// Share of the spread in the body's axes that may be left when the true choice is made: where more is, accelerations and not turns made it.
/// Of few windows less may be left, as if one of them had told nothing.
const LEFT_BELIEVED: f64 = 0.5;
/// What the rate as it is must leave, so many times more: the best of 144 choices is always a little better than the true one.
const WORSE: f64 = 1.5;
/// And so much beside it, share of the spread: of two choices that leave next to nothing neither is wrong.
const WORSE_BY: f64 = 0.08;
/// Other choices count as well that leave so many times as much as the best, and so much beside it: motion about few axes leaves several.
const AS_WELL: f64 = 1.15;
const AS_WELL_BY: f64 = 0.01;
/// Units: as it is, °/s taken for rad/s, and rad/s taken for °/s.
const SCALES: [f64; 3] = [1.0, std::f64::consts::PI / 180.0, 180.0 / std::f64::consts::PI];

/// The true rate is `scale * axes` times the gyro's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hypothesis {
    pub(crate) axes: Matrix3<f64>,
    pub(crate) scale: f64,
    /// Share of the spread in the body's axes that it leaves.
    pub(crate) left: f64,
}

/// The hypotheses of one unit and one hand. Axes `A` with the determinant ±1 make of the turn `t` the rotation `A R(±t) Aᵀ`: all of them share
/// its product over the window.
#[derive(Debug, Clone)]
struct Hand {
    scale: f64,
    sign: f64,
    /// By the rotations so far, from the body's axes to where the window began.
    back: Matrix3<f64>,
    /// Sums of `back` times a component of the force, for each of the three.
    moments: [Matrix3<f64>; 3],
    lanes: Vec<Lane>,
}

/// One hypothesis at work.
#[derive(Debug, Clone)]
struct Lane {
    axes: Matrix3<f64>,
    spread: f64,
}

/// The hypotheses side by side.
#[derive(Debug, Clone)]
pub(crate) struct Turning {
    hands: Vec<Hand>,
    step: Step,
    window_s: f64,
    count: f64,
    force: Vector3<f64>,
    squares: f64,
    windows: u32,
    /// Sum of the spreads in the body's axes.
    spread: f64,
}

/// What a step has gathered.
#[derive(Debug, Clone, Copy, Default)]
struct Step {
    dt_s: f64,
    count: f64,
    turn_rad: Vector3<f64>,
    force: Vector3<f64>,
}

impl Default for Turning {
    fn default() -> Self {
        let hands = SCALES.iter().flat_map(|scale| [1.0, -1.0].map(|sign| Hand::new(*scale, sign)));
        Self {
            hands: hands.collect(),
            step: Step::default(),
            window_s: 0.0,
            count: 0.0,
            force: Vector3::zeros(),
            squares: 0.0,
            windows: 0,
            spread: 0.0,
        }
    }
}

impl Turning {
    /// How long motion was seen that tells something, s.
    pub(crate) fn seconds(&self) -> f64 {
        f64::from(self.windows) * WINDOW_S
    }

    /// The force has turned enough to judge by.
    pub(crate) fn is_enough(&self) -> bool {
        self.windows >= WINDOWS_MIN
    }

    /// What came before does not go on.
    pub(crate) fn interrupt(&mut self) {
        self.step = Step::default();
        self.begin();
    }

    fn begin(&mut self) {
        (self.window_s, self.count, self.squares, self.force) = (0.0, 0.0, 0.0, Vector3::zeros());
        self.hands.iter_mut().for_each(Hand::begin);
    }

    pub(crate) fn take(&mut self, dt_s: f64, rate_rad_s: [f64; 3], force_m_s2: [f64; 3]) {
        if !(0.0..SAMPLE_MAX_S).contains(&dt_s) {
            return self.interrupt();
        }
        let step = &mut self.step;
        step.dt_s += dt_s;
        step.count += 1.0;
        step.turn_rad += Vector3::from(rate_rad_s) * dt_s;
        step.force += Vector3::from(force_m_s2);
        if step.dt_s < STEP_S {
            return;
        }
        let Step { dt_s, count, turn_rad, force } = std::mem::take(step);
        let force = force / count;
        self.window_s += dt_s;
        self.count += 1.0;
        self.force += force;
        self.squares += force.norm_squared();
        self.hands.iter_mut().for_each(|hand| hand.take(turn_rad, force));
        if self.window_s >= WINDOW_S {
            self.close();
        }
    }

    /// Ends a window.
    fn close(&mut self) {
        let whole = self.count * self.squares;
        let spread = |sum: &Vector3<f64>| 1.0 - sum.norm_squared() / whole;
        let still = spread(&self.force);
        if still > TURNED && still.is_finite() {
            self.windows += 1;
            self.spread += still;
            self.hands.iter_mut().for_each(|hand| hand.close(spread));
        }
        self.begin();
    }

    pub(crate) fn finding(&self) -> Option<Finding> {
        if !self.is_enough() {
            return None;
        }
        let mut all: Vec<_> = self.hands.iter().flat_map(|hand| hand.hypotheses(self.spread)).collect();
        all.sort_by(|one, other| one.left.total_cmp(&other.left));
        let is_as_is = |hypothesis: &&Hypothesis| hypothesis.scale == 1.0 && hypothesis.axes == Matrix3::identity();
        let (best, as_is) = (all.first()?.left, all.iter().find(is_as_is)?.left);
        let believed = LEFT_BELIEVED * (1.0 - f64::from(self.windows).recip());
        if !(best < believed && as_is > WORSE * best + WORSE_BY) {
            return None;
        }
        // Of several those that change least come first.
        all.retain(|hypothesis| hypothesis.left < AS_WELL * best + AS_WELL_BY);
        all.sort_by(|one, other| simplicity(other).total_cmp(&simplicity(one)).then(one.left.total_cmp(&other.left)));
        Some(finding::turning(as_is, self.seconds(), &all))
    }
}

impl Hand {
    fn new(scale: f64, sign: f64) -> Self {
        let of_this_hand = signed_permutations().filter(|axes| axes.determinant() * sign > 0.0);
        let lanes = of_this_hand.map(|axes| Lane { axes, spread: 0.0 }).collect();
        Self { scale, sign, back: Matrix3::identity(), moments: [Matrix3::zeros(); 3], lanes }
    }

    fn begin(&mut self) {
        (self.back, self.moments) = (Matrix3::identity(), [Matrix3::zeros(); 3]);
    }

    fn take(&mut self, turn_rad: Vector3<f64>, force: Vector3<f64>) {
        self.back *= turned(turn_rad * self.sign * self.scale);
        self.moments.iter_mut().zip(force.iter()).for_each(|(moment, force)| *moment += self.back * *force);
    }

    /// Ends a window; `spread` is that of a sum of forces.
    fn close(&mut self, spread: impl Fn(&Vector3<f64>) -> f64) {
        let Self { moments, lanes, .. } = self;
        for lane in lanes {
            // The sum in the turned axes but for its sign: it is as long as that in the body's.
            let terms = moments.iter().zip(lane.axes.row_iter());
            let force = terms.map(|(moment, row)| moment * row.transpose()).sum();
            lane.spread += spread(&force);
        }
    }

    /// Its hypotheses, where `spread` is the sum in the body's axes.
    fn hypotheses(&self, spread: f64) -> impl Iterator<Item = Hypothesis> {
        self.lanes.iter().map(move |lane| Hypothesis { axes: lane.axes, scale: self.scale, left: lane.spread / spread })
    }
}

/// How little is changed; to negate all is as simple as to negate one.
fn simplicity(Hypothesis { axes, scale, .. }: &Hypothesis) -> f64 {
    let negated = if axes == &-Matrix3::identity() { 5.0 } else { 0.0 };
    axes.trace() + negated - f64::from(u8::from(*scale != 1.0))
}

/// The rotation by a vector of any finite length.
fn turned(turn_rad: Vector3<f64>) -> Matrix3<f64> {
    let angle = turn_rad.norm();
    let Some(axis) = turn_rad.try_normalize(1e-12) else { return Matrix3::identity() };
    let (sin, cos) = angle.sin_cos();
    Matrix3::identity() * cos + axis.cross_matrix() * sin + axis * axis.transpose() * (1.0 - cos)
}

fn signed_permutations() -> impl Iterator<Item = Matrix3<f64>> {
    const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    ORDERS.into_iter().flat_map(|order| {
        (0..8).map(move |signs| {
            Matrix3::from_fn(|row, column| match order[row] == column {
                true if signs >> row & 1 == 1 => -1.0,
                true => 1.0,
                false => 0.0,
            })
        })
    })
}
