//! S2: modelling of geonavigation measuring systems with three-component accelerometers.

mod relations;

use figures::{
    Axis, Chart, Curve,
    style::{BLUE, GREEN, LineStyle, ORANGE, SKY},
};
use plotters::style::RGBColor;

use crate::{
    Progress,
    heatmap::Heatmap,
    picture::{Figure, Panel, Part, Picture},
    table::Table,
};
pub use relations::Results;
use relations::{COLUMNS, Cell, Method, ROWS, errors_near_singularity, sensitivity, sphere_cells};

/// Number of simulation runs: one pass over the sphere.
pub(crate) const RUN_COUNT: u64 = 1;

/// Returns the figures and the table of results. The paper contains no measurements for comparison.
pub(crate) fn parts(progress: &mut Progress<'_>) -> Vec<Part> {
    let cells = sphere_cells();
    progress.step();
    let results = Results::new(&cells);
    vec![sphere(&cells), differences(&cells, &results), singular(), sensitivities(), table(&results)]
}

fn directions() -> (Axis, Axis) {
    (Axis::new("true ψ (roll), °", -180.0..180.0), Axis::new("true β (pitch), °", -90.0..90.0))
}

fn heatmap_panel(title: &str, value_axis: Axis, cells: &[Cell], value: impl Fn(&Cell) -> f64) -> Panel {
    let (x, y) = directions();
    let values = cells.iter().map(value).collect();
    Panel::Heatmap(Heatmap { title: title.into(), x, y, value_axis, columns: COLUMNS, values })
}

fn sphere(cells: &[Cell]) -> Part {
    let panel = |title: &str, method: Method, pitch: bool| {
        let value = move |cell: &Cell| {
            if pitch { cell.estimate(method).pitch_deg } else { cell.estimate(method).roll_deg }
        };
        let value_axis = if pitch { Axis::new("β, °", -90.0..90.0) } else { Axis::new("ψ, °", -180.0..180.0) };
        heatmap_panel(title, value_axis, cells, value)
    };
    Part {
        name: "angles",
        title: "β and ψ over all directions of gravity".into(),
        caption: format!(
            "{} directions, in the axes of the paper: X forward, Z along the vertical, read as +g by the accelerometer; gx = −g sin β, gy = g sin ψ cos β, gz = g cos ψ cos β. Matrix method: β = atan2(−gx, √(gy² + gz²)), ψ = atan2(gy, gz). Quaternion method: the angles of the λ of that direction. Both return the input angles: stripes of β, stripes of ψ.",
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
    let value_axis = || Axis::new("log10 of °", -17.0..-11.0);
    let log = |deg: f64| deg.abs().max(1e-17).log10();
    let beta = |cell: &Cell| log(cell.method_difference().pitch_deg);
    let psi = |cell: &Cell| log(cell.method_difference().roll_deg);
    let panels = vec![
        heatmap_panel("β: matrix minus quaternion", value_axis(), cells, beta),
        heatmap_panel("ψ: matrix minus quaternion", value_axis(), cells, psi),
    ];
    Part {
        name: "differences",
        title: "Difference between the two methods".into(),
        caption: format!(
            "Rounding only: at most {:.0e}° in β and {:.0e}° in ψ. The latter occurs in the rows next to β = ±90°, where the rounding error is divided by cos β. Dark blue: no difference.",
            results.matrix_vs_quaternion.pitch_deg, results.matrix_vs_quaternion.roll_deg
        ),
        picture: Picture::Figure(Figure { size: (1200, 440), columns: 2, panels }),
    }
}

fn curve(name: &str, color: RGBColor, style: LineStyle, points: Vec<(f64, f64)>) -> Curve {
    Curve::new(name, color, style, points)
}

fn singular() -> Part {
    let errors = |method: Method, pick: fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
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
                curve("matrix", SKY, LineStyle::Wide, errors(Method::Matrix, pick)),
                curve("quaternion", BLUE, LineStyle::Thin, errors(Method::Quaternion, pick)),
            ],
            has_legend: true,
        })
    };
    let panels = vec![
        chart("ψ, with an error of +1 mg in gy", "error of ψ, °", 0.0..20.0, |_, roll_deg| roll_deg.abs()),
        chart("β, with an error of +1 mg in gy", "error of β, °", -0.06..0.06, |pitch_deg, _| pitch_deg),
    ];
    Part {
        name: "singular",
        title: "Singularity at β = ±90°".into(),
        caption: "ψ = 0 with an error of 1 mg in gy. The error of ψ is 0.057°/cos β and grows without bound; that of β stays below 0.06°. At β = ±90° gravity has no component in the plane of ψ, so with both methods ψ depends on rounding alone. The direction of gravity, from which w = (u, v) is computed, has no singularity there.".into(),
        picture: Picture::Figure(Figure { size: (1100, 800), columns: 1, panels }),
    }
}

fn sensitivities() -> Part {
    let rolls = [(0.0, BLUE), (45.0, GREEN), (75.0, ORANGE)];
    let curves = |pitch: bool| {
        let curve_at = |(roll_deg, color): (f64, RGBColor)| {
            let point = |tenth: i32| {
                let beta_deg = f64::from(tenth) * 0.5;
                let (pitch_deg, roll_error_deg) = sensitivity(beta_deg, roll_deg);
                (beta_deg, if pitch { pitch_deg } else { roll_error_deg })
            };
            curve(&format!("ψ = {roll_deg}°"), color, LineStyle::Thick, (-178..=178).map(point).collect())
        };
        rolls.map(curve_at).into()
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
        title: "Sensitivity of the angles as a function of β".into(),
        caption: "Differences of 1 µg with the matrix method. dψ/dgy = cos ψ/(g cos β). dβ/dgx = −cos β/g does not depend on ψ, so its curves coincide. The arctangent of all three components loses sensitivity to gx towards ±90°, where an arcsine of gx alone would have −1/(g cos β).".into(),
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
        caption: "Stages inclinometer-matrix, inclinometer-quaternion and projector (S1, (27), (28)), with their axes mapped to those of the paper.".into(),
        picture: Picture::Table(Table::new(
            &["difference", "β, °", "ψ, °"],
            vec![
                row("matrix minus true angle", results.matrix),
                row("quaternion minus true angle", results.quaternion),
                row("projector minus true angle", results.projector),
                row("matrix minus quaternion", results.matrix_vs_quaternion),
            ],
        )),
    }
}
