//! S3: improved orientation of a UAV by a MEMS inertial system on the basis of the Madgwick filter.

mod runs;

use attitude::{Quaternion, fuser::Fuser, metrics::AttitudeError};
use figures::{
    Axis, Chart, Curve,
    style::{BLUE, GREEN, LineStyle, ORANGE, PURPLE},
};
use plotters::style::{BLACK, RGBColor};

use crate::{
    Progress,
    picture::{Figure, Panel, Part, Picture, drawings},
    table::Table,
};
pub use runs::{Comparison, Rms};
use runs::{Filter, IMPROVED, ORIGINAL, SEEDS, Sample, SensorCase, TABLE_CASES, run};

/// Panels of figure 2: file name, title and sensor errors.
const FIGURES: [(&str, &str, SensorCase); 3] = [
    ("figure-2a", "Figure 2 a: ideal accelerometer and magnetometer", SensorCase::Ideal),
    ("figure-2b", "Figure 2 b: accelerometer noise", SensorCase::AccelNoise),
    ("figure-2c", "Figure 2 c: no accelerometer noise, magnetic disturbance", SensorCase::MagneticDisturbance),
];

/// Number of simulation runs: the cases of the table, the panels of figure 2, and one pass over all
/// stages.
pub(crate) const RUN_COUNT: u64 = (TABLE_CASES.len() + FIGURES.len() + 1) as u64;

/// Published values for each axis: RMS errors of the original and of the improved filter in
/// degrees, and the improvement in %.
const PUBLISHED: [(&str, f64, f64, f64); 3] =
    [("pitch", 1.9371, 0.9986, 48.7), ("roll", 0.3502, 0.2410, 33.12), ("yaw", 1.8198, 0.9465, 47.99)];

/// Returns figures 1 and 2 and the tables.
pub(crate) fn parts(progress: &mut Progress<'_>) -> Vec<Part> {
    let mut parts = vec![block_diagram()];
    for (name, title, sensors) in FIGURES {
        parts.push(figure(name, title, sensors));
        progress.step();
    }
    let comparisons = TABLE_CASES.map(|case| {
        let comparison = Comparison::run(case);
        progress.step();
        comparison
    });
    parts.push(published_table());
    parts.push(by_axis(&comparisons));
    parts.push(totals(&comparisons));
    parts.push(all_stages());
    progress.step();
    parts
}

drawings! {
    "s3":
    block_diagram = "figure-1",
        "Figure 1: block diagram of the filter",
        "Stages madgwick and madgwick-improved. Here q_g is the exact rotation from the gyro slot, of which (1) is a first-order (Euler) step.";
}

/// Returns quaternions over time. The sign of each quaternion is chosen so that it is close to the
/// previous quaternion.
fn continuous_quaternions(samples: &[Sample], value: fn(&Sample) -> Quaternion<f64>) -> Vec<(f64, [f64; 4])> {
    let mut previous = Quaternion::new(1.0, 0.0, 0.0, 0.0);
    let next = |sample: &Sample| {
        let q = value(sample);
        let q = if q.dot(&previous) < 0.0 { -q } else { q };
        previous = q;
        (sample.t_s, [q.w, q.i, q.j, q.k])
    };
    samples.iter().map(next).collect()
}

/// Largest step between plotted values of an Euler angle, degrees. Larger steps are due to wrapping
/// or to the singularity, so the curve is broken there.
const MAX_STEP_DEG: f64 = 150.0;

fn figure(name: &'static str, title: &str, sensors: SensorCase) -> Part {
    let [original, improved] = [ORIGINAL, IMPROVED].map(|filter| run(filter, sensors, 1).unwrap_or_default());
    let time = || Axis::new("time, s", 0.0..19.0);
    let chart =
        |title: &str, y, curves| Panel::Chart(Chart { title: title.into(), x: time(), y, curves, has_legend: true });
    let line = |name: &str, color: RGBColor, style, values: &[(f64, f64)]| {
        Curve::over_time(name, color, style, values, MAX_STEP_DEG)
    };
    let estimated = continuous_quaternions(&improved, |sample| sample.estimate.quaternion());
    let truth = continuous_quaternions(&improved, |sample| sample.truth.quaternion());
    let component = |q: &[(f64, [f64; 4])], i: usize| q.iter().map(|(t_s, q)| (*t_s, q[i])).collect::<Vec<_>>();
    let names = [("q0", BLUE), ("q1", ORANGE), ("q2", GREEN), ("q3", PURPLE)];
    let mut quaternions: Vec<_> =
        (0..4).map(|i| line(names[i].0, names[i].1, LineStyle::Thick, &component(&estimated, i))).collect();
    quaternions
        .extend((0..4).map(|i| line(if i == 0 { "true" } else { "" }, BLACK, LineStyle::Thin, &component(&truth, i))));
    let angle = |attitude: fn(&Sample) -> attitude::state::Attitude, i: usize| -> Vec<_> {
        let angles = |sample: &Sample| {
            let angles = attitude(sample).angles();
            [angles.pitch_rad, angles.roll_rad, angles.yaw_rad][i].to_degrees()
        };
        improved.iter().map(|sample| (sample.t_s, angles(sample))).collect()
    };
    let names = [("pitch", BLUE), ("roll", ORANGE), ("yaw", GREEN)];
    let mut euler: Vec<_> =
        (0..3).map(|i| line(names[i].0, names[i].1, LineStyle::Thick, &angle(|sample| sample.estimate, i))).collect();
    euler.extend(
        (0..3)
            .map(|i| line(if i == 0 { "true" } else { "" }, BLACK, LineStyle::Thin, &angle(|sample| sample.truth, i))),
    );
    let error = |samples: &[Sample], pick: fn(AttitudeError) -> f64| -> Vec<_> {
        let value = |m: &Sample| pick(AttitudeError::between(m.estimate.quaternion(), m.truth.quaternion()));
        samples.iter().map(|sample| (sample.t_s, value(sample))).collect()
    };
    let total = |error: AttitudeError| error.total_deg;
    let max_deg = if sensors == SensorCase::MagneticDisturbance { 12.0 } else { 1.0 };
    let panels = vec![
        chart("quaternion, improved", Axis::new("component", -1.0..1.0), quaternions),
        chart("Euler angles, improved", Axis::new("angle, °", -200.0..200.0), euler),
        chart(
            "total error",
            Axis::new("error, °", 0.0..max_deg),
            vec![
                line("original", PURPLE, LineStyle::Thick, &error(&original, total)),
                line("improved", BLUE, LineStyle::Thick, &error(&improved, total)),
            ],
        ),
        chart(
            "improved: components of the error",
            Axis::new("error, °", 0.0..max_deg),
            vec![
                line("heading", GREEN, LineStyle::Thick, &error(&improved, |error| error.heading_deg)),
                line("inclination", ORANGE, LineStyle::Thick, &error(&improved, |error| error.inclination_deg)),
            ],
        ),
    ];
    let [original, improved] = [&original, &improved].map(|samples| Rms::from_samples(samples));
    let heading = |rms: &Rms| rms.heading_deg.unwrap_or(f64::NAN);
    let mut caption = format!(
        "Full turns of 1 rad/s about ξ, η and ζ, gyro noise 1 °/s, one seed. Total RMS: original {:.3}°, improved {:.3}°; heading {:.3}° and {:.3}°, inclination {:.3}° and {:.3}°. The Euler angles jump at ±180° and where pitch is ±90°.",
        original.total_deg,
        improved.total_deg,
        heading(&original),
        heading(&improved),
        original.inclination_deg,
        improved.inclination_deg
    );
    if sensors == SensorCase::MagneticDisturbance {
        caption += " The disturbance is a field of 20 µT to the east, as strong as the field to the north, from 2 to 4 s of each turn. The paper states that it affects yaw alone. Here it affects heading most, but inclination too, because the correction along the gradient of a field that points 66° down is not a rotation about the vertical. With stages that estimate heading and inclination separately (wz, vqf) it does affect yaw alone; see the table of all fusers.";
    }
    Part {
        name,
        title: title.into(),
        caption,
        picture: Picture::Figure(Figure { size: (1300, 800), columns: 2, panels }),
    }
}

fn published_table() -> Part {
    let row = |(axis, original, improved, printed): (&str, f64, f64, f64)| {
        let gain = 100.0 * (1.0 - improved / original);
        vec![
            axis.into(),
            format!("{original:.4}"),
            format!("{improved:.4}"),
            format!("{printed} %"),
            format!("{gain:.1} %"),
        ]
    };
    Part {
        name: "table-1-printed",
        title: "Table 1 as printed: RMS errors by axis".into(),
        caption: "The paper gives its errors in rad/s (sic). β = 0.021 original, 0.029 improved. The printed gains differ slightly from those of the printed errors.".into(),
        picture: Picture::Table(Table::new(
            &["axis", "original", "improved", "gain as printed", "gain of these errors"],
            PUBLISHED.map(row).into(),
        )),
    }
}

fn case_label(comparison: &Comparison) -> String {
    let noise = if comparison.printed_gyro_noise { "1 rad/s" } else { "1 °/s" };
    let start = if comparison.noisy_start { "noisy" } else { "exact" };
    format!("gyro {noise}, first sample {start}")
}

fn gain(original: f64, improved: f64) -> String {
    format!("{:+.1} %", 100.0 * (1.0 - improved / original)).replace('-', "−")
}

fn by_axis(comparisons: &[Comparison]) -> Part {
    let mut rows = Vec::new();
    for comparison in comparisons {
        for (axis, (name, ..)) in PUBLISHED.iter().enumerate() {
            let (original, improved) = (&comparison.original, &comparison.improved);
            let cells = |original: [f64; 3], improved: [f64; 3]| {
                let (original, improved) = (original[axis], improved[axis]);
                [format!("{original:.3}"), format!("{improved:.3}"), gain(original, improved)]
            };
            let angles = cells(original.angles_deg, improved.angles_deg);
            let vector = cells(original.vector_deg, improved.vector_deg);
            let label = format!("{}: {name}", case_label(comparison));
            rows.push([label].into_iter().chain(angles).chain(vector).collect());
        }
    }
    Part {
        name: "table-1",
        title: "Table 1, ours: RMS errors by axis, degrees".into(),
        caption: format!(
            "Mean of {SEEDS} seeds with all noise: accelerometer and magnetometer 0.03, gyro 1 °/s and, as printed, 1 rad/s. Differences of the Euler angles become very large near pitch ±90°. The rotation vector, about the axes of pitch, roll and yaw, does not. In the paper's angles, too, two axes have a large error and one a small error. A negative gain is a loss."
        ),
        picture: Picture::Table(Table::new(
            &["noise: axis", "angles: original", "improved", "gain", "vector: original", "improved", "gain"],
            rows,
        )),
    }
}

fn totals(comparisons: &[Comparison]) -> Part {
    let row = |comparison: &Comparison| {
        let (original, improved) = (&comparison.original, &comparison.improved);
        let heading = [original, improved].map(|rms| rms.heading_deg.unwrap_or(f64::NAN));
        let total = [original.total_deg, improved.total_deg];
        let inclination = [original.inclination_deg, improved.inclination_deg];
        let cells = [total, heading, inclination].into_iter().flat_map(|[original, improved]| {
            [format!("{original:.3}"), format!("{improved:.3}"), gain(original, improved)]
        });
        [case_label(comparison)].into_iter().chain(cells).collect()
    };
    Part {
        name: "table-1-total",
        title: "Table 1, ours: total error, heading and inclination, RMS in degrees".into(),
        caption: "Starting from the true attitude, the improved form is about a third better. Starting from a noisy first sample, it is worse: its step is proportional to the error and with this low gain needs 1/(4β) = 8.6 s to converge, while the original takes steps of fixed size. With the gyro noise as printed, 1 rad/s, that noise dominates and the two forms are equal.".into(),
        picture: Picture::Table(Table::new(
            &["noise", "total: original", "improved", "gain", "heading: original", "improved", "gain", "inclination: original", "improved", "gain"],
            comparisons.iter().map(row).collect(),
        )),
    }
}

fn all_stages() -> Part {
    let filter = |name: &'static str| {
        [ORIGINAL, IMPROVED].into_iter().find(|filter| filter.name == name).unwrap_or(Filter { name, gain: None })
    };
    let row = |name: &'static str| {
        let cells = FIGURES.iter().flat_map(|(.., sensors)| {
            let rms = Rms::from_samples(&run(filter(name), *sensors, 1).unwrap_or_default());
            [rms.heading_deg.map_or("–".into(), |deg| format!("{deg:.3}")), format!("{:.3}", rms.inclination_deg)]
        });
        [name.into()].into_iter().chain(cells).collect()
    };
    Part {
        name: "table-stages",
        title: "Table: all fusers in the three parts of figure 2, RMS in degrees".into(),
        caption: "The two stages of the paper have the gains of the paper, the others their defaults; one seed. A stage without a magnetometer input has no north reference (–).".into(),
        picture: Picture::Table(Table::new(
            &["stage", "a: heading", "inclination", "b: heading", "inclination", "c: heading", "inclination"],
            Fuser::NAMES.map(row).into(),
        )),
    }
}
