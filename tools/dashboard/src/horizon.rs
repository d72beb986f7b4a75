//! Artificial horizon: the view along the body's forward axis.
//!
//! - Input: the up direction in body axes right, forward, up.
//! - Output: a dot canvas with dotted ground, empty sky and the body as a bar with a centre mark.
//!
//! A direction (right, forward, up) in the view is above the horizon if its dot product with the up
//! vector is positive. This holds in every attitude.

use ratatui::{
    Frame,
    layout::Rect,
    style::Style,
    symbols::Marker,
    widgets::canvas::{Canvas, Context, Painter, Shape},
};

use crate::colours::{BLUE, GROUND, MUTED};

/// Half the vertical field of view, rad.
const HALF_FIELD_OF_VIEW_RAD: f64 = 0.7;
/// Dots per character: horizontal, vertical.
const DOTS_PER_CHARACTER: [f64; 2] = [2.0, 4.0];

/// Artificial horizon. Lengths are in units of half the view height.
struct Horizon {
    up: [f64; 3],
}

/// Draws the horizon into `area`.
pub(crate) fn draw(frame: &mut Frame<'_>, area: Rect, up: [f64; 3], dim: bool) {
    let [across, down] =
        [f64::from(area.width) * DOTS_PER_CHARACTER[0], f64::from(area.height) * DOTS_PER_CHARACTER[1]];
    let half_width = across / down.max(1.0);
    let paint = |context: &mut Context<'_>| {
        context.draw(&Horizon { up });
        context.layer();
        context.print(0.0, 0.0, "o");
        for side in [-1.0, 1.0] {
            context.print(side * half_width * 0.3, 0.0, "──");
        }
    };
    let canvas = Canvas::default().marker(Marker::Braille).x_bounds([-half_width, half_width]).y_bounds([-1.0, 1.0]);
    frame.render_widget(canvas.paint(paint), area);
    if dim {
        frame.buffer_mut().set_style(area, Style::new().fg(MUTED));
    }
}

impl Horizon {
    /// Returns the height of a point above the horizon in units of half the view height.
    fn height_above(&self, x: f64, y: f64) -> f64 {
        let [right, forward, up] = self.up;
        let height = right * x + forward / HALF_FIELD_OF_VIEW_RAD.tan() + up * y;
        height / right.hypot(up).max(1e-3)
    }
}

impl Shape for Horizon {
    fn draw(&self, painter: &mut Painter<'_, '_>) {
        let ([left, right], [bottom, top]) = (*painter.bounds().0, *painter.bounds().1);
        let Some((columns, rows)) = painter.get_point(right, bottom) else { return };
        let (width, height) = (right - left, top - bottom);
        for row in 0..=rows {
            for column in 0..=columns {
                let x = left + width * (column as f64 / columns.max(1) as f64);
                let y = top - height * (row as f64 / rows.max(1) as f64);
                let height_above = self.height_above(x, y);
                let dot = height / rows.max(1) as f64;
                if height_above.abs() <= 0.5 * dot {
                    painter.paint(column, row, BLUE);
                } else if height_above < 0.0 && column % 4 == 0 && row % 4 == 2 {
                    painter.paint(column, row, GROUND);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_above(up: [f64; 3], x: f64, y: f64) -> bool {
        Horizon { up }.height_above(x, y) > 0.0
    }

    #[test]
    fn ground_is_below_horizon_in_every_attitude() {
        let (sin, cos) = 0.35_f64.sin_cos();
        let level = [0.0, 0.0, 1.0];
        assert!(is_above(level, 0.0, 0.1) && !is_above(level, 0.0, -0.1));
        // Nose up: the forward axis points into the sky.
        let nose_up = [0.0, sin, cos];
        assert!(is_above(nose_up, 0.0, 0.0) && !is_above(nose_up, 0.0, -0.9));
        // Right side down: the ground rises at the right.
        let right_down = [-sin, 0.0, cos];
        assert!(!is_above(right_down, 0.9, 0.0) && is_above(right_down, -0.9, 0.0));
        let inverted = [0.0, 0.0, -1.0];
        assert!(!is_above(inverted, 0.0, 0.1) && is_above(inverted, 0.0, -0.1));
    }
}
