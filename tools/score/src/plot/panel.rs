//! Panels one above the other, over the same time.

use std::path::Path;

use plotters::{
    coord::Shift,
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use super::{Drawn, curve::Curve};

/// A step of a curve in degrees that is only the wrap of an angle.
const WRAP: f64 = 180.0;
const TITLE: (&str, u32) = ("sans-serif", 20);
const TEXT: (&str, u32) = ("sans-serif", 15);

/// Room for the names of the curves, beside the curves, pixels.
const LEGEND_WIDTH: u32 = 176;

/// One panel.
pub(crate) struct Panel<'a> {
    /// What the vertical axis shows, with its unit.
    pub(crate) label: &'a str,
    pub(crate) lines: Vec<Line<'a>>,
}

/// One curve of a panel.
pub(crate) struct Line<'a> {
    pub(crate) name: &'static str,
    pub(crate) color: RGBColor,
    pub(crate) curve: &'a Curve,
}

/// Draws the panels into a file.
pub(crate) fn draw(path: &Path, title: &str, size: (u32, u32), panels: &[Panel<'_>]) -> Drawn {
    let root = SVGBackend::new(path, size).into_drawing_area();
    root.fill(&WHITE)?;
    let area = root.titled(title, TITLE)?;
    for (area, panel) in area.split_evenly((panels.len(), 1)).iter().zip(panels) {
        panel.draw(area)?;
    }
    root.present()?;
    Ok(())
}

impl Panel<'_> {
    fn draw(&self, area: &DrawingArea<SVGBackend<'_>, Shift>) -> Drawn {
        let end_s = self.lines.iter().map(|line| line.curve.end_s()).fold(0.0, f64::max).max(1e-3);
        let (least, largest) = self.range();
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(if self.lines.len() > 1 { LEGEND_WIDTH } else { 24 })
            .x_label_area_size(38)
            .y_label_area_size(72)
            .build_cartesian_2d(0.0..end_s, least..largest)?;
        chart
            .configure_mesh()
            .x_desc("time, s")
            .y_desc(self.label)
            .label_style(TEXT)
            .axis_desc_style(TEXT)
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.12))
            .y_labels(6)
            .x_label_formatter(&number)
            .y_label_formatter(&number)
            .draw()?;
        for Line { color, curve, .. } in &self.lines {
            let parts = curve.lines(WRAP).map(|points| PathElement::new(points.to_vec(), color.stroke_width(1)));
            chart.draw_series(parts)?;
        }
        if self.lines.len() > 1 { self.legend(area) } else { Ok(()) }
    }

    /// The names of the curves, to the right of them.
    fn legend(&self, area: &DrawingArea<SVGBackend<'_>, Shift>) -> Drawn {
        let left = area.dim_in_pixel().0 as i32 - LEGEND_WIDTH as i32 + 14;
        let text = TEXT.into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        for (Line { name, color, .. }, y) in self.lines.iter().zip((16..).step_by(22)) {
            area.draw(&PathElement::new(vec![(left, y), (left + 24, y)], color.stroke_width(3)))?;
            area.draw(&Text::new(*name, (left + 32, y), text.clone()))?;
        }
        Ok(())
    }

    /// The range of all curves with some room around it.
    fn range(&self) -> (f64, f64) {
        let ranges = || self.lines.iter().filter_map(|line| line.curve.range());
        let least = ranges().map(|range| range.0).reduce(f64::min).unwrap_or(0.0);
        let largest = ranges().map(|range| range.1).reduce(f64::max).unwrap_or(1.0);
        let room = (0.05 * (largest - least)).max(1e-3);
        (least - room, largest + room)
    }
}

/// A number as short as it is: 20, 0.5, not 20.0, −0.0.
fn number(value: &f64) -> String {
    let text = format!("{value:.3}");
    match text.trim_end_matches('0').trim_end_matches('.') {
        "-0" => "0".into(),
        short => short.into(),
    }
}
