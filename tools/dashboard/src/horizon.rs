//! An artificial horizon: what somebody who looks along the body's forward axis sees.
//!
//! Input: the direction up in the body's axes right, forward, up. Output: dots; the ground is dotted, the sky is empty, the body is a bar with a dot.
//! A direction (x, f, y) of the picture is above the horizon where its product with up is positive, which holds in every attitude.

use ratatui::{
    Frame,
    layout::Rect,
    style::Style,
    symbols::Marker,
    widgets::canvas::{Canvas, Context, Painter, Shape},
};

use crate::drawing::{BLUE, GROUND, QUIET};

/// What is seen upwards and downwards of the forward axis, rad.
const HALF_VIEW_RAD: f64 = 0.7;
/// Dots of a character, across and down.
const DOTS: [f64; 2] = [2.0, 4.0];

/// As the direction up tells it; half the picture's height is 1.
struct Horizon {
    up: [f64; 3],
}

/// Draws it into a part of a picture.
pub(crate) fn draw(frame: &mut Frame<'_>, area: Rect, up: [f64; 3], dim: bool) {
    let [across, down] = [f64::from(area.width) * DOTS[0], f64::from(area.height) * DOTS[1]];
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
        frame.buffer_mut().set_style(area, Style::new().fg(QUIET));
    }
}

impl Horizon {
    /// How far a point of the picture is above the horizon, in heights of the picture.
    fn above(&self, x: f64, y: f64) -> f64 {
        let [right, forward, up] = self.up;
        let height = right * x + forward / HALF_VIEW_RAD.tan() + up * y;
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
                let above = self.above(x, y);
                let dot = height / rows.max(1) as f64;
                if above.abs() <= 0.5 * dot {
                    painter.paint(column, row, BLUE);
                } else if above < 0.0 && column % 4 == 0 && row % 4 == 2 {
                    painter.paint(column, row, GROUND);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn above(up: [f64; 3], x: f64, y: f64) -> bool {
        Horizon { up }.above(x, y) > 0.0
    }

    #[test]
    fn the_ground_is_where_somebody_on_board_sees_it() {
        let (sin, cos) = 0.35_f64.sin_cos();
        let level = [0.0, 0.0, 1.0];
        assert!(above(level, 0.0, 0.1) && !above(level, 0.0, -0.1));
        // Nose up: the forward axis points into the sky.
        let nose_up = [0.0, sin, cos];
        assert!(above(nose_up, 0.0, 0.0) && !above(nose_up, 0.0, -0.9));
        // Right side down: the ground rises at the right.
        let right_down = [-sin, 0.0, cos];
        assert!(!above(right_down, 0.9, 0.0) && above(right_down, -0.9, 0.0));
        let inverted = [0.0, 0.0, -1.0];
        assert!(!above(inverted, 0.0, 0.1) && above(inverted, 0.0, -0.1));
    }
}
