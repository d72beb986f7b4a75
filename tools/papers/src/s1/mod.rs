//! S1: Matveev et al. 2025, parameters (w, z) in strapdown attitude systems.

mod drawings;
mod operations;
mod runs;

use attitude::Vector3;
use figures::{
    Axis, Chart, Curve,
    style::{BLUE, GREEN, LineStyle, ORANGE, SKY},
};
use plotters::style::{BLACK, Color, RGBColor};

use crate::{
    Progress,
    picture::{Figure, Panel, Part, Picture},
    sphere::{Shape, Sphere},
    table::Table,
};
pub use operations::{OperationComparison, Operations};
pub use runs::Results;
use runs::{NoiseFreeSample, NoisySample, TABLE_TIMES_S};

/// Number of simulation runs: one noise-free and one with errors.
pub(crate) const RUN_COUNT: u64 = 2;

/// Values of u, v and z (rad) that the paper gives for its scenario at the times `TABLE_TIMES_S`.
const PUBLISHED: [[f64; 3]; 6] = [
    [0.0, 0.221694663, 0.0],
    [-0.267949192, 0.0, 0.087266463],
    [0.0, -0.221694663, 0.174532925],
    [-0.267949192, 0.0, 0.436332313],
    [0.267949192, 0.0, 1.308996939],
    [0.0, 0.221694663, 1.745329252],
];

/// Returns figures 1 to 10 and the tables.
pub(crate) fn parts(progress: &mut Progress<'_>) -> Vec<Part> {
    let noise_free = runs::noise_free();
    progress.step();
    let noisy = runs::with_errors().unwrap_or_default();
    progress.step();
    let results = Results::new(&noise_free, &noisy);
    vec![
        drawings::rotations(),
        drawings::projection(),
        parameters(&noise_free),
        angles(&noise_free, &results),
        path(&noise_free, &results),
        path_with_errors(&noisy, &results),
        channels(&noisy, &results),
        drawings::fusion(),
        fusion(&noisy, &results),
        table(&results),
        errors(&results),
        operations_table(),
    ]
}

fn time_axis() -> Axis {
    Axis::new("time, s", 0.0..100.0)
}

fn curve<T>(name: &str, color: RGBColor, style: LineStyle, samples: &[T], point: impl Fn(&T) -> (f64, f64)) -> Curve {
    let values: Vec<_> = samples.iter().map(point).collect();
    Curve::over_time(name, color, style, &values, f64::INFINITY)
}

fn single_chart(chart: Chart) -> Picture {
    Picture::Figure(Figure { size: (1000, 480), columns: 1, panels: vec![Panel::Chart(chart)] })
}

fn parameters(noise_free: &[NoiseFreeSample]) -> Part {
    let series = |name, color, value: fn(&NoiseFreeSample) -> f64| {
        curve(name, color, LineStyle::Thick, noise_free, |sample| (sample.t_s, value(sample)))
    };
    let chart = Chart {
        title: "u, v and z, noise-free".into(),
        x: time_axis(),
        y: Axis::new("u, v; z, rad", -0.5..2.0),
        curves: vec![
            series("u", BLUE, |sample| sample.attitude.up.w.re),
            series("v", ORANGE, |sample| sample.attitude.up.w.im),
            series("z, rad", GREEN, |sample| sample.attitude.z_rad),
        ],
        has_legend: true,
    };
    Part {
        name: "figure-4",
        title: "Figure 4: u, v and z, noise-free".into(),
        caption: "Equations (18)–(20), integrated with the classical Runge–Kutta method at 100 Hz from exact rates: ψ = 1 °/s t, ϑ = 25° cos 2π 0.05 t, γ = 30° sin 2π 0.05 t. The paper's values are in the table below.".into(),
        picture: single_chart(chart),
    }
}

fn angles(noise_free: &[NoiseFreeSample], results: &Results) -> Part {
    let series = |name, color, value: fn(attitude::angles::Angles) -> f64| {
        curve(name, color, LineStyle::Thick, noise_free, |sample| {
            (sample.t_s, value(sample.attitude.angles()).to_degrees())
        })
    };
    let chart = Chart {
        title: "yaw, pitch and roll by (23)–(25), noise-free".into(),
        x: time_axis(),
        y: Axis::new("angle, °", -100.0..100.0),
        curves: vec![
            series("yaw ψ", GREEN, |angles| angles.yaw_rad),
            series("pitch ϑ", BLUE, |angles| angles.pitch_rad),
            series("roll γ", ORANGE, |angles| angles.roll_rad),
        ],
        has_legend: true,
    };
    let [yaw, pitch, roll] = results.angles_deg;
    Part {
        name: "figure-5",
        title: "Figure 5: yaw, pitch and roll, noise-free".into(),
        caption: format!(
            "Largest difference from the input angles over 100 s: yaw {yaw:.1e}°, pitch {pitch:.1e}°, roll {roll:.1e}°. The paper shows no difference."
        ),
        picture: single_chart(chart),
    }
}

fn plane(title: &str, curves: Vec<Curve>) -> Panel {
    Panel::Chart(Chart {
        title: title.into(),
        x: Axis::new("u", -0.5..0.5),
        y: Axis::new("v", -0.5..0.5),
        curves,
        has_legend: false,
    })
}

/// Returns every tenth point of a path on the sphere.
fn decimated(up_vectors: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    up_vectors.iter().copied().step_by(10).collect()
}

/// Returns the stereographic image of every tenth point of a path, in the plane.
fn projected(up_vectors: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    decimated(up_vectors).iter().map(|up| Vector3::new(up.x, up.y, 0.0) / (1.0 + up.z)).collect()
}

fn coordinates(points: &[Vector3<f64>]) -> Vec<(f64, f64)> {
    points.iter().map(|w| (w.x, w.y)).collect()
}

fn path(noise_free: &[NoiseFreeSample], results: &Results) -> Part {
    let up_vectors: Vec<_> = noise_free.iter().map(|sample| sample.attitude.up.direction()).collect();
    let w = projected(&up_vectors);
    let shapes = vec![
        Shape::Line { points: w.clone(), color: ORANGE.to_rgba(), width: 2 },
        Shape::OnSphere { points: decimated(&up_vectors), color: BLUE, width: 2 },
        Shape::LegendEntry { color: ORANGE, label: "projection w = u + jv".into() },
        Shape::LegendEntry { color: BLUE, label: "tip of k''".into() },
    ];
    let panels = vec![
        Panel::Sphere(Sphere { title: "Riemann sphere, noise-free".into(), shapes }),
        plane("w plane", vec![Curve::new("w", ORANGE, LineStyle::Thick, coordinates(&w))]),
    ];
    Part {
        name: "figure-6",
        title: "Figure 6: path of k'' on the Riemann sphere, noise-free".into(),
        caption: format!(
            "The path is closed: after 100 s, which is five periods, its ends are {:.1e} apart. k'' is drawn as computed by (13), the third column of A. The paper defines it as the third row, with the signs of the first two components reversed.",
            results.closure
        ),
        picture: Picture::Figure(Figure { size: (1200, 600), columns: 2, panels }),
    }
}

fn path_with_errors(noisy: &[NoisySample], results: &Results) -> Part {
    let up_vectors = |channel: fn(&NoisySample) -> attitude::state::Attitude| -> Vec<_> {
        noisy.iter().map(|sample| channel(sample).up.direction()).collect()
    };
    let (gyro, accel) = (up_vectors(|sample| sample.gyro), up_vectors(|sample| sample.accel));
    let (gyro_w, accel_w) = (projected(&gyro), projected(&accel));
    let shapes = vec![
        Shape::Dots { points: accel_w.clone(), color: SKY.mix(0.5), radius: 1 },
        Shape::Dots { points: decimated(&accel), color: SKY.mix(0.8), radius: 1 },
        Shape::Line { points: gyro_w.clone(), color: ORANGE.mix(0.6), width: 1 },
        Shape::OnSphere { points: decimated(&gyro), color: ORANGE, width: 2 },
        Shape::LegendEntry { color: SKY, label: "accelerometers: cloud".into() },
        Shape::LegendEntry { color: ORANGE, label: "gyros: drifting spiral".into() },
    ];
    let panels = vec![
        Panel::Sphere(Sphere { title: "Riemann sphere, with errors".into(), shapes }),
        plane(
            "w plane",
            vec![
                Curve::new("w_a, accelerometers", SKY, LineStyle::Dots, coordinates(&accel_w)),
                Curve::new("w, gyros", ORANGE, LineStyle::Thick, coordinates(&gyro_w)),
            ],
        ),
    ];
    Part {
        name: "figure-7",
        title: "Figure 7: path of k'' with errors".into(),
        caption: format!(
            "Gyro bias 0.1 °/s on each axis, accelerometer noise 0.01 g, 100 Hz. Inclination RMSE from 5 s on: gyros {:.2}° (expected for these errors: 7.25°), with an error of {:.1}° at 100 s (11.3°); accelerometers {:.2}° (0.80°).",
            results.gyro_deg, results.gyro_end_deg, results.accel_deg
        ),
        picture: Picture::Figure(Figure { size: (1200, 600), columns: 2, panels }),
    }
}

fn channels(noisy: &[NoisySample], results: &Results) -> Part {
    let panel = |title: &str, label, gyro: fn(&NoisySample) -> f64, accel: fn(&NoisySample) -> f64| {
        Panel::Chart(Chart {
            title: title.into(),
            x: time_axis(),
            y: Axis::new(label, -0.5..0.5),
            curves: vec![
                curve("accelerometers", SKY, LineStyle::Thin, noisy, |sample| (sample.t_s, accel(sample))),
                curve("gyros", ORANGE, LineStyle::Thick, noisy, |sample| (sample.t_s, gyro(sample))),
            ],
            has_legend: true,
        })
    };
    let panels = vec![
        panel("v from gyros, v_a from accelerometers", "v", |m| m.gyro.up.w.im, |m| m.accel.up.w.im),
        panel("u from gyros, u_a from accelerometers", "u", |m| m.gyro.up.w.re, |m| m.accel.up.w.re),
    ];
    let max_v = noisy.iter().map(|sample| sample.gyro.up.w.im.abs()).fold(0.0, f64::max);
    Part {
        name: "figure-8",
        title: "Figure 8: v and v_a, u and u_a with errors".into(),
        caption: format!(
            "The paper's curves oscillate by about ±0.3 and drift to 0.4. Here the largest |v| of the gyros is {max_v:.2}, and their error of v at 100 s is {:+.3}.",
            results.drift_v
        ),
        picture: Picture::Figure(Figure { size: (1000, 800), columns: 1, panels }),
    }
}

fn fusion(noisy: &[NoisySample], results: &Results) -> Part {
    let panel = |title: &str, curves| {
        Panel::Chart(Chart {
            title: title.into(),
            x: time_axis(),
            y: Axis::new("v", -0.4..0.4),
            curves,
            has_legend: true,
        })
    };
    let series = |name: &str, color, style, value: fn(&NoisySample) -> f64| {
        curve(name, color, style, noisy, |sample| (sample.t_s, value(sample)))
    };
    let panels = vec![
        panel(
            "high-passed gyros and low-passed accelerometers",
            vec![
                series("LPF(v_a)", SKY, LineStyle::Thick, |sample| sample.low_pass_accel),
                series("HPF(v)", ORANGE, LineStyle::Thick, NoisySample::high_pass),
            ],
        ),
        panel(
            "sum",
            vec![
                series("v_c", SKY, LineStyle::Wide, NoisySample::sum),
                series("true v", BLACK, LineStyle::Thin, |sample| sample.truth.up.w.im),
            ],
        ),
    ];
    Part {
        name: "figure-10",
        title: "Figure 10: HPF(v), LPF(v_a) and their sum v_c, T = 1 s".into(),
        caption: format!(
            "RMS from 5 s on: HPF(v) {:.3}, LPF(v_a) {:.3}, so the sum consists mostly of the accelerometer part. RMS error of v_c: {:.4}. Inclination RMSE of the point w_c: {:.3}° (expected 0.225°).",
            results.high_pass, results.low_pass, results.sum_error, results.open_deg
        ),
        picture: Picture::Figure(Figure { size: (1000, 800), columns: 1, panels }),
    }
}

fn table(results: &Results) -> Part {
    let rows = TABLE_TIMES_S.iter().zip(PUBLISHED.iter().zip(&results.table)).map(|(t_s, (paper, ours))| {
        let cells = (0..3).flat_map(|i| [format!("{:.9}", paper[i]), format!("{:.9}", ours[i] + 0.0)]);
        [format!("{t_s}")].into_iter().chain(cells.map(|cell| cell.replace("-0.000000000", "0.000000000"))).collect()
    });
    Part {
        name: "table-parameters",
        title: "Table: u, v and z, noise-free".into(),
        caption: "Exact values, calculated by hand from (26), and integrated values.".into(),
        picture: Picture::Table(Table::new(
            &["t, s", "u, exact", "u, ours", "v, exact", "v, ours", "z, exact, rad", "z, ours, rad"],
            rows.collect(),
        )),
    }
}

fn errors(results: &Results) -> Part {
    let rows = [
        ("gyros alone", 7.25, results.gyro_deg),
        ("gyros alone, at 100 s", 11.3, results.gyro_end_deg),
        ("accelerometers alone", 0.80, results.accel_deg),
        ("figure 9 as published, open loop: wz-open", 0.225, results.open_deg),
        ("loop closed: wz-closed", 0.152, results.closed_deg),
    ];
    let rows = rows.map(|(name, expected, ours)| vec![name.into(), format!("{expected}"), format!("{ours:.3}")]);
    Part {
        name: "table-errors",
        title: "Table: inclination RMSE with errors, degrees".into(),
        caption: "From 5 s to 100 s, one seed. The expected values are from an independent implementation of the same scenario. They vary by ±15 % with the noise seed.".into(),
        picture: Picture::Table(Table::new(&["signal", "expected, °", "ours, °"], rows.into())),
    }
}

fn operations_table() -> Part {
    let row = |comparison: &OperationComparison| -> [Vec<String>; 2] {
        let cells = |name: &str, operations: Operations, reduction: String| {
            let Operations { products, sums, others } = operations;
            [format!("{}: {name}", comparison.method)]
                .into_iter()
                .chain([products, sums, others, operations.total()].map(|count| count.to_string()))
                .chain([reduction])
                .collect()
        };
        let reduction = format!("{:.0} %", 100.0 * comparison.reduction());
        [cells("u, v, z", comparison.point, reduction), cells("quaternion", comparison.quaternion, String::new())]
    };
    let comparisons = operations::comparisons();
    Part {
        name: "table-operations",
        title: "Table: operations per step".into(),
        caption: "The paper claims up to 30 % less computation with three equations instead of four. Operations are counted from the equations as written, with the quaternion normalised in each step. For processor instructions see benches/README.md.".into(),
        picture: Picture::Table(Table::new(
            &["method: state", "multiplications", "additions", "divisions, roots", "total", "reduction"],
            comparisons.iter().flat_map(row).collect(),
        )),
    }
}
