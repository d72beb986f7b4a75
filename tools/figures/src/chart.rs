//! Charts: curves in a pair of axes with a legend, and charts stacked vertically.

use std::{borrow::Cow, error::Error, ops::Range};

use plotters::{
    coord::{
        ranged1d::{DefaultFormatting, KeyPointHint},
        types::RangedCoordf64,
    },
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use crate::{
    canvas::{Area, Draw, DrawResult},
    dashes::dashes,
    style::{LineStyle, TEXT, TITLE, format_number},
};

/// Approximate maximum number of points in a curve over time.
const MAX_POINTS: usize = 2000;
/// Width of the legend, pixels.
const LEGEND_WIDTH: u32 = 168;
/// Total height of a chart's margins and horizontal axis labels, pixels.
const LABEL_MARGIN_HEIGHT: u32 = 56;
/// Minimum height per label of the vertical axis, pixels.
const MIN_LABEL_HEIGHT: u32 = 24;
/// Minimum font size of a title.
const MIN_TITLE_SIZE: u32 = 9;

/// Curves in one pair of axes.
#[derive(Debug)]
pub struct Chart {
    /// Title above the chart; empty for no title.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Curves in drawing order.
    pub curves: Vec<Curve>,
    /// `true` to draw a legend with the names of the curves on the right.
    pub has_legend: bool,
}

/// An axis: its label, range and scale.
#[derive(Debug)]
pub struct Axis {
    /// Label with the unit.
    pub label: Cow<'static, str>,
    /// Values at the two ends.
    pub range: Range<f64>,
    /// `true` for a logarithmic scale, which requires a positive range.
    pub is_log: bool,
}

/// A curve or a cloud of dots. Points that are not finite or lie outside the vertical range
/// interrupt the curve.
#[derive(Debug)]
pub struct Curve {
    /// Name in the legend; empty if the curve has no legend entry.
    pub name: String,
    /// Colour.
    pub color: RGBColor,
    /// Line style.
    pub style: LineStyle,
    /// Points in drawing order.
    pub points: Vec<(f64, f64)>,
    /// `true` to draw a dot at each point of a line.
    pub has_markers: bool,
}

impl Axis {
    /// Creates a linear axis.
    pub fn new(label: impl Into<Cow<'static, str>>, range: Range<f64>) -> Self {
        Self { label: label.into(), range, is_log: false }
    }

    /// Returns the position of a value on the scale of the axis.
    fn to_scale(&self, value: f64) -> f64 {
        if self.is_log { value.log10() } else { value }
    }

    fn ends(&self) -> Range<f64> {
        self.to_scale(self.range.start)..self.to_scale(self.range.end)
    }

    fn positions(&self) -> Positions {
        Positions { range: self.ends().into(), is_log: self.is_log }
    }

    fn tick_label(&self, position: f64) -> String {
        if !self.is_log {
            return format_number(&position);
        }
        let value = 10f64.powf(position);
        // Two digits are enough on a logarithmic scale.
        let rounded = format!("{value:.1e}").parse().unwrap_or(value);
        if rounded < 0.01 { format!("{rounded:e}").replace('-', "−") } else { format_number(&rounded) }
    }
}

/// Positions along an axis: values, or their decimal logarithms on a logarithmic scale.
struct Positions {
    range: RangedCoordf64,
    is_log: bool,
}

impl Ranged for Positions {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, position: &f64, limit: (i32, i32)) -> i32 {
        self.range.map(position, limit)
    }

    /// Returns the positions of the ticks. On a logarithmic scale the ticks are 1, 2 and 5 times
    /// the powers of ten, or only the powers if there is no room for more.
    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if !self.is_log {
            return self.range.key_points(hint);
        }
        let Range { start, end } = self.range();
        let decades = start.floor() as i32..=end.ceil() as i32;
        let ticks = |digits: &[f64]| -> Vec<f64> {
            let ticks =
                decades.clone().flat_map(|decade| digits.iter().map(move |digit| f64::from(decade) + digit.log10()));
            ticks.filter(|tick| (start..=end).contains(tick)).collect()
        };
        let all = ticks(&[1.0, 2.0, 5.0]);
        if all.len() <= hint.max_num_points() { all } else { ticks(&[1.0]) }
    }

    fn range(&self) -> Range<f64> {
        self.range.range()
    }
}

impl Curve {
    /// Creates a curve from points.
    pub fn new(name: impl Into<String>, color: RGBColor, style: LineStyle, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), color, style, points, has_markers: false }
    }

    /// Creates a decimated curve over time, in which each bin keeps its smallest and largest value.
    ///
    /// The curve is interrupted at steps of more than `max_step` between consecutive points, such
    /// as the wrap-around of an angle.
    pub fn over_time(
        name: impl Into<String>,
        color: RGBColor,
        style: LineStyle,
        values: &[(f64, f64)],
        max_step: f64,
    ) -> Self {
        let bin_size = (2 * values.len()).div_ceil(MAX_POINTS).max(1);
        let mut points: Vec<(f64, f64)> = Vec::new();
        for bin in values.chunks(bin_size) {
            let min = bin.iter().copied().reduce(|a, b| if b.1 < a.1 { b } else { a });
            let max = bin.iter().copied().reduce(|a, b| if b.1 > a.1 { b } else { a });
            let mut ends: Vec<_> = min.into_iter().chain(max).collect();
            ends.sort_by(|a, b| a.0.total_cmp(&b.0));
            ends.dedup();
            for end in ends {
                if points.last().is_some_and(|last| (last.1 - end.1).abs() > max_step) {
                    points.push((end.0, f64::NAN));
                }
                points.push(end);
            }
        }
        Self::new(name, color, style, points)
    }
}

impl Draw for Chart {
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let mut builder = ChartBuilder::on(area);
        builder
            .margin(8)
            .margin_right(if self.has_legend { LEGEND_WIDTH } else { 24 })
            .x_label_area_size(40)
            .y_label_area_size(66);
        if !self.title.is_empty() {
            builder.caption(&self.title, title_style(area, &self.title)?);
        }
        let mut chart = builder.build_cartesian_2d(self.x.positions(), self.y.positions())?;
        chart
            .configure_mesh()
            .x_desc(self.x.label.as_ref())
            .y_desc(self.y.label.as_ref())
            .label_style(TEXT)
            .axis_desc_style(TEXT)
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.14))
            .x_labels(if self.has_legend { 11 } else { 6 })
            .y_labels(
                (area.dim_in_pixel().1.saturating_sub(LABEL_MARGIN_HEIGHT) / MIN_LABEL_HEIGHT).clamp(2, 9) as usize
            )
            .x_label_formatter(&|place| self.x.tick_label(*place))
            .y_label_formatter(&|place| self.y.tick_label(*place))
            .draw()?;
        let width = f64::from(chart.plotting_area().dim_in_pixel().0.max(1));
        let (from, unit) = (self.x.ends().start, (self.x.ends().end - self.x.ends().start) / width);
        for Curve { color, style, points, has_markers, .. } in &self.curves {
            let points: Vec<_> = points.iter().map(|(x, y)| (self.x.to_scale(*x), self.y.to_scale(*y))).collect();
            if *style == LineStyle::Dots {
                chart.draw_series(points.iter().map(|point| Circle::new(*point, 1, color.mix(0.55).filled())))?;
                continue;
            }
            let outside = |point: &(f64, f64)| !(self.y.ends().start..=self.y.ends().end).contains(&point.1);
            let runs = points.split(outside).filter(|run| run.len() > 1);
            let stroke = color.stroke_width(style.width());
            if let LineStyle::Dashed(on, off) = *style {
                let [on, off] = [on, off].map(|pixels| f64::from(pixels) * unit);
                let pieces = runs.flat_map(|run| dashes(run, from, on, off));
                chart.draw_series(pieces.map(|piece| PathElement::new(piece, stroke)))?;
            } else {
                chart.draw_series(runs.map(|run| PathElement::new(run.to_vec(), stroke)))?;
            }
            let markers = points.iter().filter(|_| *has_markers);
            chart.draw_series(markers.map(|point| Circle::new(*point, 3, color.filled())))?;
        }
        if self.has_legend { self.draw_legend(area) } else { Ok(()) }
    }
}

impl Chart {
    /// Draws the legend to the right of the curves.
    fn draw_legend<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let left = area.dim_in_pixel().0 as i32 - LEGEND_WIDTH as i32 + 14;
        let text = TEXT.into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        let named: Vec<_> = self.curves.iter().filter(|curve| !curve.name.is_empty()).collect();
        let height = area.dim_in_pixel().1 as usize;
        let first = (height / 4).min(44);
        let step = ((height - first) / named.len().max(1)).clamp(14, 24);
        for (Curve { name, color, style, .. }, y) in named.into_iter().zip((first as i32..).step_by(step)) {
            if *style == LineStyle::Dots {
                area.draw(&Circle::new((left + 10, y), 3, color.filled()))?;
            } else if let LineStyle::Dashed(on, off) = *style {
                let line = [(f64::from(left), 0.0), (f64::from(left + 20), 0.0)];
                for piece in dashes(&line, f64::from(left), f64::from(on.min(12)), f64::from(off)) {
                    let piece: Vec<_> = piece.iter().map(|(x, _)| (x.round() as i32, y)).collect();
                    area.draw(&PathElement::new(piece, color.stroke_width(3)))?;
                }
            } else {
                area.draw(&PathElement::new(vec![(left, y), (left + 20, y)], color.stroke_width(3)))?;
            }
            area.draw(&Text::new(name.as_str(), (left + 27, y), text.clone()))?;
        }
        Ok(())
    }
}

/// Returns the font of a title, reduced in size if the title is wider than the figure.
fn title_style<B: DrawingBackend>(
    area: &Area<B>,
    title: &str,
) -> Result<(&'static str, u32), Box<dyn Error + Send + Sync>>
where
    B::ErrorType: 'static,
{
    let (name, size) = TITLE;
    let (width, _) = area.estimate_text_size(title, &TITLE.into_text_style(area))?;
    let room = area.dim_in_pixel().0.saturating_sub(16);
    Ok((name, if width > room { (size * room / width).max(MIN_TITLE_SIZE) } else { size }))
}

/// Charts stacked vertically.
#[derive(Debug)]
pub struct Stack {
    /// Title above all charts.
    pub title: String,
    /// Charts from top to bottom.
    pub charts: Vec<Chart>,
}

impl Draw for Stack {
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let area = area.titled(&self.title, title_style(area, &self.title)?)?;
        let areas = area.split_evenly((self.charts.len().max(1), 1));
        areas.iter().zip(&self.charts).try_for_each(|(area, chart)| chart.draw(area))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{canvas::svg, style};

    #[test]
    fn dashes_are_separate_lines_and_log_axis_has_decade_ticks() {
        let chart = |style| {
            let line = (0..=100).map(|k| (10f64.powf(f64::from(k) * 0.04 - 2.0), f64::from(k))).collect();
            let x = Axis { is_log: true, ..Axis::new("β, rad/s", 0.01..100.0) };
            let curves = vec![Curve::new("one", style::BLUE, style, line)];
            let chart =
                Chart { title: String::new(), x, y: Axis::new("error, °", 0.0..100.0), curves, has_legend: true };
            svg((600, 400), &Stack { title: "all".into(), charts: vec![chart] }).unwrap()
        };
        let [whole, broken] = [LineStyle::Thick, LineStyle::Dashed(10, 10)].map(chart);
        let lines = |text: &str| text.matches("<polyline").count();
        assert!((15..40).contains(&(lines(&broken) - lines(&whole))), "{} {}", lines(&whole), lines(&broken));
        for words in ["β, rad/s", "error, °", "all", "one", ">\n0.1\n<", ">\n10\n<"] {
            assert!(whole.contains(words), "no {words:?} in {whole}");
        }
    }
}
