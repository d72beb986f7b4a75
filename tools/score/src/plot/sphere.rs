//! The Riemann sphere: the up vector on it, and its stereographic projection on the plane of w.
//!
//! The plane is that of ξ and η through the centre; from the pole −ζ a ray through a point of the plane meets the sphere in the up
//! vector — Matveev 2025, (12).

use attitude::Vector3;
use figures::{
    Area, Draw, Drawn,
    style::{AMBER, BLUE, ORANGE, TEXT, TITLE},
};
use plotters::{
    coord::types::RangedCoordf64,
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

/// Half the side of the plane that is drawn; w beyond it is left out.
const PLANE: f64 = 1.6;
/// Rays from the pole that are drawn.
const RAYS: usize = 6;
/// From where the sphere is seen, about the vertical and above the plane.
const AZIMUTH_DEG: f64 = -65.0;
const ELEVATION_DEG: f64 = 22.0;

const POLE: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The way of an up vector.
pub(crate) struct Sphere<'a> {
    pub(crate) title: String,
    pub(crate) ups: &'a [Vector3<f64>],
}

impl Draw for Sphere<'_> {
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let area = area.titled(&self.title, TITLE)?;
        let mut chart = ChartBuilder::on(&area).margin(10).build_cartesian_2d(-2.0..2.0, -2.1..1.8)?;
        scene(&mut chart)?;
        way(&mut chart, self.ups)?;
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

/// Sphere, plane, axes.
fn scene<B: DrawingBackend>(chart: &mut Chart<'_, B>) -> Drawn
where
    B::ErrorType: 'static,
{
    let corners = [(-PLANE, -PLANE), (PLANE, -PLANE), (PLANE, PLANE), (-PLANE, PLANE)];
    let plane: Vec<_> = corners.iter().map(|(u, v)| seen(&Vector3::new(*u, *v, 0.0))).collect();
    chart.draw_series([Polygon::new(plane, RGBColor(240, 236, 220).mix(0.8))])?;
    let circle =
        |of: &dyn Fn(f64) -> (f64, f64)| -> Vec<_> { (0..=180).map(|k| of(f64::from(2 * k).to_radians())).collect() };
    let outline = circle(&|angle| (angle.cos(), angle.sin()));
    let equator = circle(&|angle| seen(&Vector3::new(angle.cos(), angle.sin(), 0.0)));
    let right = circle(&|angle| seen(&Vector3::new(angle.sin(), 0.0, angle.cos())));
    let forward = circle(&|angle| seen(&Vector3::new(0.0, angle.sin(), angle.cos())));
    let grey = BLACK.mix(0.25);
    chart.draw_series([equator, right, forward].map(|line| PathElement::new(line, grey)))?;
    chart.draw_series([PathElement::new(outline, BLACK.mix(0.6).stroke_width(2))])?;
    let axes = [
        (Vector3::new(PLANE, 0.0, 0.0), "u (ξ, right)"),
        (Vector3::new(0.0, PLANE, 0.0), "v (η, forward)"),
        (Vector3::new(0.0, 0.0, 1.35), "ζ: level, w = 0"),
        (Vector3::new(0.0, 0.0, -1.35), "−ζ: upside down, w = ∞"),
    ];
    let axis = |(end, _): &(Vector3<f64>, _)| PathElement::new(vec![(0.0, 0.0), seen(end)], BLACK.mix(0.5));
    chart.draw_series(axes.iter().map(axis))?;
    let text = TEXT.into_font().color(&BLACK).pos(Pos::new(HPos::Center, VPos::Center));
    chart.draw_series(axes.iter().map(|(end, name)| Text::new(*name, seen(&(end * 1.1)), text.clone())))?;
    chart.draw_series([Circle::new(seen(&POLE), 4, BLACK.filled())])?;
    Ok(())
}

/// The way of the up vector, that of w, and rays between them.
fn way<B: DrawingBackend>(chart: &mut Chart<'_, B>, ups: &[Vector3<f64>]) -> Drawn
where
    B::ErrorType: 'static,
{
    let legend = |color: RGBColor| move |(x, y)| PathElement::new(vec![(x, y), (x + 26, y)], color.stroke_width(3));
    let plane = lines(ups, |up| point(up).map(|w| seen(&w)));
    chart
        .draw_series(plane.into_iter().map(|line| PathElement::new(line, AMBER)))?
        .label("w = u + jv in the plane")
        .legend(legend(AMBER));
    let behind = lines(ups, |up| (depth(up) < 0.0).then(|| seen(up)));
    chart.draw_series(behind.into_iter().map(|line| PathElement::new(line, BLUE.mix(0.35))))?;
    let before = lines(ups, |up| (depth(up) >= 0.0).then(|| seen(up)));
    chart
        .draw_series(before.into_iter().map(|line| PathElement::new(line, BLUE)))?
        .label("the up vector in body axes, pale where it is behind")
        .legend(legend(BLUE));
    let rays: Vec<_> =
        (0..RAYS).filter_map(|k| ups.get(k * ups.len() / RAYS)).filter_map(|up| Some((*up, point(up)?))).collect();
    chart.draw_series(rays.iter().map(|(up, w)| {
        let ends = if up.z < 0.0 { [POLE, *w] } else { [POLE, *up] };
        PathElement::new(ends.map(|end| seen(&end)).to_vec(), BLACK.mix(0.35))
    }))?;
    let ends = rays.iter().flat_map(|(up, w)| [*up, *w]);
    chart
        .draw_series(ends.map(|end| Circle::new(seen(&end), 3, ORANGE.filled())))?
        .label("on one ray from −ζ: w and its up vector")
        .legend(|(x, y)| Circle::new((x + 13, y), 4, ORANGE.filled()));
    Ok(())
}

/// The runs of points that have a place on the paper.
fn lines(ups: &[Vector3<f64>], place: impl Fn(&Vector3<f64>) -> Option<(f64, f64)>) -> Vec<Vec<(f64, f64)>> {
    let places: Vec<_> = ups.iter().map(place).collect();
    let runs = places.split(Option::is_none).filter(|run| run.len() > 1);
    runs.map(|run| run.iter().copied().flatten().collect()).collect()
}

/// w of an up vector in the plane, where it is drawn.
fn point(up: &Vector3<f64>) -> Option<Vector3<f64>> {
    let w = Vector3::new(up.x, up.y, 0.0) / (1.0 + up.z);
    (w.amax() <= PLANE).then_some(w)
}

/// Where a point of space is on the paper.
fn seen(at: &Vector3<f64>) -> (f64, f64) {
    let (sin_azimuth, cos_azimuth) = AZIMUTH_DEG.to_radians().sin_cos();
    let (sin_elevation, cos_elevation) = ELEVATION_DEG.to_radians().sin_cos();
    let towards = cos_azimuth * at.x + sin_azimuth * at.y;
    (cos_azimuth * at.y - sin_azimuth * at.x, at.z * cos_elevation - towards * sin_elevation)
}

/// How near to the eye a point of space is, from the centre.
fn depth(at: &Vector3<f64>) -> f64 {
    let (sin_azimuth, cos_azimuth) = AZIMUTH_DEG.to_radians().sin_cos();
    let (sin_elevation, cos_elevation) = ELEVATION_DEG.to_radians().sin_cos();
    (cos_azimuth * at.x + sin_azimuth * at.y) * cos_elevation + at.z * sin_elevation
}
