//! What is said: the mistake, its evidence in figures, and the causes it may have, likeliest first, each with lines to paste.

use core::fmt;

use attitude::{GRAVITY_M_S2, Matrix3};

use crate::turning::Hypothesis;

/// What is wrong with the input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mistake {
    /// Rates are not in rad/s.
    RateUnit,
    /// Forces are not in m/s².
    ForceUnit,
    /// Gravity has been taken out of the force.
    GravityRemoved,
    /// Fields are not in µT.
    FieldUnit,
    /// Times are not in the unit they were said to be in.
    TimeUnit,
    /// Stamps go back, stand or leap.
    Stamps,
    /// The gyro does not turn gravity as the accelerometer sees it: axes or signs.
    Turning,
    /// Gravity points out of the body's bottom all the time.
    UpsideDown,
    /// An axis of the gyro stands still.
    RateStuck,
    /// An axis of the accelerometer stands still.
    ForceStuck,
    /// An axis of the gyro ends at its range.
    RateClipped,
    /// An axis of the accelerometer ends at its range.
    ForceClipped,
}

/// A cause that a finding may have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// The cause.
    pub cause: String,
    /// What to do about it; lines to paste where there are some.
    pub remedy: String,
}

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What it is.
    pub mistake: Mistake,
    /// The evidence.
    pub found: String,
    /// What may be the cause, likeliest first.
    pub candidates: Vec<Candidate>,
}

impl Mistake {
    /// It is told by how gravity turns.
    pub(crate) fn is_of_turning(self) -> bool {
        matches!(self, Self::RateUnit | Self::Turning)
    }

    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::RateUnit => "rate-unit",
            Self::ForceUnit => "force-unit",
            Self::GravityRemoved => "gravity-removed",
            Self::FieldUnit => "field-unit",
            Self::TimeUnit => "time-unit",
            Self::Stamps => "stamps",
            Self::Turning => "turning",
            Self::UpsideDown => "upside-down",
            Self::RateStuck => "rate-stuck",
            Self::ForceStuck => "force-stuck",
            Self::RateClipped => "rate-clipped",
            Self::ForceClipped => "force-clipped",
        }
    }
}

impl Finding {
    /// The causes with their remedies, on one line.
    pub fn remedies(&self) -> String {
        let all: Vec<_> =
            self.candidates.iter().map(|Candidate { cause, remedy }| format!("{cause}: {remedy}")).collect();
        all.join("; or ")
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.mistake.name(), self.found)?;
        self.candidates.iter().try_for_each(|Candidate { cause, remedy }| write!(f, "\n    {cause}: {remedy}"))
    }
}

fn candidate(cause: impl Into<String>, remedy: impl Into<String>) -> Candidate {
    Candidate { cause: cause.into(), remedy: remedy.into() }
}

/// Lines for a launch file that multiply what a sensor says.
fn scaled(sensor: &str, factor: f64) -> String {
    format!("`ingest.calibration.{sensor}.scale = [{factor}, {factor}, {factor}]` in the launch file")
}

/// The same, with the word of `plumb import`.
fn in_unit(sensor: &str, factor: f64, unit: &str) -> String {
    format!("`--units {unit}` of `plumb import`, or {}", scaled(sensor, factor))
}

/// A factor for rates in °/s, with digits enough.
const DEGREE_RAD: f64 = 0.017_453_292_52;

pub(crate) fn rates_beyond(clipped: u64, senseless: u64) -> Finding {
    let found = format!(
        "{clipped} rates are at or beyond rate_max_deg_s, and {senseless} so far beyond it that they were refused"
    );
    let candidates = vec![candidate("rates in °/s", in_unit("gyro", DEGREE_RAD, "deg/s"))];
    Finding { mistake: Mistake::RateUnit, found, candidates }
}

/// In so many windows of this length the gyro spins and the force stays.
pub(crate) fn spinning(windows: u32, window_s: f64) -> Finding {
    let found = format!(
        "{windows} times within {window_s} s the gyro told of a turn ten times as far as the force turned, and farther than 57°"
    );
    let candidates = vec![candidate("rates in °/s", in_unit("gyro", DEGREE_RAD, "deg/s"))];
    Finding { mistake: Mistake::RateUnit, found, candidates }
}

pub(crate) fn time_unit(median_s: f64, leaps: u64, samples: u64) -> Finding {
    let import =
        |unit: &str| format!("`--units {unit}` of `plumb import`; a driver on the bus gives t_sensor_ns in ns");
    let candidates = match median_s {
        // Ingest goes on by a sample's usual interval after a leap, so only a longer median tells the unit.
        _ if leaps * 2 > samples && !(0.6..).contains(&median_s) => {
            let remedy = "`--units ms` or `us` of `plumb import`; a driver on the bus gives t_sensor_ns in ns, growing with each reading";
            vec![candidate("stamps that stand, or are in another unit", remedy)]
        }
        // Of 20 Hz to 1.7 kHz in ms.
        0.6..50.0 => vec![
            candidate("times in ms, taken for s", import("ms")),
            candidate("times in µs, taken for ms", import("us")),
            candidate("a sensor that is this slow", "no attitude can be kept by it: sample at 50 Hz or more"),
        ],
        // No sensor is read once a minute; in µs all are.
        50.0.. => vec![
            candidate("times in µs, taken for s", import("us")),
            candidate("times in ns, taken for ms", import("ns")),
        ],
        _ => vec![
            candidate("times in s, taken for ms or less", import("s")),
            candidate("times in µs, taken for ns", import("us")),
        ],
    };
    let found = format!("samples are {median_s:.2e} s apart (median), {leaps} of {samples} stamps leapt");
    Finding { mistake: Mistake::TimeUnit, found, candidates }
}

pub(crate) fn stamps(refused: u64, leaps: u64, samples: u64) -> Finding {
    let found = format!(
        "readings came twice or belonged to the past before {refused} of {samples} samples, and {leaps} stamps stood, leapt or were set back"
    );
    let candidates = vec![
        candidate(
            "a recording that is not sorted, or holds rows twice",
            "sort its rows by time and remove those that are there twice",
        ),
        candidate("stamps of the host's arrival, or of a clock that is set", "stamp by the sensor's own clock"),
    ];
    Finding { mistake: Mistake::Stamps, found, candidates }
}

pub(crate) fn force_size(low: f64, median: f64, high: f64, is_steady: bool) -> Finding {
    let found =
        format!("the force is {median:.3} m/s² (median; {low:.3} to {high:.3}), at rest it is {GRAVITY_M_S2:.2}");
    let per_g = median / GRAVITY_M_S2;
    let gravity_removed = candidate(
        "gravity has been taken out of it (\"linear\" or \"user\" acceleration)",
        "record the accelerometer itself; of a phone \"Accelerometer\" with gravity, not \"Linear Acceleration\"",
    );
    let in_g = candidate("forces in g", in_unit("accel", GRAVITY_M_S2, "g"));
    let (mistake, candidates) = match (median, per_g) {
        // One at rest in g, as far as a scale may be off; with motion in it farther, and then motion alone may be so large.
        (0.85..1.2, _) if is_steady => (Mistake::ForceUnit, vec![in_g]),
        (0.7..1.4, _) => (Mistake::ForceUnit, vec![in_g, gravity_removed]),
        // Less than any body near the earth has for long.
        (_, ..0.5) => (
            Mistake::GravityRemoved,
            vec![gravity_removed, candidate("a scale that is wrong", scaled("accel", per_g.recip()))],
        ),
        // 9.8 times too much, as far as a scale may be off.
        (_, 8.0..12.0) => {
            (Mistake::ForceUnit, vec![candidate("m/s² taken for g", in_unit("accel", GRAVITY_M_S2.recip(), "m/s2"))])
        }
        // A thousand at rest, likewise.
        (850.0..1200.0, _) => {
            (Mistake::ForceUnit, vec![candidate("forces in thousandths of g", scaled("accel", GRAVITY_M_S2 / 1000.0))])
        }
        _ => (
            Mistake::ForceUnit,
            vec![candidate("a scale that is wrong, such as counts of a converter", scaled("accel", per_g.recip()))],
        ),
    };
    Finding { mistake, found, candidates }
}

pub(crate) fn field_unit(median_ut: f64) -> Option<Finding> {
    // The earth's 22 to 67 µT in each unit, with what iron adds and takes; between them nothing is said.
    let (cause, factor, unit) = match median_ut {
        0.15..1.0 => ("fields in gauss", 100.0, "gauss"),
        0.015..0.1 => ("fields in mT", 1e3, "mT"),
        150.0..1000.0 => ("fields in thousandths of gauss", 0.1, ""),
        8e3..240e3 => ("fields in nT", 1e-3, "nT"),
        15e-6..100e-6 => ("fields in T", 1e6, ""),
        _ => return None,
    };
    let remedy = if unit.is_empty() { scaled("mag", factor) } else { in_unit("mag", factor, unit) };
    let found = format!("the field is {median_ut:.3e} µT (median), the earth's is 22 to 67");
    Some(Finding { mistake: Mistake::FieldUnit, found, candidates: vec![candidate(cause, remedy)] })
}

pub(crate) fn field_refused(count: u64) -> Finding {
    let found = format!("{count} samples of the field were left out: beyond field_max_ut or not finite");
    let remedy = "`--units nT` of `plumb import`; a driver on the bus gives µT";
    Finding { mistake: Mistake::FieldUnit, found, candidates: vec![candidate("fields in nT", remedy)] }
}

/// `all` are the hypotheses that fit, those that change least first.
pub(crate) fn turning(as_is: f64, seconds: f64, all: &[Hypothesis]) -> Finding {
    /// Of those that only differ in what the motion has not shown: more nobody tries.
    const SHOWN: usize = 3;
    let unit_only = all.iter().find(|hypothesis| hypothesis.axes == Matrix3::identity());
    let (mistake, candidates) = match unit_only {
        Some(Hypothesis { scale, .. }) if *scale < 1.0 => {
            (Mistake::RateUnit, vec![candidate("rates in °/s", in_unit("gyro", DEGREE_RAD, "deg/s"))])
        }
        Some(_) => {
            let remedy = in_unit("gyro", 57.295_78, "rad/s");
            (Mistake::RateUnit, vec![candidate("rates in rad/s, taken for °/s", remedy)])
        }
        None => (Mistake::Turning, all.iter().take(SHOWN).flat_map(axes).collect()),
    };
    let best = all.iter().map(|hypothesis| hypothesis.left).fold(f64::INFINITY, f64::min);
    let found = format!(
        "over {seconds:.0} s of motion the gyro leaves {:.0} % of the turning of gravity unexplained; {} {:.1} %",
        100.0 * as_is,
        if all.len() > 1 {
            format!("{} other choices of axes or unit leave as little as", all.len())
        } else {
            "one other choice leaves".into()
        },
        100.0 * best
    );
    Finding { mistake, found, candidates }
}

fn axes(Hypothesis { axes, scale, .. }: &Hypothesis) -> Vec<Candidate> {
    let rows = |matrix: &Matrix3<f64>| {
        let row = |row: usize| format!("[{}, {}, {}]", matrix[(row, 0)], matrix[(row, 1)], matrix[(row, 2)]);
        format!("[{}, {}, {}]", row(0), row(1), row(2))
    };
    let also = if *scale == 1.0 { "" } else { ", and its unit is wrong as well" };
    let gyro = candidate(
        format!("the gyro's axes x, y, z are {}{also}", names(axes)),
        format!("`ingest.calibration.gyro.matrix = {}` in the launch file", rows(&(axes * *scale))),
    );
    let turned = axes.transpose() * axes.determinant().signum();
    if axes == &-Matrix3::identity() {
        let left_handed = candidate(
            "all axes are left-handed, as of a frame with one axis mirrored",
            "negate the mirrored axis of accelerometer and magnetometer, and the other two of the gyro, by `scale` in `ingest.calibration`",
        );
        return vec![left_handed, gyro];
    }
    let accel = candidate(
        format!("or the accelerometer's are {}", names(&turned)),
        format!("`ingest.calibration.accel.matrix = {}` in the launch file", rows(&turned)),
    );
    if *scale == 1.0 { vec![gyro, accel] } else { vec![gyro] }
}

/// Which of a sensor's axes are the body's x, y and z.
fn names(axes: &Matrix3<f64>) -> String {
    let name = |row: usize| {
        let column = (0..3).find(|column| axes[(row, *column)] != 0.0).unwrap_or(row);
        format!("{}{}", if axes[(row, column)] < 0.0 { "−" } else { "" }, ["x", "y", "z"][column])
    };
    format!("its {}, {}, {}", name(0), name(1), name(2))
}

/// `along` is the mean cosine of the angle between force and field.
pub(crate) fn upside_down(force: [f64; 3], along: Option<f64>) -> Finding {
    /// A field less inclined says nothing of up and down: the cosine of 81°, as within 5° of the magnetic equator.
    const INCLINED: f64 = 0.15;
    let frd = candidate(
        "axes forward, right, down (FRD, NED)",
        "`ingest.mounting.axes = \"frd\"` in the launch file, or `--frame frd` of `plumb import`",
    );
    let mounted = candidate("a sensor mounted upside down", "`ingest.mounting.roll_deg = 180` in the launch file");
    let negated = candidate("a negated accelerometer (it says −g at rest)", scaled("accel", -1.0));
    let real = candidate("a body that really is upside down", "nothing");
    let [x, y, z] = force;
    let seen = format!("the force is ({x:.2}, {y:.2}, {z:.2}) m/s²: up is below the body");
    let (found, candidates) = match along {
        Some(along) if along > INCLINED => (
            format!(
                "{seen}; the field points along the force (cosine {along:.2}), which on the northern half of the earth only a negated force does"
            ),
            vec![negated, frd, mounted, real],
        ),
        Some(along) if along < -INCLINED => (
            format!(
                "{seen}; the field points against the force (cosine {along:.2}), as it should on the northern half of the earth"
            ),
            vec![frd, mounted, real, negated],
        ),
        _ => (format!("{seen}; at rest these look the same"), vec![frd, mounted, negated, real]),
    };
    Finding { mistake: Mistake::UpsideDown, found, candidates }
}

pub(crate) fn stuck(quantity: &str, sensor: &str, axes: &[usize], samples: u64) -> Finding {
    let names: Vec<_> = axes.iter().map(|axis| ["x", "y", "z"][*axis]).collect();
    let mistake = if quantity == "rate" { Mistake::RateStuck } else { Mistake::ForceStuck };
    let found = format!(
        "{} of the {quantity} is the same to the last bit in {samples} samples, while others change",
        names.join(", ")
    );
    let remedy = format!(
        "see the wiring and the driver of the {sensor}; in `--map` of `plumb import` each axis needs its own column"
    );
    Finding { mistake, found, candidates: vec![candidate("an axis that is dead, or not read", remedy)] }
}

pub(crate) fn clipped(quantity: &str, sensor: &str, axis: usize, at: f64, runs: u32) -> Finding {
    let name = ["x", "y", "z"][axis];
    let (mistake, key, value) = match quantity {
        "rate" => (Mistake::RateClipped, "rate_max_deg_s", at.to_degrees()),
        _ => (Mistake::ForceClipped, "force_max_g", at / GRAVITY_M_S2),
    };
    let found = format!("{name} of the {quantity} stood at its end {at:.3} in {runs} runs, while the others changed");
    let remedy = format!("set a larger range in the {sensor}, or tell its range: `ingest.limits.{key} = {value:.1}`");
    Finding { mistake, found, candidates: vec![candidate("a range that is too small", remedy)] }
}
