//! S2: mathematical modelling of geonavigation measuring systems with three-component accelerometers.

mod relations;

use figures::{
    Axis, Chart, Curve,
    style::{BLUE, GREEN, ORANGE, SKY, LineStyle},
};
use plotters::style::RGBColor;

use crate::{
    Progress,
    heatmap::Heatmap,
    picture::{Figure, Panel, Part, Picture},
    table::Table,
};
pub use relations::Results;
use relations::{COLUMNS, Cell, ROWS, Method, sphere_cells, errors_near_singularity, sensitivity};

/// The sphere, cell by cell.
pub(crate) const RUN_COUNT: u64 = 1;

/// The relations: the paper has no measured figures.
pub(crate) fn parts(progress: &mut Progress<'_>) -> Vec<Part> {
    let cells = sphere_cells();
    progress.step();
    let results = Results::new(&cells);
    vec![sphere(&cells), differences(&cells, &results), singular(), sensitivities(), table(&results)]
}

fn directions() -> (Axis, Axis) {
    (Axis::new("true ψ (roll), °", -180.0..180.0), Axis::new("true β (pitch), °", -90.0..90.0))
}

fn map(title: &str, of: Axis, cells: &[Cell], value: impl Fn(&Cell) -> f64) -> Panel {
    let (x, y) = directions();
    Panel::Map(Map { title: title.into(), x, y, of, columns: COLUMNS, values: cells.iter().map(value).collect() })
}

fn sphere(cells: &[Cell]) -> Part {
    let panel = |title: &str, method: Method, pitch: bool| {
        let value = move |cell: &Cell| if pitch { cell.estimate(method).pitch_deg } else { cell.estimate(method).roll_deg };
        let of = if pitch { Axis::new("β, °", -90.0..90.0) } else { Axis::new("ψ, °", -180.0..180.0) };
        map(title, of, cells, value)
    };
    Part {
        name: "angles",
        title: "β and ψ over the whole sphere of directions of gravity".into(),
        caption: format!(
            "{} directions, in the paper's axes: X forward, Z along the vertical that the accelerometer reads as +g; gx = −g sin β, gy = g sin ψ cos β, gz = g cos ψ cos β. β = atan2(−gx, √(gy² + gz²)), ψ = atan2(gy, gz); by quaternion the angles of the λ of that direction. Both are what was put in: stripes of β, stripes of ψ.",
            COLUMNS * ROWS
        ),
        picture: Picture::Figure(Figure {
            size: (1200, 800),
            columns: 2,
            panels: vec![
                panel("β by the matrix method", Method::Matrix, true),
                panel("β by the quaternion method", Method::Quaternion, true),
                panel("ψ by the matrix method", Method::Matrix, false),
                panel("ψ by the quaternion method", Method::Quaternion, false),
            ],
        }),
    }
}

fn differences(cells: &[Cell], results: &Results) -> Part {
    let of = || Axis::new("lg of °", -17.0..-11.0);
    let lg = |deg: f64| deg.abs().max(1e-17).log10();
    let panels = vec![
        map("β: matrix less quaternion", of(), cells, |cell| lg(cell.method_difference().pitch_deg)),
        map("ψ: matrix less quaternion", of(), cells, |cell| lg(cell.method_difference().roll_deg)),
    ];
    Part {
        name: "differences",
        title: "The difference of the two methods".into(),
        caption: format!(
            "Rounding only: at most {:.0e}° of β and {:.0e}° of ψ over the sphere, the latter at the rows next to β = ±90°, where it is divided by cos β. Dark blue: none at all.",
            results.matrix_vs_quaternion.pitch_deg, results.matrix_vs_quaternion.roll_deg
        ),
        picture: Picture::Figure(Figure { size: (1200, 440), columns: 2, panels }),
    }
}

fn curve(name: &str, color: RGBColor, style: LineStyle, points: Vec<(f64, f64)>) -> Curve {
    Curve::new(name, color, style, points)
}

fn singular() -> Part {
    let of = |method: Method, pick: fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
        errors_near_singularity(method)
            .into_iter()
            .map(|(beta_deg, error)| (beta_deg, pick(error.pitch_deg, error.roll_deg)))
            .collect()
    };
    let chart = |title: &str, label, range, pick: fn(f64, f64) -> f64| {
        Panel::Chart(Chart {
            title: title.into(),
            x: Axis::new("true β, °", 80.0..90.0),
            y: Axis::new(label, range),
            curves: vec![
                curve("matrix", SKY, LineStyle::Wide, of(Method::Matrix, pick)),
                curve("quaternion", BLUE, LineStyle::Thin, of(Method::Quaternion, pick)),
            ],
            has_legend: true,
        })
    };
    let panels = vec![
        chart("ψ, with 1 mg too much of gy", "error of ψ, °", 0.0..20.0, |_, roll_deg| roll_deg.abs()),
        chart("β, with 1 mg too much of gy", "error of β, °", -0.06..0.06, |pitch_deg, _| pitch_deg),
    ];
    Part {
        name: "singular",
        title: "The singular β = ±90°".into(),
        caption: "ψ = 0 and an error of 1 mg across: the error of ψ is 0.057°/cos β and without bound, that of β stays below 0.06°. At β = ±90° itself gravity has no part in the plane of ψ, and ψ is whatever rounding makes it, by both methods. The direction, which is what w = (u, v) is made of, is not singular there.".into(),
        picture: Picture::Figure(Figure { size: (1100, 800), columns: 1, panels }),
    }
}

fn sensitivities() -> Part {
    let rolls = [(0.0, BLUE), (45.0, GREEN), (75.0, ORANGE)];
    let curves = |pitch: bool| {
        let of = |(roll_deg, color): (f64, RGBColor)| {
            let point = |tenth: i32| {
                let beta_deg = f64::from(tenth) * 0.5;
                let (pitch_deg, roll_error_deg) = sensitivity(beta_deg, roll_deg);
                (beta_deg, if pitch { pitch_deg } else { roll_error_deg })
            };
            curve(&format!("ψ = {roll_deg}°"), color, LineStyle::Thick, (-178..=178).map(point).collect())
        };
        rolls.map(of).into()
    };
    let panels = vec![
        Panel::Chart(Chart {
            title: "dψ/dgy".into(),
            x: Axis::new("β, °", -90.0..90.0),
            y: Axis::new("°/mg", 0.0..1.0),
            curves: curves(false),
            has_legend: true,
        }),
        Panel::Chart(Chart {
            title: "dβ/dgx".into(),
            x: Axis::new("β, °", -90.0..90.0),
            y: Axis::new("°/mg", -0.08..0.02),
            curves: curves(true),
            has_legend: true,
        }),
    ];
    Part {
        name: "sensitivity",
        title: "Sensitivity of the angles over β".into(),
        caption: "By differences of 1 µg through the matrix method: dψ/dgy = cos ψ/(g cos β), dβ/dgx = −cos β/g whatever ψ is, so that its curves lie on each other. The arctangent of all three components loses sensitivity to gx towards ±90°, where an arc sine of gx alone would have −1/(g cos β).".into(),
        picture: Picture::Figure(Figure { size: (1000, 800), columns: 1, panels }),
    }
}

fn table(results: &Results) -> Part {
    let row = |name: &str, error: relations::Tilt| {
        vec![name.to_string(), format!("{:.1e}", error.pitch_deg), format!("{:.1e}", error.roll_deg)]
    };
    Part {
        name: "table-differences",
        title: "Table: largest differences over the sphere, degrees".into(),
        caption: "Of the stages inclinometer-matrix, inclinometer-quaternion and projector (S1, (27), (28)), their axes mapped to the paper's.".into(),
        picture: Picture::Table(Table::new(
            &["between", "β, °", "ψ, °"],
            vec![
                row("matrix and what was put in", results.matrix),
                row("quaternion and what was put in", results.quaternion),
                row("projector and what was put in", results.projector),
                row("matrix and quaternion", results.between),
            ],
        )),
    }
}
