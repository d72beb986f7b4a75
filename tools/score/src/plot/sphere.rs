//! The Riemann sphere: the up vector on it, and its stereographic projection to the plane of w.
//!
//! The plane contains ξ and η and passes through the centre. The ray from the pole −ζ through the
//! up vector meets the plane in w — Matveev 2025, (12).

use attitude::Vector3;
use figures::{
    Area, Draw, DrawResult,
    style::{AMBER, BLUE, ORANGE, TEXT, TITLE},
};
use plotters::{
    coord::types::RangedCoordf64,
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

/// Half the side length of the square part of the plane that is drawn. Points outside the square
/// are omitted.
const PLANE_HALF_SIDE: f64 = 1.6;
/// Number of rays drawn from the pole.
const RAY_COUNT: usize = 6;
/// Azimuth of the viewing direction about the vertical.
const AZIMUTH_DEG: f64 = -65.0;
/// Elevation of the viewing direction above the plane.
const ELEVATION_DEG: f64 = 22.0;

const POLE: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Drawing of the path of an up vector.
pub(crate) struct Sphere<'a> {
    pub(crate) title: String,
    pub(crate) ups: &'a [Vector3<f64>],
}

impl Draw for Sphere<'_> {
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let area = area.titled(&self.title, TITLE)?;
        let mut chart = ChartBuilder::on(&area).margin(10).build_cartesian_2d(-2.0..2.0, -2.1..1.8)?;
        draw_scene(&mut chart)?;
        draw_path(&mut chart, self.ups)?;
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerLeft)
            .label_font(TEXT)
            .legend_area_size(34)
            .background_style(WHITE)
            .border_style(BLACK.mix(0.3))
            .draw()?;
        Ok(())
    }
}

/// Draws sphere, plane and axes.
fn draw_scene<B: DrawingBackend>(chart: &mut Chart<'_, B>) -> DrawResult
where
    B::ErrorType: 'static,
{
    let corners = [
        (-PLANE_HALF_SIDE, -PLANE_HALF_SIDE),
        (PLANE_HALF_SIDE, -PLANE_HALF_SIDE),
        (PLANE_HALF_SIDE, PLANE_HALF_SIDE),
        (-PLANE_HALF_SIDE, PLANE_HALF_SIDE),
    ];
    let plane: Vec<_> = corners.iter().map(|(u, v)| project(&Vector3::new(*u, *v, 0.0))).collect();
    chart.draw_series([Polygon::new(plane, RGBColor(240, 236, 220).mix(0.8))])?;
    let circle =
        |of: &dyn Fn(f64) -> (f64, f64)| -> Vec<_> { (0..=180).map(|k| of(f64::from(2 * k).to_radians())).collect() };
    let outline = circle(&|angle| (angle.cos(), angle.sin()));
    let equator = circle(&|angle| project(&Vector3::new(angle.cos(), angle.sin(), 0.0)));
    let right = circle(&|angle| project(&Vector3::new(angle.sin(), 0.0, angle.cos())));
    let forward = circle(&|angle| project(&Vector3::new(0.0, angle.sin(), angle.cos())));
    let grey = BLACK.mix(0.25);
    chart.draw_series([equator, right, forward].map(|line| PathElement::new(line, grey)))?;
    chart.draw_series([PathElement::new(outline, BLACK.mix(0.6).stroke_width(2))])?;
    let axes = [
        (Vector3::new(PLANE_HALF_SIDE, 0.0, 0.0), "u (ξ, right)"),
        (Vector3::new(0.0, PLANE_HALF_SIDE, 0.0), "v (η, forward)"),
        (Vector3::new(0.0, 0.0, 1.35), "ζ: level, w = 0"),
        (Vector3::new(0.0, 0.0, -1.35), "−ζ: upside down, w = ∞"),
    ];
    let axis = |(end, _): &(Vector3<f64>, _)| PathElement::new(vec![(0.0, 0.0), project(end)], BLACK.mix(0.5));
    chart.draw_series(axes.iter().map(axis))?;
    let text = TEXT.into_font().color(&BLACK).pos(Pos::new(HPos::Center, VPos::Center));
    chart.draw_series(axes.iter().map(|(end, name)| Text::new(*name, project(&(end * 1.1)), text.clone())))?;
    chart.draw_series([Circle::new(project(&POLE), 4, BLACK.filled())])?;
    Ok(())
}

/// Draws the path of the up vector, the path of w, and rays between them.
fn draw_path<B: DrawingBackend>(chart: &mut Chart<'_, B>, ups: &[Vector3<f64>]) -> DrawResult
where
    B::ErrorType: 'static,
{
    let legend = |color: RGBColor| move |(x, y)| PathElement::new(vec![(x, y), (x + 26, y)], color.stroke_width(3));
    let plane = visible_runs(ups, |up| plane_point(up).map(|w| project(&w)));
    chart
        .draw_series(plane.into_iter().map(|line| PathElement::new(line, AMBER)))?
        .label("w = u + jv in the plane")
        .legend(legend(AMBER));
    let behind = visible_runs(ups, |up| (depth(up) < 0.0).then(|| project(up)));
    chart.draw_series(behind.into_iter().map(|line| PathElement::new(line, BLUE.mix(0.35))))?;
    let front = visible_runs(ups, |up| (depth(up) >= 0.0).then(|| project(up)));
    chart
        .draw_series(front.into_iter().map(|line| PathElement::new(line, BLUE)))?
        .label("up vector in body axes, pale behind the sphere")
        .legend(legend(BLUE));
    let rays: Vec<_> = (0..RAY_COUNT)
        .filter_map(|k| ups.get(k * ups.len() / RAY_COUNT))
        .filter_map(|up| Some((*up, plane_point(up)?)))
        .collect();
    chart.draw_series(rays.iter().map(|(up, w)| {
        let ends = if up.z < 0.0 { [POLE, *w] } else { [POLE, *up] };
        PathElement::new(ends.map(|end| project(&end)).to_vec(), BLACK.mix(0.35))
    }))?;
    let ends = rays.iter().flat_map(|(up, w)| [*up, *w]);
    chart
        .draw_series(ends.map(|end| Circle::new(project(&end), 3, ORANGE.filled())))?
        .label("w and its up vector, on one ray from −ζ")
        .legend(|(x, y)| Circle::new((x + 13, y), 4, ORANGE.filled()));
    Ok(())
}

/// Returns the sequences of consecutive visible points.
fn visible_runs(
    ups: &[Vector3<f64>],
    project_up: impl Fn(&Vector3<f64>) -> Option<(f64, f64)>,
) -> Vec<Vec<(f64, f64)>> {
    let projected: Vec<_> = ups.iter().map(project_up).collect();
    let runs = projected.split(Option::is_none).filter(|run| run.len() > 1);
    runs.map(|run| run.iter().copied().flatten().collect()).collect()
}

/// Returns w of an up vector as a point in the plane; `None` if it is outside the drawn part.
fn plane_point(up: &Vector3<f64>) -> Option<Vector3<f64>> {
    let w = Vector3::new(up.x, up.y, 0.0) / (1.0 + up.z);
    (w.amax() <= PLANE_HALF_SIDE).then_some(w)
}

/// Projects a point in space onto the drawing.
fn project(point: &Vector3<f64>) -> (f64, f64) {
    let (sin_azimuth, cos_azimuth) = AZIMUTH_DEG.to_radians().sin_cos();
    let (sin_elevation, cos_elevation) = ELEVATION_DEG.to_radians().sin_cos();
    let horizontal_depth = cos_azimuth * point.x + sin_azimuth * point.y;
    (cos_azimuth * point.y - sin_azimuth * point.x, point.z * cos_elevation - horizontal_depth * sin_elevation)
}

/// Returns the signed distance of a point from the centre, in the direction of the viewer.
fn depth(point: &Vector3<f64>) -> f64 {
    let (sin_azimuth, cos_azimuth) = AZIMUTH_DEG.to_radians().sin_cos();
    let (sin_elevation, cos_elevation) = ELEVATION_DEG.to_radians().sin_cos();
    (cos_azimuth * point.x + sin_azimuth * point.y) * cos_elevation + point.z * sin_elevation
}
