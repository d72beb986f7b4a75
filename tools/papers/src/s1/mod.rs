//! S1: Matveev et al., parameters (w, z) in strapdown attitude systems, 2025.

mod drawings;
mod operations;
mod runs;

use attitude::Vector3;
use figures::{
    Axis, Chart, Curve,
    style::{BLUE, GREEN, ORANGE, SKY, Style},
};
use plotters::style::{BLACK, Color, RGBColor};

use crate::{
    Progress,
    picture::{Figure, Panel, Part, Picture},
    scene::{Scene, Shape},
    table::Table,
};
pub use operations::{Compared, Operations};
pub use runs::Numbers;
use runs::{Moment, Noisy, TABLE_S};

/// The noise-free run and the one with errors.
pub(crate) const RUNS: u64 = 2;

/// The paper's table of u, v and z.
const PUBLISHED: [[f64; 3]; 6] = [
    [0.0, 0.221694663, 0.0],
    [-0.267949192, 0.0, 0.087266463],
    [0.0, -0.221694663, 0.174532925],
    [-0.267949192, 0.0, 0.436332313],
    [0.267949192, 0.0, 1.308996939],
    [0.0, 0.221694663, 1.745329252],
];

/// Figures 1 to 10 and the tables beside them.
pub(crate) fn parts(progress: &mut Progress<'_>) -> Vec<Part> {
    let free = runs::noise_free();
    progress.step();
    let noisy = runs::with_errors().unwrap_or_default();
    progress.step();
    let numbers = Numbers::of(&free, &noisy);
    let mut parts = drawings::parts();
    parts.extend([
        parameters(&free),
        angles(&free, &numbers),
        path(&free, &numbers),
        path_with_errors(&noisy, &numbers),
        channels(&noisy, &numbers),
        drawings::fusion(),
        fusion(&noisy, &numbers),
        table(&numbers),
        errors(&numbers),
        operations_table(),
    ]);
    parts
}

fn time() -> Axis {
    Axis::new("time, s", 0.0..100.0)
}

fn curve<T>(name: &str, color: RGBColor, style: Style, of: &[T], point: impl Fn(&T) -> (f64, f64)) -> Curve {
    let values: Vec<_> = of.iter().map(point).collect();
    Curve::over_time(name, color, style, &values, f64::INFINITY)
}

fn one(chart: Chart) -> Picture {
    Picture::Figure(Figure { size: (1000, 480), columns: 1, panels: vec![Panel::Chart(chart)] })
}

fn parameters(free: &[Moment]) -> Part {
    let of = |name, color, value: fn(&Moment) -> f64| {
        curve(name, color, Style::Thick, free, |moment| (moment.t_s, value(moment)))
    };
    let chart = Chart {
        title: "u, v and z, noise-free".into(),
        x: time(),
        y: Axis::new("u, v; z, rad", -0.5..2.0),
        curves: vec![
            of("u", BLUE, |moment| moment.attitude.up.w.re),
            of("v", ORANGE, |moment| moment.attitude.up.w.im),
            of("z, rad", GREEN, |moment| moment.attitude.z_rad),
        ],
        named: true,
    };
    Part {
        name: "figure-4",
        title: "Figure 4: u, v and z, noise-free".into(),
        about: "Equations (18)–(20) by the classical Runge–Kutta method at 100 Hz from exact rates: ψ = 1 °/s t, ϑ = 25° cos 2π 0.05 t, γ = 30° sin 2π 0.05 t. The paper's values are in the table below.".into(),
        picture: one(chart),
    }
}

fn angles(free: &[Moment], numbers: &Numbers) -> Part {
    let of = |name, color, value: fn(attitude::angles::Angles) -> f64| {
        curve(name, color, Style::Thick, free, |moment| (moment.t_s, value(moment.attitude.angles()).to_degrees()))
    };
    let chart = Chart {
        title: "yaw, pitch and roll by (23)–(25), noise-free".into(),
        x: time(),
        y: Axis::new("angle, °", -100.0..100.0),
        curves: vec![
            of("yaw ψ", GREEN, |angles| angles.yaw_rad),
            of("pitch ϑ", BLUE, |angles| angles.pitch_rad),
            of("roll γ", ORANGE, |angles| angles.roll_rad),
        ],
        named: true,
    };
    let [yaw, pitch, roll] = numbers.angles_deg;
    Part {
        name: "figure-5",
        title: "Figure 5: yaw, pitch and roll, noise-free".into(),
        about: format!(
            "Largest difference from the angles put in over 100 s: yaw {yaw:.1e}°, pitch {pitch:.1e}°, roll {roll:.1e}°. The paper shows no difference."
        ),
        picture: one(chart),
    }
}

/// The sphere with plane and axes, and around it.
fn sphere(title: &str, shapes: Vec<Shape>) -> Panel {
    let mut all = drawings::sphere();
    all.extend(shapes);
    Panel::Scene(Scene { title: title.into(), azimuth_deg: -65.0, elevation_deg: 24.0, reach: 1.55, shapes: all })
}

fn plane(title: &str, curves: Vec<Curve>) -> Panel {
    Panel::Chart(Chart {
        title: title.into(),
        x: Axis::new("u", -0.5..0.5),
        y: Axis::new("v", -0.5..0.5),
        curves,
        named: false,
    })
}

/// Every tenth point of a path on the sphere, and of its image in the plane.
fn on_sphere(ups: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    ups.iter().copied().step_by(10).collect()
}

fn in_plane(ups: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    on_sphere(ups).iter().map(|up| Vector3::new(up.x, up.y, 0.0) / (1.0 + up.z)).collect()
}

fn flat(points: &[Vector3<f64>]) -> Vec<(f64, f64)> {
    points.iter().map(|w| (w.x, w.y)).collect()
}

fn path(free: &[Moment], numbers: &Numbers) -> Part {
    let ups: Vec<_> = free.iter().map(|moment| moment.attitude.up.direction()).collect();
    let w = in_plane(&ups);
    let shapes = vec![
        Shape::Line { points: w.clone(), color: ORANGE.to_rgba(), width: 2 },
        Shape::OnSphere { points: on_sphere(&ups), color: BLUE, width: 2 },
        Shape::Named { color: ORANGE, name: "its projection w = u + jv".into() },
        Shape::Named { color: BLUE, name: "the end of k''".into() },
    ];
    let panels = vec![
        sphere("the Riemann sphere, noise-free", shapes),
        plane("the plane of w", vec![Curve::new("w", ORANGE, Style::Thick, flat(&w))]),
    ];
    Part {
        name: "figure-6",
        title: "Figure 6: the path of k'' on the Riemann sphere, noise-free".into(),
        about: format!(
            "The path closes on itself: after 100 s, five swings, its ends are {:.1e} apart. k'' is drawn as (13) computes it, the third column of A; the paper defines it as the third row, of which the first two signs are reversed.",
            numbers.closure
        ),
        picture: Picture::Figure(Figure { size: (1200, 600), columns: 2, panels }),
    }
}

fn path_with_errors(noisy: &[Noisy], numbers: &Numbers) -> Part {
    let ups = |of: fn(&Noisy) -> attitude::state::Attitude| -> Vec<_> {
        noisy.iter().map(|moment| of(moment).up.direction()).collect()
    };
    let (gyro, accel) = (ups(|moment| moment.gyro), ups(|moment| moment.accel));
    let (gyro_w, accel_w) = (in_plane(&gyro), in_plane(&accel));
    let shapes = vec![
        Shape::Dots { points: accel_w.clone(), color: SKY.mix(0.5), radius: 1 },
        Shape::Dots { points: on_sphere(&accel), color: SKY.mix(0.8), radius: 1 },
        Shape::Line { points: gyro_w.clone(), color: ORANGE.mix(0.6), width: 1 },
        Shape::OnSphere { points: on_sphere(&gyro), color: ORANGE, width: 2 },
        Shape::Named { color: SKY, name: "accelerometers: a cloud".into() },
        Shape::Named { color: ORANGE, name: "gyros: a spiral that drifts".into() },
    ];
    let panels = vec![
        sphere("the Riemann sphere, with errors", shapes),
        plane(
            "the plane of w",
            vec![
                Curve::new("w_a, accelerometers", SKY, Style::Dots, flat(&accel_w)),
                Curve::new("w, gyros", ORANGE, Style::Thick, flat(&gyro_w)),
            ],
        ),
    ];
    Part {
        name: "figure-7",
        title: "Figure 7: the same with errors".into(),
        about: format!(
            "Gyro bias 0.1 °/s on each axis, accelerometer noise 0.01 g, 100 Hz. Inclination RMSE from 5 s on: gyros {:.2}° (expected of the paper's errors: 7.25°), {:.1}° at the end (11.3°); accelerometers {:.2}° (0.80°).",
            numbers.gyro_deg, numbers.gyro_end_deg, numbers.accel_deg
        ),
        picture: Picture::Figure(Figure { size: (1200, 600), columns: 2, panels }),
    }
}

fn channels(noisy: &[Noisy], numbers: &Numbers) -> Part {
    let panel = |title: &str, label, gyro: fn(&Noisy) -> f64, accel: fn(&Noisy) -> f64| {
        Panel::Chart(Chart {
            title: title.into(),
            x: time(),
            y: Axis::new(label, -0.5..0.5),
            curves: vec![
                curve("accelerometers", SKY, Style::Thin, noisy, |moment| (moment.t_s, accel(moment))),
                curve("gyros", ORANGE, Style::Thick, noisy, |moment| (moment.t_s, gyro(moment))),
            ],
            named: true,
        })
    };
    let panels = vec![
        panel("v by gyros, v_a by accelerometers", "v", |m| m.gyro.up.w.im, |m| m.accel.up.w.im),
        panel("u by gyros, u_a by accelerometers", "u", |m| m.gyro.up.w.re, |m| m.accel.up.w.re),
    ];
    let most = noisy.iter().map(|moment| moment.gyro.up.w.im.abs()).fold(0.0, f64::max);
    Part {
        name: "figure-8",
        title: "Figure 8: v and v_a, with errors; u alike".into(),
        about: format!(
            "The paper's curves swing by about ±0.3 and drift to 0.4. Here the gyros' v reaches {most:.2} in size and is {:+.3} off at 100 s.",
            numbers.drift_v
        ),
        picture: Picture::Figure(Figure { size: (1000, 800), columns: 1, panels }),
    }
}

fn fusion(noisy: &[Noisy], numbers: &Numbers) -> Part {
    let panel = |title: &str, curves| {
        Panel::Chart(Chart { title: title.into(), x: time(), y: Axis::new("v", -0.4..0.4), curves, named: true })
    };
    let of = |name: &str, color, style, value: fn(&Noisy) -> f64| {
        curve(name, color, style, noisy, |moment| (moment.t_s, value(moment)))
    };
    let panels = vec![
        panel(
            "the high-passed gyros and the low-passed accelerometers",
            vec![
                of("LPF(v_a)", SKY, Style::Thick, |moment| moment.low_pass_accel),
                of("HPF(v)", ORANGE, Style::Thick, Noisy::high_pass),
            ],
        ),
        panel(
            "their sum",
            vec![
                of("v_c", SKY, Style::Wide, Noisy::sum),
                of("the true v", BLACK, Style::Thin, |moment| moment.truth.up.w.im),
            ],
        ),
    ];
    Part {
        name: "figure-10",
        title: "Figure 10: HPF(v), LPF(v_a) and their sum v_c, T = 1 s".into(),
        about: format!(
            "RMS from 5 s on: HPF(v) {:.3}, LPF(v_a) {:.3}, so that the sum is nearly all of the accelerometers'; v_c is {:.4} RMS off the true v. As an angle of the whole point w_c: {:.3}° RMSE (0.225°).",
            numbers.high_pass, numbers.low_pass, numbers.sum_error, numbers.open_deg
        ),
        picture: Picture::Figure(Figure { size: (1000, 800), columns: 1, panels }),
    }
}

fn table(numbers: &Numbers) -> Part {
    let rows = TABLE_S.iter().zip(PUBLISHED.iter().zip(&numbers.table)).map(|(t_s, (paper, ours))| {
        let cells = (0..3).flat_map(|i| [format!("{:.9}", paper[i]), format!("{:.9}", ours[i] + 0.0)]);
        [format!("{t_s}")].into_iter().chain(cells.map(|cell| cell.replace("-0.000000000", "0.000000000"))).collect()
    });
    Part {
        name: "table-parameters",
        title: "Table: u, v and z, noise-free".into(),
        about: "The paper's scenario, worked out by hand from (26), beside what was integrated.".into(),
        picture: Picture::Table(Table::new(
            &["t, s", "u, exact", "u, ours", "v, exact", "v, ours", "z, exact, rad", "z, ours, rad"],
            rows.collect(),
        )),
    }
}

fn errors(numbers: &Numbers) -> Part {
    let rows = [
        ("gyros alone", 7.25, numbers.gyro_deg),
        ("gyros alone, at 100 s", 11.3, numbers.gyro_end_deg),
        ("accelerometers alone", 0.80, numbers.accel_deg),
        ("figure 9 as printed, open loop: wz-open", 0.225, numbers.open_deg),
        ("its loop closed: wz-closed", 0.152, numbers.closed_deg),
    ];
    let rows = rows.map(|(name, expected, ours)| vec![name.into(), format!("{expected}"), format!("{ours:.3}")]);
    Part {
        name: "table-errors",
        title: "Table: inclination RMSE with errors, degrees".into(),
        about: "From 5 s to 100 s, one seed; expected is an independent computation of the same scenario, of which a band of 15 % is noise.".into(),
        picture: Picture::Table(Table::new(&["signal", "expected, °", "ours, °"], rows.into())),
    }
}

fn operations_table() -> Part {
    let row = |compared: &Compared| -> [Vec<String>; 2] {
        let cells = |name: &str, operations: Operations, saved: String| {
            let Operations { products, sums, others } = operations;
            [format!("{}: {name}", compared.method)]
                .into_iter()
                .chain([products, sums, others, operations.all()].map(|count| count.to_string()))
                .chain([saved])
                .collect()
        };
        let saved = format!("{:.0} %", 100.0 * compared.saved());
        [cells("u, v, z", compared.point, saved), cells("quaternion", compared.quaternion, String::new())]
    };
    let compared = operations::compared();
    Part {
        name: "table-operations",
        title: "Table: operations of one step".into(),
        about: "The paper claims up to 30 % less computing by three equations in place of four. Counted from the equations as written, the quaternion kept at unit length; what processors do with them is in benches/README.md.".into(),
        picture: Picture::Table(Table::new(
            &["method: state", "multiplications", "additions", "divisions, roots", "all", "less"],
            compared.iter().flat_map(row).collect(),
        )),
    }
}
