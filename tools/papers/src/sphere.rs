//! Riemann sphere with points and curves, in parallel projection.

use attitude::Vector3;
use figures::{
    Area, DrawResult,
    style::{GREY, TEXT, TITLE},
};
use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

/// Azimuth from which the sphere is viewed, degrees: the angle about the vertical axis, measured
/// from the first axis.
const AZIMUTH_DEG: f64 = -65.0;
/// Elevation above the horizontal plane from which the sphere is viewed, degrees.
const ELEVATION_DEG: f64 = 24.0;
/// Half of the length, in radii, that fits along the shorter side of the picture.
const HALF_EXTENT: f64 = 1.55;

/// Unit sphere, the plane through its centre, the axes, and additional shapes.
#[derive(Debug)]
pub(crate) struct Sphere {
    pub(crate) title: String,
    /// Additional shapes, drawn in this order.
    pub(crate) shapes: Vec<Shape>,
}

/// Shape on the sphere or in the plane.
#[derive(Debug)]
pub(crate) enum Shape {
    Line {
        points: Vec<Vector3<f64>>,
        color: RGBAColor,
        width: u32,
    },
    /// Line on the sphere, drawn paler on the far side.
    OnSphere {
        points: Vec<Vector3<f64>>,
        color: RGBColor,
        width: u32,
    },
    Dots {
        points: Vec<Vector3<f64>>,
        color: RGBAColor,
        radius: u32,
    },
    /// Entry of the legend.
    LegendEntry {
        color: RGBColor,
        label: String,
    },
}

impl Sphere {
    pub(crate) fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let area = area.titled(&self.title, TITLE)?;
        let (width, height) = area.dim_in_pixel();
        let unit = f64::from(width.min(height)) * 0.5 / HALF_EXTENT;
        let centre = (f64::from(width) * 0.5, f64::from(height) * 0.5);
        let to_pixel = |point: &Vector3<f64>| {
            let [right, up, _] = viewed(point);
            ((centre.0 + right * unit).round() as i32, (centre.1 - up * unit).round() as i32)
        };
        let line = |points: &[Vector3<f64>], style: ShapeStyle| {
            area.draw(&PathElement::new(points.iter().map(to_pixel).collect::<Vec<_>>(), style))
        };
        let dot = |point: &Vector3<f64>, radius: u32, color: RGBAColor| {
            area.draw(&Circle::new(to_pixel(point), radius, color.filled()))
        };
        let text = |label: &str, position, h| {
            let style = TEXT.into_font().color(&BLACK).pos(Pos::new(h, VPos::Center));
            area.draw(&Text::new(label.to_string(), position, style))
        };
        for (points, strength) in background_lines() {
            line(&points, BLACK.mix(strength).stroke_width(1))?;
        }
        let axes = [(Vector3::x() * 1.45, "ξ', u"), (Vector3::y() * 1.45, "η', v"), (Vector3::z() * 1.35, "ζ'")];
        for (tip, label) in axes {
            let (tail, head) = (to_pixel(&Vector3::zeros()), to_pixel(&tip));
            draw_arrow(&area, tail, head, GREY)?;
            let beyond = |tail: i32, head: i32, room: f64| {
                let size = f64::from(head - tail);
                head + (room * size.signum() * (size.abs() / 40.0).min(1.0)) as i32
            };
            text(label, (beyond(tail.0, head.0, 20.0), beyond(tail.1, head.1, 13.0)), HPos::Center)?;
        }
        // The pole of the projection.
        dot(&-Vector3::z(), 3, BLACK.to_rgba())?;
        let mut legend_entries = 0;
        for shape in &self.shapes {
            match shape {
                Shape::Line { points, color, width } => line(points, color.stroke_width(*width))?,
                Shape::OnSphere { points, color, width } => {
                    let is_behind = |point: &Vector3<f64>| viewed(point)[2] < 0.0;
                    for run in points.chunk_by(|a, b| is_behind(a) == is_behind(b)) {
                        let strength = if run.first().is_some_and(is_behind) { 0.3 } else { 1.0 };
                        line(run, color.mix(strength).stroke_width(*width))?;
                    }
                }
                Shape::Dots { points, color, radius } => {
                    points.iter().try_for_each(|point| dot(point, *radius, *color))?;
                }
                Shape::LegendEntry { color, label } => {
                    let y = height as i32 - 14 - legend_entries * 22;
                    legend_entries += 1;
                    area.draw(&PathElement::new(vec![(12, y), (32, y)], color.stroke_width(3)))?;
                    text(label, (40, y), HPos::Left)?;
                }
            }
        }
        Ok(())
    }
}

/// Returns the coordinates of a point as viewed: to the right, up, and towards the viewer.
fn viewed(point: &Vector3<f64>) -> [f64; 3] {
    let (sin_azimuth, cos_azimuth) = AZIMUTH_DEG.to_radians().sin_cos();
    let (sin_elevation, cos_elevation) = ELEVATION_DEG.to_radians().sin_cos();
    let towards = cos_azimuth * point.x + sin_azimuth * point.y;
    [
        cos_azimuth * point.y - sin_azimuth * point.x,
        point.z * cos_elevation - towards * sin_elevation,
        towards * cos_elevation + point.z * sin_elevation,
    ]
}

/// Returns the border of the plane, the outline of the sphere and three great circles, each with
/// the opacity of its line.
fn background_lines() -> [(Vec<Vector3<f64>>, f64); 5] {
    let corners = [(-1.3, -1.3), (1.3, -1.3), (1.3, 1.3), (-1.3, 1.3), (-1.3, -1.3)];
    // The outline of the sphere is the great circle perpendicular to the line of sight.
    let (sin_azimuth, cos_azimuth) = AZIMUTH_DEG.to_radians().sin_cos();
    let (sin_elevation, cos_elevation) = ELEVATION_DEG.to_radians().sin_cos();
    let right = Vector3::new(-sin_azimuth, cos_azimuth, 0.0);
    let up = Vector3::new(-sin_elevation * cos_azimuth, -sin_elevation * sin_azimuth, cos_elevation);
    let circle = |a: Vector3<f64>, b: Vector3<f64>| {
        let point = |k: i32| f64::from(3 * k).to_radians().sin_cos();
        (0..=120).map(point).map(|(sin, cos)| a * cos + b * sin).collect()
    };
    [
        (corners.map(|(u, v)| Vector3::new(u, v, 0.0)).into(), 0.25),
        (circle(right, up), 0.6),
        (circle(Vector3::x(), Vector3::y()), 0.3),
        (circle(Vector3::x(), Vector3::z()), 0.15),
        (circle(Vector3::y(), Vector3::z()), 0.15),
    ]
}

/// Draws a line with an arrow head at its end.
fn draw_arrow<B: DrawingBackend>(area: &Area<B>, tail: (i32, i32), head: (i32, i32), color: RGBColor) -> DrawResult
where
    B::ErrorType: 'static,
{
    area.draw(&PathElement::new(vec![tail, head], color.stroke_width(2)))?;
    let (dx, dy) = (f64::from(head.0 - tail.0), f64::from(head.1 - tail.1));
    let size = dx.hypot(dy);
    let (dx, dy) = (dx / size, dy / size);
    let corner = |along: f64, across: f64| {
        (head.0 + (along * dx - across * dy).round() as i32, head.1 + (along * dy + across * dx).round() as i32)
    };
    area.draw(&Polygon::new(vec![head, corner(-10.0, 4.0), corner(-10.0, -4.0)], color.filled()))?;
    Ok(())
}
