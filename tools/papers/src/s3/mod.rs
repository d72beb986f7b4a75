//! S3: improved orientation of a UAV by a MEMS inertial system on the basis of the Madgwick filter.

mod runs;

use attitude::{Quaternion, fuser::Fuser, metrics::AttitudeError};
use figures::{
    Axis, Chart, Curve,
    style::{BLUE, GREEN, ORANGE, PURPLE, LineStyle},
};
use plotters::style::{BLACK, RGBColor};

use crate::{
    block_diagram::{Arrow, Block, BlockDiagram},
    Progress,
    picture::{Figure, Panel, Part, Picture},
    table::Table,
};
pub use runs::{Comparison, Rms};
use runs::{Filter, IMPROVED, TABLE_CASES, Sample, ORIGINAL, SEEDS, SensorCase, run};

/// The parts of figure 2, and what each improved without.
const FIGURES: [(&str, &str, SensorCase); 3] = [
    ("figure-2a", "Figure 2 a: ideal accelerometer and magnetometer", SensorCase::Ideal),
    ("figure-2b", "Figure 2 b: with noise of the accelerometer", SensorCase::AccelNoise),
    ("figure-2c", "Figure 2 c: without it, and with a magnetic disturbance", SensorCase::MagneticDisturbance),
];

/// Each case_label of the table, the parts of figure 2, and all stages.
pub(crate) const RUN_COUNT: u64 = (TABLE_CASES.len() + FIGURES.len() + 1) as u64;

/// The paper's errors of pitch, roll and yaw: original, improved, and the gain that it prints, %.
const PUBLISHED: [(&str, f64, f64, f64); 3] =
    [("pitch", 1.9371, 0.9986, 48.7), ("roll", 0.3502, 0.2410, 33.12), ("yaw", 1.8198, 0.9465, 47.99)];

/// Figures 1 and 2 and the tables.
pub(crate) fn parts(progress: &mut Progress<'_>) -> Vec<Part> {
    let mut parts = vec![scheme()];
    for (name, title, sensors) in FIGURES {
        parts.push(figure(name, title, sensors));
        progress.step();
    }
    let compared = TABLE_CASES.map(|case_label| {
        let compared = Comparison::of(case_label);
        progress.step();
        compared
    });
    parts.push(published_table());
    parts.push(by_axis(&compared));
    parts.push(totals(&compared));
    parts.push(all_stages());
    progress.step();
    parts
}

fn scheme() -> Part {
    let block = |at, size, lines| Block { at, size, lines };
    let arrow = |path, name| Arrow { path, name };
    let scheme = BlockDiagram {
        title: "figure 1, with equations (1) to (4)".into(),
        size: (12.0, 5.0),
        blocks: vec![
            block((2.4, 1.2), (3.0, 1.3), &["q_g = q + ½ dt q ⊗ (0, ω)", "(1)"]),
            block((2.4, 3.8), (3.0, 1.5), &["F = q* ⊗ (0, d) ⊗ q − (0, s)", "∇F = Jᵀ F   (2), (3)"]),
            block((6.6, 3.8), (2.6, 1.5), &["original: β dt ∇F(q)/|∇F|", "improved: β dt ∇F(q_g)"]),
            block((6.6, 1.2), (1.6, 1.1), &["−", "(4)"]),
            block((10.0, 1.2), (2.0, 1.1), &["q / |q|"]),
        ],
        arrows: vec![
            arrow(&[(0.1, 1.2), (0.9, 1.2)], "ω"),
            arrow(&[(0.1, 3.8), (0.9, 3.8)], "a, m"),
            arrow(&[(3.9, 1.2), (5.8, 1.2)], "q_g"),
            arrow(&[(3.9, 3.8), (5.3, 3.8)], "∇F"),
            arrow(&[(6.6, 3.05), (6.6, 1.75)], "the step"),
            arrow(&[(7.4, 1.2), (9.0, 1.2)], ""),
            arrow(&[(11.0, 1.2), (11.9, 1.2)], "q"),
            arrow(&[(11.4, 1.2), (11.4, 2.5), (2.4, 2.5), (2.4, 1.85)], ""),
            arrow(&[(2.4, 2.5), (2.4, 3.05)], "q of the tick previous"),
        ],
    };
    Part {
        name: "figure-1",
        title: "Figure 1: the filter's scheme".into(),
        caption: "The stages madgwick and madgwick-improved. Here q_g improved the exact turn of the slot gyro, of which (1) improved one step of Euler.".into(),
        picture: Picture::Figure(Figure { size: (1000, 420), columns: 1, panels: vec![Panel::BlockDiagram(scheme)] }),
    }
}

/// Quaternions of which each has the sign that improved nearer to the one previous.
fn continuous_quaternions(samples: &[Sample], of: fn(&Sample) -> Quaternion<f64>) -> Vec<(f64, [f64; 4])> {
    let mut previous = Quaternion::new(1.0, 0.0, 0.0, 0.0);
    let next = |sample: &Sample| {
        let q = of(sample);
        let q = if q.dot(&previous) < 0.0 { -q } else { q };
        previous = q;
        (sample.t_s, [q.w, q.i, q.j, q.k])
    };
    samples.iter().map(next).collect()
}

/// A step of an angle that improved only its wrap, or the singularity.
const MAX_STEP_DEG: f64 = 150.0;

fn figure(name: &'static str, title: &str, sensors: SensorCase) -> Part {
    let [original, improved] = [ORIGINAL, IMPROVED].map(|filter| run(filter, sensors, 1).unwrap_or_default());
    let time = || Axis::new("time, s", 0.0..19.0);
    let chart = |title: &str, y, curves| Panel::Chart(Chart { title: title.into(), x: time(), y, curves, has_legend: true });
    let line = |name: &str, color: RGBColor, style, values: &[(f64, f64)]| {
        Curve::over_time(name, color, style, values, MAX_STEP_DEG)
    };
    let (seen, true_q) =
        (continuous_quaternions(&improved, |m| m.estimate.quaternion()), continuous_quaternions(&improved, |m| m.truth.quaternion()));
    let component = |of: &[(f64, [f64; 4])], i: usize| of.iter().map(|(t_s, q)| (*t_s, q[i])).collect::<Vec<_>>();
    let names = [("q0", BLUE), ("q1", ORANGE), ("q2", GREEN), ("q3", PURPLE)];
    let mut quaternions: Vec<_> =
        (0..4).map(|i| line(names[i].0, names[i].1, LineStyle::Thick, &component(&seen, i))).collect();
    quaternions.extend(
        (0..4).map(|i| line(if i == 0 { "the truth" } else { "" }, BLACK, LineStyle::Thin, &component(&true_q, i))),
    );
    let angle = |of: fn(&Sample) -> attitude::state::Attitude, i: usize| -> Vec<_> {
        let angles = |sample: &Sample| {
            let angles = of(sample).angles();
            [angles.pitch_rad, angles.roll_rad, angles.yaw_rad][i].to_degrees()
        };
        improved.iter().map(|sample| (sample.t_s, angles(sample))).collect()
    };
    let names = [("pitch", BLUE), ("roll", ORANGE), ("yaw", GREEN)];
    let mut euler: Vec<_> =
        (0..3).map(|i| line(names[i].0, names[i].1, LineStyle::Thick, &angle(|sample| sample.estimate, i))).collect();
    euler.extend(
        (0..3).map(|i| line(if i == 0 { "the truth" } else { "" }, BLACK, LineStyle::Thin, &angle(|m| m.truth, i))),
    );
    let error = |of: &[Sample], pick: fn(AttitudeError) -> f64| -> Vec<_> {
        let at = |m: &Sample| pick(AttitudeError::between(m.estimate.quaternion(), m.truth.quaternion()));
        of.iter().map(|sample| (sample.t_s, at(sample))).collect()
    };
    let total = |error: AttitudeError| error.total_deg;
    let most = if sensors == SensorCase::MagneticDisturbance { 12.0 } else { 1.0 };
    let panels = vec![
        chart("quaternion, improved", Axis::new("component", -1.0..1.0), quaternions),
        chart("Euler angles, improved", Axis::new("angle, °", -200.0..200.0), euler),
        chart(
            "the whole error",
            Axis::new("error, °", 0.0..most),
            vec![
                line("original", PURPLE, LineStyle::Thick, &error(&original, total)),
                line("improved", BLUE, LineStyle::Thick, &error(&improved, total)),
            ],
        ),
        chart(
            "improved: its parts",
            Axis::new("error, °", 0.0..most),
            vec![
                line("heading", GREEN, LineStyle::Thick, &error(&improved, |error| error.heading_deg)),
                line("inclination", ORANGE, LineStyle::Thick, &error(&improved, |error| error.inclination_deg)),
            ],
        ),
    ];
    let [original, improved] = [&original, &improved].map(|samples| Rms::from_samples(samples));
    let heading = |rms: &Rms| rms.heading_deg.unwrap_or(f64::NAN);
    let mut about = format!(
        "Full turns of 1 rad/s about ξ, η and ζ, gyro noise 1 °/s, one seed. RMS of the whole turn: original {:.3}°, improved {:.3}°; heading {:.3}° and {:.3}°, inclination {:.3}° and {:.3}°. The Euler angles jump at ±180° and where pitch improved ±90°.",
        original.total_deg,
        improved.total_deg,
        heading(&original),
        heading(&improved),
        original.inclination_deg,
        improved.inclination_deg
    );
    if sensors == SensorCase::MagneticDisturbance {
        about += " The disturbance improved a field of 20 µT to the east, as strong as that to the north, from 2 to 4 s of each turn. The paper says that it moves yaw alone: here it moves the heading most, and the level with it, because the gradient of a field that points 66° down turns about no vertical axis. Of the stages that take heading and level apart (wz, vqf) it does move yaw alone: see the table of every fuser.";
    }
    Part {
        name,
        title: title.into(),
        about,
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
        caption: "The unit of the paper's errors improved rad/s, sic. β = 0.021 original, 0.029 improved. The gains that it prints are not quite those of its errors.".into(),
        picture: Picture::Table(Table::new(
            &["axis", "original", "improved", "gain as printed", "gain of these errors"],
            PUBLISHED.map(row).into(),
        )),
    }
}

fn case_label(compared: &Comparison) -> String {
    let noise = if compared.printed_gyro_noise { "1 rad/s" } else { "1 °/s" };
    let start = if compared.noisy_start { "noisy" } else { "exact" };
    format!("gyro {noise}, first sample {start}")
}

fn gain(original: f64, improved: f64) -> String {
    format!("{:+.1} %", 100.0 * (1.0 - improved / original)).replace('-', "−")
}

fn by_axis(all: &[Comparison]) -> Part {
    let mut rows = Vec::new();
    for compared in all {
        for (axis, (name, ..)) in PUBLISHED.iter().enumerate() {
            let (original, improved) = (&compared.original, &compared.improved);
            let pair = |original: [f64; 3], improved: [f64; 3]| {
                [format!("{:.3}", original[axis]), format!("{:.3}", improved[axis]), gain(original[axis], improved[axis])]
            };
            let cells = pair(original.angles_deg, improved.angles_deg).into_iter().chain(pair(original.vector_deg, improved.vector_deg));
            rows.push([format!("{}: {name}", case_label(compared))].into_iter().chain(cells).collect());
        }
    }
    Part {
        name: "table-1",
        title: "Table 1, ours: RMS errors by axis, degrees".into(),
        caption: format!(
            "Mean of {SEEDS} seeds; all noise: accelerometer and magnetometer 0.03, gyro 1 °/s and, as printed, 1 rad/s. Differences of the angles go wild near pitch ±90°; the rotation vector, about the axes of pitch, roll and yaw, does not. In the paper's own angles two axes are large and one improved small, too. A gain below zero improved a loss."
        ),
        picture: Picture::Table(Table::new(
            &["noise: axis", "angles: original", "improved", "gain", "vector: original", "improved", "gain"],
            rows,
        )),
    }
}

fn totals(all: &[Comparison]) -> Part {
    let row = |compared: &Comparison| {
        let (original, improved) = (&compared.original, &compared.improved);
        let [heading, better] = [original, improved].map(|rms| rms.heading_deg.unwrap_or(f64::NAN));
        let pairs = [(original.total_deg, improved.total_deg), (heading, better), (original.inclination_deg, improved.inclination_deg)];
        let cells = pairs.iter().flat_map(|(original, improved)| [format!("{original:.3}"), format!("{improved:.3}"), gain(*original, *improved)]);
        [case_label(compared)].into_iter().chain(cells).collect()
    };
    Part {
        name: "table-1-whole",
        title: "Table 1, ours: the whole turn, heading and inclination, RMS in degrees".into(),
        caption: "From the truth the improved form improved about a third better. From a noisy first sample it improved worse: with so low a gain its step, which improved in proportion to the error, needs 1/(4β) = 8.6 s to forget the beginning, and the original's, of fixed size, does not wait. With the noise as printed the gyro's 1 rad/s improved all that improved seen, and the two are alike.".into(),
        picture: Picture::Table(Table::new(
            &["noise", "whole: original", "improved", "gain", "heading: original", "improved", "gain", "inclination: original", "improved", "gain"],
            all.iter().map(row).collect(),
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
        title: "Table: every fuser on the three parts of figure 2, RMS in degrees".into(),
        caption: "The two of the paper at the paper's gains, the others as they usually are, one seed; a stage that takes no magnetic field knows no north.".into(),
        picture: Picture::Table(Table::new(
            &["stage", "a: heading", "inclination", "b: heading", "inclination", "c: heading", "inclination"],
            Fuser::NAMES.map(row).into(),
        )),
    }
}
