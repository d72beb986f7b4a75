//! Curves over an axis, with the names of the curves beside them.

use std::ops::Range;

use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use crate::picture::{Area, Drawn, TEXT, TITLE, number};

/// Most points of a curve over time.
const POINTS: usize = 2000;
/// Room for the names of the curves, pixels.
const LEGEND_WIDTH: u32 = 168;

/// Curves in one pair of axes.
#[derive(Debug)]
pub(crate) struct Chart {
    pub(crate) title: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) curves: Vec<Curve>,
    /// The curves' names stand beside them.
    pub(crate) named: bool,
}

/// An axis, what it shows with its unit, and from where to where.
#[derive(Debug)]
pub(crate) struct Axis {
    pub(crate) label: &'static str,
    pub(crate) range: Range<f64>,
}

/// A curve or a cloud of dots; points that are not finite, or outside the axis, break it.
#[derive(Debug)]
pub(crate) struct Curve {
    /// In the legend; nothing where another curve stands for it.
    pub(crate) name: String,
    pub(crate) color: RGBColor,
    pub(crate) style: Style,
    pub(crate) points: Vec<(f64, f64)>,
}

/// How a curve is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Style {
    Thin,
    Thick,
    Wide,
    Dots,
}

impl Axis {
    pub(crate) fn new(label: &'static str, range: Range<f64>) -> Self {
        Self { label, range }
    }
}

impl Curve {
    pub(crate) fn new(name: impl Into<String>, color: RGBColor, style: Style, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), color, style, points }
    }

    /// A curve over time, of which each bin keeps its least and its largest value; broken where it jumps by more than `jump`.
    pub(crate) fn over_time(
        name: impl Into<String>,
        color: RGBColor,
        style: Style,
        values: &[(f64, f64)],
        jump: f64,
    ) -> Self {
        let bin = (2 * values.len()).div_ceil(POINTS).max(1);
        let mut points: Vec<(f64, f64)> = Vec::new();
        for bin in values.chunks(bin) {
            let least = bin.iter().copied().reduce(|a, b| if b.1 < a.1 { b } else { a });
            let most = bin.iter().copied().reduce(|a, b| if b.1 > a.1 { b } else { a });
            let mut ends: Vec<_> = least.into_iter().chain(most).collect();
            ends.sort_by(|a, b| a.0.total_cmp(&b.0));
            ends.dedup();
            for end in ends {
                if points.last().is_some_and(|last| (last.1 - end.1).abs() > jump) {
                    points.push((end.0, f64::NAN));
                }
                points.push(end);
            }
        }
        Self::new(name, color, style, points)
    }
}

impl Chart {
    pub(crate) fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(if self.named { LEGEND_WIDTH } else { 24 })
            .caption(&self.title, TITLE)
            .x_label_area_size(40)
            .y_label_area_size(66)
            .build_cartesian_2d(self.x.range.clone(), self.y.range.clone())?;
        chart
            .configure_mesh()
            .x_desc(self.x.label)
            .y_desc(self.y.label)
            .label_style(TEXT)
            .axis_desc_style(TEXT)
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.14))
            .x_labels(if self.named { 11 } else { 6 })
            .y_labels(9)
            .x_label_formatter(&number)
            .y_label_formatter(&number)
            .draw()?;
        for Curve { color, style, points, .. } in &self.curves {
            if *style == Style::Dots {
                chart.draw_series(points.iter().map(|point| Circle::new(*point, 1, color.mix(0.55).filled())))?;
                continue;
            }
            let width = match style {
                Style::Wide => 4,
                Style::Thick => 2,
                Style::Thin | Style::Dots => 1,
            };
            let outside = |point: &(f64, f64)| !(self.y.range.start..=self.y.range.end).contains(&point.1);
            let runs = points.split(outside).filter(|run| run.len() > 1);
            chart.draw_series(runs.map(|run| PathElement::new(run.to_vec(), color.stroke_width(width))))?;
        }
        if self.named { self.legend(area) } else { Ok(()) }
    }

    /// The names of the curves, to the right of them.
    fn legend<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let left = area.dim_in_pixel().0 as i32 - LEGEND_WIDTH as i32 + 14;
        let text = TEXT.into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        let named = self.curves.iter().filter(|curve| !curve.name.is_empty());
        for (Curve { name, color, style, .. }, y) in named.zip((44..).step_by(24)) {
            if *style == Style::Dots {
                area.draw(&Circle::new((left + 10, y), 3, color.filled()))?;
            } else {
                area.draw(&PathElement::new(vec![(left, y), (left + 20, y)], color.stroke_width(3)))?;
            }
            area.draw(&Text::new(name.as_str(), (left + 27, y), text.clone()))?;
        }
        Ok(())
    }
}
