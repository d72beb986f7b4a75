//! Three-dimensional scenes of lines and points: axes, rotations, the Riemann sphere.

use attitude::Vector3;
use figures::{
    Area, DrawResult,
    style::{TEXT, TITLE},
};
use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

/// Three-dimensional scene in parallel projection.
#[derive(Debug)]
pub(crate) struct Scene {
    pub(crate) title: String,
    /// Azimuth from which the scene is viewed, degrees: the angle about the vertical axis, measured
    /// from the first axis.
    pub(crate) azimuth_deg: f64,
    /// Elevation above the horizontal plane from which the scene is viewed, degrees.
    pub(crate) elevation_deg: f64,
    /// Half of the length, in scene units, that fits along the shorter side of the picture.
    pub(crate) half_extent: f64,
    pub(crate) shapes: Vec<Shape>,
}

/// Element of a scene. Elements are drawn in the order of the list.
#[derive(Debug)]
pub(crate) enum Shape {
    Line {
        points: Vec<Vector3<f64>>,
        color: RGBAColor,
        width: u32,
    },
    /// Line on the unit sphere, drawn paler on the far side.
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
    Arrow {
        from: Vector3<f64>,
        to: Vector3<f64>,
        color: RGBColor,
        label: String,
    },
    Text {
        at: Vector3<f64>,
        text: String,
    },
    /// Entry of the legend.
    LegendEntry {
        color: RGBColor,
        label: String,
    },
}

impl Scene {
    pub(crate) fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let area = area.titled(&self.title, TITLE)?;
        let (width, height) = area.dim_in_pixel();
        let unit = f64::from(width.min(height)) * 0.5 / self.half_extent;
        let centre = (f64::from(width) * 0.5, f64::from(height) * 0.5);
        let to_pixel = |point: &Vector3<f64>| {
            let (x, y) = self.project(point);
            ((centre.0 + x * unit).round() as i32, (centre.1 - y * unit).round() as i32)
        };
        let to_path = |points: &[Vector3<f64>]| points.iter().map(to_pixel).collect::<Vec<_>>();
        let text = TEXT.into_font().color(&BLACK).pos(Pos::new(HPos::Center, VPos::Center));
        let mut legend_entries = 0;
        for shape in &self.shapes {
            match shape {
                Shape::Line { points, color, width } => {
                    area.draw(&PathElement::new(to_path(points), color.stroke_width(*width)))?;
                }
                Shape::OnSphere { points, color, width } => {
                    for run in points.chunk_by(|a, b| (self.depth(a) < 0.0) == (self.depth(b) < 0.0)) {
                        let behind = run.first().is_some_and(|point| self.depth(point) < 0.0);
                        let style = color.mix(if behind { 0.3 } else { 1.0 }).stroke_width(*width);
                        area.draw(&PathElement::new(to_path(run), style))?;
                    }
                }
                Shape::Dots { points, color, radius } => {
                    for point in points {
                        area.draw(&Circle::new(to_pixel(point), *radius, color.filled()))?;
                    }
                }
                Shape::Arrow { from, to, color, label } => {
                    let (tail, head) = (to_pixel(from), to_pixel(to));
                    arrow(&area, &[tail, head], *color)?;
                    let beyond = |tail: i32, head: i32, room: f64| {
                        let size = f64::from(head - tail);
                        head + (room * size.signum() * (size.abs() / 40.0).min(1.0)) as i32
                    };
                    let position = (beyond(tail.0, head.0, 20.0), beyond(tail.1, head.1, 13.0));
                    area.draw(&Text::new(label.as_str(), position, text.clone()))?;
                }
                Shape::Text { at: position, text: content } => {
                    area.draw(&Text::new(content.as_str(), to_pixel(position), text.clone()))?;
                }
                Shape::LegendEntry { color, label } => {
                    let y = height as i32 - 14 - legend_entries * 22;
                    legend_entries += 1;
                    area.draw(&PathElement::new(vec![(12, y), (32, y)], color.stroke_width(3)))?;
                    let left = TEXT.into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
                    area.draw(&Text::new(label.as_str(), (40, y), left))?;
                }
            }
        }
        Ok(())
    }

    /// Returns the position of a point in the picture plane: to the right and up.
    fn project(&self, point: &Vector3<f64>) -> (f64, f64) {
        let (sin_azimuth, cos_azimuth) = self.azimuth_deg.to_radians().sin_cos();
        let (sin_elevation, cos_elevation) = self.elevation_deg.to_radians().sin_cos();
        let towards = cos_azimuth * point.x + sin_azimuth * point.y;
        (cos_azimuth * point.y - sin_azimuth * point.x, point.z * cos_elevation - towards * sin_elevation)
    }

    /// Returns the distance of a point from the centre towards the viewer; negative on the far
    /// side.
    fn depth(&self, point: &Vector3<f64>) -> f64 {
        let (sin_azimuth, cos_azimuth) = self.azimuth_deg.to_radians().sin_cos();
        let (sin_elevation, cos_elevation) = self.elevation_deg.to_radians().sin_cos();
        (cos_azimuth * point.x + sin_azimuth * point.y) * cos_elevation + point.z * sin_elevation
    }
}

/// Draws a path with an arrow head at its end.
pub(crate) fn arrow<B: DrawingBackend>(area: &Area<B>, path: &[(i32, i32)], color: RGBColor) -> DrawResult
where
    B::ErrorType: 'static,
{
    area.draw(&PathElement::new(path.to_vec(), color.stroke_width(2)))?;
    if let [.., before, end] = path {
        let (dx, dy) = (f64::from(end.0 - before.0), f64::from(end.1 - before.1));
        let size = dx.hypot(dy).max(1e-9);
        let (dx, dy) = (dx / size, dy / size);
        let corner = |along: f64, across: f64| {
            (end.0 + (along * dx - across * dy).round() as i32, end.1 + (along * dy + across * dx).round() as i32)
        };
        area.draw(&Polygon::new(vec![*end, corner(-10.0, 4.0), corner(-10.0, -4.0)], color.filled()))?;
    }
    Ok(())
}

/// Returns the points of a closed curve. `point` receives the cosine and sine of a parameter that
/// runs from 0 to 2π.
pub(crate) fn circle(point: impl Fn(f64, f64) -> Vector3<f64>) -> Vec<Vector3<f64>> {
    (0..=120).map(|k| f64::from(3 * k).to_radians().sin_cos()).map(|(sin, cos)| point(cos, sin)).collect()
}

/// Returns an arc that spans `angle_rad`. It starts at the unit vector `from` and turns towards the
/// unit vector `towards`, which is perpendicular to `from`.
pub(crate) fn arc(from: Vector3<f64>, towards: Vector3<f64>, angle_rad: f64, radius: f64) -> Vec<Vector3<f64>> {
    let point_at = |share: f64| {
        let (sin, cos) = (share * angle_rad).sin_cos();
        (from * cos + towards * sin) * radius
    };
    (0..=40).map(|k| point_at(f64::from(k) / 40.0)).collect()
}
