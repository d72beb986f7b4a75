//! Curves over an axis, with the names of the curves beside them, and charts one above the other.

use std::{borrow::Cow, error::Error, ops::Range};

use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use crate::{
    canvas::{Area, Draw, Drawn},
    dashes::dashes,
    style::{Style, TEXT, TITLE, number},
};

/// Most points of a curve over time.
const POINTS: usize = 2000;
/// Room for the names of the curves, pixels.
const LEGEND_WIDTH: u32 = 168;
/// Above and below a chart, and for each label beside it, pixels.
const BESIDE_HEIGHT: u32 = 56;
const LABEL_HEIGHT: u32 = 24;
/// The least size of a title.
const MIN_TITLE_SIZE: u32 = 9;

/// Curves in one pair of axes.
#[derive(Debug)]
pub struct Chart {
    /// Above it; nothing where it needs none.
    pub title: String,
    /// Across.
    pub x: Axis,
    /// Upwards.
    pub y: Axis,
    /// In the order in which they are drawn.
    pub curves: Vec<Curve>,
    /// The curves' names stand beside them.
    pub named: bool,
}

/// An axis, what it shows with its unit, and from where to where.
#[derive(Debug)]
pub struct Axis {
    /// What it shows, with the unit.
    pub label: Cow<'static, str>,
    /// From where to where.
    pub range: Range<f64>,
    /// Equal factors are equally far apart.
    pub by_factors: bool,
}

/// A curve or a cloud of dots; points that are not finite, or outside the axis, break it.
#[derive(Debug)]
pub struct Curve {
    /// In the legend; nothing where another curve stands for it.
    pub name: String,
    /// Its colour.
    pub color: RGBColor,
    /// How its line is drawn.
    pub style: Style,
    /// In their order.
    pub points: Vec<(f64, f64)>,
}

impl Axis {
    /// An axis of equal steps.
    pub fn new(label: impl Into<Cow<'static, str>>, range: Range<f64>) -> Self {
        Self { label: label.into(), range, by_factors: false }
    }

    /// Where a value is between the ends.
    fn at(&self, value: f64) -> f64 {
        if self.by_factors { value.log10() } else { value }
    }

    fn ends(&self) -> Range<f64> {
        self.at(self.range.start)..self.at(self.range.end)
    }

    fn told(&self, place: f64) -> String {
        if !self.by_factors {
            return number(&place);
        }
        let value = 10f64.powf(place);
        // Two digits tell a factor.
        let rounded = format!("{value:.1e}").parse().unwrap_or(value);
        if rounded < 0.01 { format!("{rounded:e}").replace('-', "−") } else { number(&rounded) }
    }
}

impl Curve {
    /// A curve of these points.
    pub fn new(name: impl Into<String>, color: RGBColor, style: Style, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), color, style, points }
    }

    /// A curve over time, of which each bin keeps its least and its largest value; broken where it jumps by more than `jump`.
    pub fn over_time(name: impl Into<String>, color: RGBColor, style: Style, values: &[(f64, f64)], jump: f64) -> Self {
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

impl Draw for Chart {
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let mut builder = ChartBuilder::on(area);
        builder
            .margin(8)
            .margin_right(if self.named { LEGEND_WIDTH } else { 24 })
            .x_label_area_size(40)
            .y_label_area_size(66);
        if !self.title.is_empty() {
            builder.caption(&self.title, fitting(area, &self.title)?);
        }
        let mut chart = builder.build_cartesian_2d(self.x.ends(), self.y.ends())?;
        chart
            .configure_mesh()
            .x_desc(self.x.label.as_ref())
            .y_desc(self.y.label.as_ref())
            .label_style(TEXT)
            .axis_desc_style(TEXT)
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.14))
            .x_labels(if self.named { 11 } else { 6 })
            .y_labels((area.dim_in_pixel().1.saturating_sub(BESIDE_HEIGHT) / LABEL_HEIGHT).clamp(2, 9) as usize)
            .x_label_formatter(&|place| self.x.told(*place))
            .y_label_formatter(&|place| self.y.told(*place))
            .draw()?;
        let width = f64::from(chart.plotting_area().dim_in_pixel().0.max(1));
        let (from, unit) = (self.x.ends().start, (self.x.ends().end - self.x.ends().start) / width);
        for Curve { color, style, points, .. } in &self.curves {
            let points: Vec<_> = points.iter().map(|(x, y)| (self.x.at(*x), self.y.at(*y))).collect();
            if *style == Style::Dots {
                chart.draw_series(points.iter().map(|point| Circle::new(*point, 1, color.mix(0.55).filled())))?;
                continue;
            }
            let outside = |point: &(f64, f64)| !(self.y.ends().start..=self.y.ends().end).contains(&point.1);
            let runs = points.split(outside).filter(|run| run.len() > 1);
            let stroke = color.stroke_width(style.width());
            if let Style::Dashed(on, off) = *style {
                let [on, off] = [on, off].map(|pixels| f64::from(pixels) * unit);
                let pieces = runs.flat_map(|run| dashes(run, from, on, off));
                chart.draw_series(pieces.map(|piece| PathElement::new(piece, stroke)))?;
            } else {
                chart.draw_series(runs.map(|run| PathElement::new(run.to_vec(), stroke)))?;
            }
        }
        if self.named { self.legend(area) } else { Ok(()) }
    }
}

impl Chart {
    /// The names of the curves, to the right of them.
    fn legend<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
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
            if *style == Style::Dots {
                area.draw(&Circle::new((left + 10, y), 3, color.filled()))?;
            } else if let Style::Dashed(on, off) = *style {
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

/// How a title is written that is not to be wider than the figure.
fn fitting<B: DrawingBackend>(area: &Area<B>, title: &str) -> Result<(&'static str, u32), Box<dyn Error + Send + Sync>>
where
    B::ErrorType: 'static,
{
    let (name, size) = TITLE;
    let (width, _) = area.estimate_text_size(title, &TITLE.into_text_style(area))?;
    let room = area.dim_in_pixel().0.saturating_sub(16);
    Ok((name, if width > room { (size * room / width).max(MIN_TITLE_SIZE) } else { size }))
}

/// Charts one above the other.
#[derive(Debug)]
pub struct Stack {
    /// Above them all.
    pub title: String,
    /// From the top.
    pub charts: Vec<Chart>,
}

impl Draw for Stack {
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn
    where
        B::ErrorType: 'static,
    {
        let area = area.titled(&self.title, fitting(area, &self.title)?)?;
        let areas = area.split_evenly((self.charts.len().max(1), 1));
        areas.iter().zip(&self.charts).try_for_each(|(area, chart)| chart.draw(area))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;
    use crate::{canvas::svg, style};

    #[test]
    fn a_dashed_curve_is_in_pieces_and_a_wide_range_is_by_factors() {
        let chart = |style| {
            let line = (0..=100).map(|k| (10f64.powf(f64::from(k) * 0.04 - 2.0), f64::from(k))).collect();
            let x = Axis { by_factors: true, ..Axis::new("β, rad/s", 0.01..100.0) };
            let curves = vec![Curve::new("one", style::BLUE, style, line)];
            let chart = Chart { title: String::new(), x, y: Axis::new("error, °", 0.0..100.0), curves, named: true };
            svg((600, 400), &Stack { title: "all".into(), charts: vec![chart] }).unwrap()
        };
        let [whole, broken] = [Style::Thick, Style::Dashed(10, 10)].map(chart);
        let lines = |text: &str| text.matches("<polyline").count();
        assert!((15..40).contains(&(lines(&broken) - lines(&whole))), "{} {}", lines(&whole), lines(&broken));
        for words in ["β, rad/s", "error, °", "all", "one", ">\n0.1\n<", ">\n10\n<"] {
            assert!(whole.contains(words), "no {words:?} in {whole}");
        }
    }
}
