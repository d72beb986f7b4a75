//! Diagnoses. Each contains the issue, its evidence in figures, and possible causes with remedies,
//! likeliest first.

use core::fmt;

use attitude::{GRAVITY_M_S2, Matrix3};

/// Issue with the input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InputIssue {
    /// Rates are not in rad/s.
    RateUnit,
    /// Forces are not in m/s².
    ForceUnit,
    /// Gravity is missing from the force.
    GravityRemoved,
    /// Magnetic fields are not in µT.
    FieldUnit,
    /// Times are not in the declared unit.
    TimeUnit,
    /// Timestamps repeat, go back or jump.
    Timestamps,
    /// The gyro disagrees with the rotation of gravity: wrong axes or signs.
    AxesMismatch,
    /// Gravity constantly points out of the top of the body.
    UpsideDown,
    /// An axis of the gyro is stuck.
    RateStuck,
    /// An axis of the accelerometer is stuck.
    ForceStuck,
    /// An axis of the magnetometer is stuck.
    FieldStuck,
    /// An axis of the gyro is clipped at the limit of its range.
    RateClipped,
    /// An axis of the accelerometer is clipped at the limit of its range.
    ForceClipped,
}

/// Possible cause of an issue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PossibleCause {
    /// Description of the cause.
    pub cause: String,
    /// Remedy, with lines to paste if there are any.
    pub remedy: String,
}

/// Detected issue with evidence and possible causes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnosis {
    /// Kind of issue.
    pub issue: InputIssue,
    /// Evidence in figures.
    pub evidence: String,
    /// Possible causes, likeliest first.
    pub causes: Vec<PossibleCause>,
}

impl InputIssue {
    /// Returns `true` if the issue follows from comparing the gyro with gravity.
    pub(crate) fn is_gyro_mismatch(self) -> bool {
        matches!(self, Self::RateUnit | Self::AxesMismatch)
    }

    /// Returns the name of the issue in warnings, such as `rate-unit`.
    pub fn name(self) -> &'static str {
        match self {
            Self::RateUnit => "rate-unit",
            Self::ForceUnit => "force-unit",
            Self::GravityRemoved => "gravity-removed",
            Self::FieldUnit => "field-unit",
            Self::TimeUnit => "time-unit",
            Self::Timestamps => "timestamps",
            Self::AxesMismatch => "axes-mismatch",
            Self::UpsideDown => "upside-down",
            Self::RateStuck => "rate-stuck",
            Self::ForceStuck => "force-stuck",
            Self::FieldStuck => "field-stuck",
            Self::RateClipped => "rate-clipped",
            Self::ForceClipped => "force-clipped",
        }
    }
}

impl Diagnosis {
    /// Returns all causes with their remedies on one line.
    pub fn remedies(&self) -> String {
        let all: Vec<_> =
            self.causes.iter().map(|PossibleCause { cause, remedy }| format!("{cause}: {remedy}")).collect();
        all.join("; or ")
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.issue.name(), self.evidence)?;
        self.causes.iter().try_for_each(|PossibleCause { cause, remedy }| write!(f, "\n    {cause}: {remedy}"))
    }
}

fn cause(cause: impl Into<String>, remedy: impl Into<String>) -> PossibleCause {
    PossibleCause { cause: cause.into(), remedy: remedy.into() }
}

/// Returns a launch-file line that scales a sensor by `factor`.
fn scale_remedy(sensor: &str, factor: f64) -> String {
    format!("`ingest.calibration.{sensor}.scale = [{factor}, {factor}, {factor}]` in the launch file")
}

/// Returns the `plumb import` option for a unit, with the launch-file line as the alternative.
fn unit_remedy(sensor: &str, factor: f64, unit: &str) -> String {
    format!("`--units {unit}` of `plumb import`, or {}", scale_remedy(sensor, factor))
}

/// Factor from °/s to rad/s, rounded for display in a remedy.
const DEGREE_RAD: f64 = 0.017_453_292_52;

pub(crate) fn rates_out_of_range(clipped: u64, implausible: u64) -> Diagnosis {
    let evidence =
        format!("{clipped} rates are at or beyond rate_max_deg_s, and {implausible} were rejected as implausible");
    let causes = vec![cause("rates in °/s", unit_remedy("gyro", DEGREE_RAD, "deg/s"))];
    Diagnosis { issue: InputIssue::RateUnit, evidence, causes }
}

/// Creates the diagnosis of forces that were rejected as implausible.
pub(crate) fn rejected_forces(count: u64) -> Diagnosis {
    let evidence = format!("{count} forces were rejected: ten times force_max_g or more, or not finite");
    let remedy =
        "accept them with `ingest.limits.force_max_g = 10000` in the launch file; the next run names the scale";
    let causes = vec![cause("raw converter counts, or another unit", remedy)];
    Diagnosis { issue: InputIssue::ForceUnit, evidence, causes }
}

/// Creates the diagnosis of an accelerometer that measures nothing.
fn dead_accelerometer() -> Diagnosis {
    let evidence = "the force is zero, at rest it is 9.81 m/s²".to_owned();
    let remedy = "check the wiring and the driver of the accelerometer; choose another sensor of the log with --imu";
    let causes = vec![cause("a dead accelerometer, or one that is not read", remedy)];
    Diagnosis { issue: InputIssue::ForceStuck, evidence, causes }
}

/// Creates the diagnosis of a wrong rate unit. In `windows` windows of length `window_s`, the gyro
/// measured a large rotation, but the force hardly rotated in body axes.
pub(crate) fn unobserved_rotation(windows: u32, window_s: f64) -> Diagnosis {
    let evidence = format!(
        "{windows} times within {window_s} s the gyro reported ten times the rotation the accelerometer saw (> 57°)"
    );
    let causes = vec![cause("rates in °/s", unit_remedy("gyro", DEGREE_RAD, "deg/s"))];
    Diagnosis { issue: InputIssue::RateUnit, evidence, causes }
}

pub(crate) fn time_unit(median_s: f64, leaps: u64, samples: u64) -> Diagnosis {
    let import =
        |unit: &str| format!("`--units {unit}` of `plumb import`; a driver on the bus sends t_sensor_ns in ns");
    let causes = match median_s {
        // After a clock leap, ingest continues with the usual sample interval, so a median below
        // 0.6 s does not reveal the unit.
        _ if leaps * 2 > samples && !(0.6..).contains(&median_s) => {
            let remedy = "`--units ms` or `--units us` of `plumb import`; a driver on the bus sends t_sensor_ns in ns, increasing with each reading";
            vec![cause("constant timestamps, or timestamps in another unit", remedy)]
        }
        // Read as ms, these intervals belong to sensors that sample at 20 Hz to 1.7 kHz.
        0.6..50.0 => vec![
            cause("times in ms, read as s", import("ms")),
            cause("times in µs, read as ms", import("us")),
            cause("a very slow sensor", "too slow to keep an attitude: sample at 50 Hz or faster"),
        ],
        // No sensor is sampled once a minute, so the times are in µs or ns.
        50.0.. => vec![cause("times in µs, read as s", import("us")), cause("times in ns, read as ms", import("ns"))],
        _ => vec![
            cause("times in s, read as ms or a smaller unit", import("s")),
            cause("times in µs, read as ns", import("us")),
        ],
    };
    let evidence =
        format!("the median sample interval is {median_s:.2e} s, and {leaps} of {samples} timestamps jump or go back");
    Diagnosis { issue: InputIssue::TimeUnit, evidence, causes }
}

pub(crate) fn timestamps(rejected: u64, leaps: u64, samples: u64) -> Diagnosis {
    let evidence = format!(
        "repeated or out-of-order readings were rejected before {rejected} of {samples} samples, and {leaps} timestamps stalled, jumped or went back"
    );
    let causes = vec![
        cause("an unsorted recording, or one with duplicate rows", "sort the rows by time and remove duplicates"),
        cause("timestamps taken on arrival at the host, or from an adjusted clock", "use the sensor's own timestamps"),
    ];
    Diagnosis { issue: InputIssue::Timestamps, evidence, causes }
}

pub(crate) fn force_magnitude(low: f64, median: f64, high: f64, is_steady: bool) -> Diagnosis {
    /// Force below which an accelerometer is considered dead, m/s². Less than 0.1 mg is below the
    /// noise of any working accelerometer.
    const DEAD_M_S2: f64 = 1e-6;
    if high < DEAD_M_S2 {
        return dead_accelerometer();
    }
    let evidence = format!(
        "the force is {median:.3} m/s² (median; 10 to 90 %: {low:.3} to {high:.3}), at rest it is {GRAVITY_M_S2:.2} m/s²"
    );
    let per_g = median / GRAVITY_M_S2;
    let gravity_removed = cause(
        "gravity is removed from the force (\"linear\" or \"user\" acceleration)",
        "record the raw accelerometer; on a phone choose \"Accelerometer\" with gravity, not \"Linear Acceleration\"",
    );
    let in_g = cause("forces in g", unit_remedy("accel", GRAVITY_M_S2, "g"));
    let (issue, causes) = match (median, per_g) {
        // A value near 1 at rest means that the unit is g. The range allows for scale errors. In
        // motion a wider range is needed, but a force without gravity can also be in that range.
        (0.85..1.2, _) if is_steady => (InputIssue::ForceUnit, vec![in_g]),
        (0.7..1.4, _) => (InputIssue::ForceUnit, vec![in_g, gravity_removed]),
        // The long-term mean force on any body near the Earth is larger than 0.5 g. A smaller mean
        // force indicates that gravity is missing or the scale is wrong.
        (_, ..0.5) => (
            InputIssue::GravityRemoved,
            vec![gravity_removed, cause("a wrong scale", scale_remedy("accel", per_g.recip()))],
        ),
        // The force is too large by a factor of 9.8. The range allows for scale errors.
        (_, 8.0..12.0) => {
            (InputIssue::ForceUnit, vec![cause("m/s² read as g", unit_remedy("accel", GRAVITY_M_S2.recip(), "m/s2"))])
        }
        // A value near 1000 at rest means that the unit is a thousandth of g. The range allows for
        // scale errors.
        (850.0..1200.0, _) => (
            InputIssue::ForceUnit,
            vec![cause("forces in thousandths of g", unit_remedy("accel", GRAVITY_M_S2 / 1000.0, "mg"))],
        ),
        _ => (
            InputIssue::ForceUnit,
            vec![cause("a wrong scale, such as raw converter counts", scale_remedy("accel", per_g.recip()))],
        ),
    };
    Diagnosis { issue, evidence, causes }
}

pub(crate) fn field_unit(median_ut: f64) -> Option<Diagnosis> {
    // Ranges of the Earth's magnetic field, 22 to 67 µT, in each unit, widened to allow for the
    // effect of iron. Values between the ranges are not diagnosed.
    let (text, factor, unit) = match median_ut {
        0.15..1.0 => ("fields in gauss", 100.0, "gauss"),
        0.015..0.1 => ("fields in mT", 1e3, "mT"),
        150.0..1000.0 => ("fields in thousandths of gauss", 0.1, "mgauss"),
        8e3..240e3 => ("fields in nT", 1e-3, "nT"),
        15e-6..100e-6 => ("fields in T", 1e6, "T"),
        _ => return None,
    };
    let remedy = unit_remedy("mag", factor, unit);
    let evidence = format!("the field is {median_ut:.3e} µT (median), the Earth's field is 22 to 67 µT");
    Some(Diagnosis { issue: InputIssue::FieldUnit, evidence, causes: vec![cause(text, remedy)] })
}

pub(crate) fn rejected_fields(count: u64) -> Diagnosis {
    let evidence =
        format!("{count} samples of the magnetic field were rejected: at or beyond field_max_ut, or not finite");
    // If a ROS topic uses a unit other than tesla, its magnetic field exceeds the limit.
    let causes = vec![
        cause("fields in nT", unit_remedy("mag", 1e-3, "nT")),
        cause("fields in gauss on a ROS topic, whose unit is tesla", unit_remedy("mag", 1e-4, "gauss")),
        cause("fields in µT on a ROS topic", unit_remedy("mag", 1e-6, "uT")),
    ];
    Diagnosis { issue: InputIssue::FieldUnit, evidence, causes }
}

/// Hypothesis that the true rate is `scale * axes` times the measured one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hypothesis {
    pub(crate) axes: Matrix3<f64>,
    pub(crate) scale: f64,
    /// Spread that remains under the hypothesis, as a share of the spread in body axes.
    pub(crate) residual: f64,
}

/// Creates the diagnosis of wrong axes or a wrong unit of the gyro. `all` contains the hypotheses
/// that fit. Those that change the axes and the unit least come first.
pub(crate) fn gyro_mismatch(unchanged: f64, seconds: f64, all: &[Hypothesis]) -> Diagnosis {
    /// Maximum number of hypotheses shown. The hypotheses differ only in the axes about which the
    /// body has not rotated.
    const SHOWN: usize = 3;
    let unit_only = all.iter().find(|hypothesis| hypothesis.axes == Matrix3::identity());
    let (issue, causes) = match unit_only {
        Some(Hypothesis { scale, .. }) if *scale < 1.0 => {
            (InputIssue::RateUnit, vec![cause("rates in °/s", unit_remedy("gyro", DEGREE_RAD, "deg/s"))])
        }
        Some(_) => {
            let remedy = unit_remedy("gyro", 57.295_78, "rad/s");
            (InputIssue::RateUnit, vec![cause("rates in rad/s, read as °/s", remedy)])
        }
        None => (InputIssue::AxesMismatch, all.iter().take(SHOWN).flat_map(axes_causes).collect()),
    };
    let best = all.iter().map(|hypothesis| hypothesis.residual).fold(f64::INFINITY, f64::min);
    let evidence = format!(
        "over {seconds:.0} s of motion the gyro leaves {:.0} % of the rotation of gravity unexplained; {} {:.1} %",
        100.0 * unchanged,
        if all.len() > 1 {
            format!("{} other choices of axes or unit leave as little as", all.len())
        } else {
            "one other choice of axes or unit leaves".into()
        },
        100.0 * best
    );
    Diagnosis { issue, evidence, causes }
}

fn axes_causes(Hypothesis { axes, scale, .. }: &Hypothesis) -> Vec<PossibleCause> {
    let rows = |matrix: &Matrix3<f64>| {
        let row = |row: usize| format!("[{}, {}, {}]", matrix[(row, 0)], matrix[(row, 1)], matrix[(row, 2)]);
        format!("[{}, {}, {}]", row(0), row(1), row(2))
    };
    let unit = if *scale == 1.0 { "" } else { ", in a wrong unit" };
    let gyro = cause(
        format!("the body's x, y, z are the gyro's {}{unit}", axis_names(axes)),
        format!("`ingest.calibration.gyro.matrix = {}` in the launch file", rows(&(axes * *scale))),
    );
    let inverse = axes.transpose() * axes.determinant().signum();
    if axes == &-Matrix3::identity() {
        let left_handed = cause(
            "left-handed axes: one axis of the sensor frame is mirrored",
            "negate the mirrored axis of accelerometer and magnetometer, and the other two axes of the gyro, with `scale` in `ingest.calibration`",
        );
        return vec![left_handed, gyro];
    }
    let accel = cause(
        format!("or the body's x, y, z are the accelerometer's {}", axis_names(&inverse)),
        format!("`ingest.calibration.accel.matrix = {}` in the launch file", rows(&inverse)),
    );
    if *scale == 1.0 { vec![gyro, accel] } else { vec![gyro] }
}

/// Returns the names of the sensor axes that form the body's x, y and z axes.
fn axis_names(axes: &Matrix3<f64>) -> String {
    let name = |row: usize| {
        let column = (0..3).find(|column| axes[(row, *column)] != 0.0).unwrap_or(row);
        format!("{}{}", if axes[(row, column)] < 0.0 { "−" } else { "" }, ["x", "y", "z"][column])
    };
    format!("{}, {}, {}", name(0), name(1), name(2))
}

/// Creates the diagnosis of a body that is constantly upside down. `mean_cosine` is the mean cosine
/// of the angle between force and magnetic field.
pub(crate) fn upside_down(force: [f64; 3], mean_cosine: Option<f64>) -> Diagnosis {
    /// Minimum |cosine| of the angle between force and magnetic field for distinguishing up from
    /// down. It corresponds to 81°. The angle is larger only within 5° of the magnetic equator.
    const INCLINED: f64 = 0.15;
    let frd = cause(
        "axes forward, right, down (FRD, NED)",
        "`ingest.mounting.axes = \"frd\"` in the launch file, or `--frame frd` of `plumb import`",
    );
    let mounted = cause("a sensor mounted upside down", "`ingest.mounting.roll_deg = 180` in the launch file");
    let negated = cause("a negated accelerometer (it reads −g at rest)", scale_remedy("accel", -1.0));
    let inverted_body = cause("a body that is upside down", "nothing to change");
    let [x, y, z] = force;
    let force_text = format!("the force is ({x:.2}, {y:.2}, {z:.2}) m/s²: up points out of the body's bottom");
    let (evidence, causes) = match mean_cosine {
        Some(mean_cosine) if mean_cosine > INCLINED => (
            format!(
                "{force_text}; the field points along the force (cosine {mean_cosine:.2}), which in the northern hemisphere indicates a negated force"
            ),
            vec![negated, frd, mounted, inverted_body],
        ),
        Some(mean_cosine) if mean_cosine < -INCLINED => (
            format!(
                "{force_text}; the field points against the force (cosine {mean_cosine:.2}), as expected in the northern hemisphere"
            ),
            vec![frd, mounted, inverted_body, negated],
        ),
        _ => (format!("{force_text}; at rest these causes look the same"), vec![frd, mounted, negated, inverted_body]),
    };
    Diagnosis { issue: InputIssue::UpsideDown, evidence, causes }
}

pub(crate) fn stuck(quantity: &str, sensor: &str, axes: &[usize], samples: u64) -> Diagnosis {
    let axis_names: Vec<_> = axes.iter().map(|axis| ["x", "y", "z"][*axis]).collect();
    let issue = match quantity {
        "rate" => InputIssue::RateStuck,
        "force" => InputIssue::ForceStuck,
        _ => InputIssue::FieldStuck,
    };
    let changing = if axes.len() < 3 { "other axes change" } else { "the body rotates" };
    let evidence =
        format!("{} of the {quantity} is constant over {samples} samples while {changing}", axis_names.join(", "));
    let remedy = format!(
        "check the wiring and the driver of the {sensor}; in `--map` of `plumb import` give each axis its own column"
    );
    Diagnosis { issue, evidence, causes: vec![cause("a dead axis, or one that is not read", remedy)] }
}

pub(crate) fn clipped(quantity: &str, sensor: &str, axis: usize, limit: f64, runs: u32) -> Diagnosis {
    let name = ["x", "y", "z"][axis];
    let (issue, key, value) = match quantity {
        "rate" => (InputIssue::RateClipped, "rate_max_deg_s", limit.to_degrees()),
        _ => (InputIssue::ForceClipped, "force_max_g", limit / GRAVITY_M_S2),
    };
    let evidence =
        format!("{name} of the {quantity} stays at its limit {limit:.3} in {runs} runs while other axes change");
    let remedy =
        format!("select a larger range in the {sensor}, or declare its range: `ingest.limits.{key} = {value:.1}`");
    Diagnosis { issue, evidence, causes: vec![cause("a measuring range that is too small", remedy)] }
}
