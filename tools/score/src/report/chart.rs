//! Chart as an inline SVG element.
//!
//! Input: lines of points.
//!
//! Output: a self-contained `svg` element. The range of the vertical axis ignores the outermost
//! points at both ends. If a line exceeds the axis, a note states its largest value.

use std::fmt::Write;

use crate::plot::curve::Curve;

/// Angle step between two consecutive points above which the angle has wrapped around, degrees. The
/// line is interrupted there.
const WRAP_DEG: f64 = 180.0;
/// Percentage of points at each end that the range of the vertical axis ignores.
const OUTLIER_PERCENT: f64 = 0.5;
/// Width and height of a chart, pixels.
const SIZE: [f64; 2] = [960.0, 230.0];
/// Left margin of a chart, with the labels of the vertical axis, pixels.
const LEFT: f64 = 64.0;
/// Right margin of a chart, pixels.
const RIGHT: f64 = 12.0;
/// Top margin of a chart, pixels.
const TOP: f64 = 12.0;
/// Bottom margin of a chart, with the labels of the horizontal axis, pixels.
const BOTTOM: f64 = 40.0;

/// Lines in one pair of axes.
pub(super) struct Chart<'a> {
    /// Label of the vertical axis, with its unit.
    pub(super) y_label: &'a str,
    /// Label of the horizontal axis, with its unit.
    pub(super) x_label: &'a str,
    /// Ends of the horizontal axis.
    pub(super) x_range: (f64, f64),
    /// `true` if the horizontal axis is logarithmic.
    pub(super) is_log_x: bool,
    /// `true` if the vertical axis starts at 0.
    pub(super) starts_at_zero: bool,
    pub(super) lines: Vec<Line>,
}

/// A line, which may have gaps.
pub(super) struct Line {
    /// Index of the stage; `None` for the reference.
    pub(super) stage: Option<usize>,
    pub(super) segments: Vec<Vec<(f64, f64)>>,
    /// Range of the values, excluding outliers.
    pub(super) y_range: Option<(f64, f64)>,
    /// `true` if each point has a marker.
    pub(super) has_markers: bool,
}

impl Line {
    /// Creates a line from the curve of an angle over time, degrees.
    pub(super) fn from_curve(curve: &Curve, stage: Option<usize>) -> Self {
        let segments = curve.segments(WRAP_DEG).map(<[_]>::to_vec).collect();
        Self { stage, segments, y_range: curve.robust_range(OUTLIER_PERCENT), has_markers: false }
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        self.segments.iter().flatten().copied()
    }
}

/// Mapping from values to pixels.
struct Axis {
    from: f64,
    to: f64,
    is_log: bool,
    pixels: [f64; 2],
}

impl Axis {
    fn pixel(&self, value: f64) -> f64 {
        let [value, from, to] = [value, self.from, self.to].map(|x| if self.is_log { x.ln() } else { x });
        self.pixels[0] + (value - from) / (to - from) * (self.pixels[1] - self.pixels[0])
    }

    /// Returns round tick values: on a logarithmic axis 1, 2 and 5 times powers of ten, on a linear
    /// axis the multiples of one such number.
    fn ticks(&self) -> Vec<f64> {
        if self.is_log {
            let decades = self.from.log10().floor() as i32..=self.to.log10().ceil() as i32;
            let in_decade = |decade: i32| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(decade));
            return decades.flat_map(in_decade).filter(|value| (self.from..=self.to).contains(value)).collect();
        }
        let rough = (self.to - self.from) / 5.0;
        let decade = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|digit| digit * decade).into_iter().find(|step| *step >= rough);
        let step = step.unwrap_or(rough);
        let first = (self.from / step).ceil() as i64;
        (first..).map(|i| i as f64 * step).take_while(|value| *value <= self.to).take(20).collect()
    }
}

impl Chart<'_> {
    /// Returns the SVG element, and a note if a line exceeds the axis. `number` must be unique on
    /// the page.
    pub(super) fn svg(&self, number: usize) -> (String, Option<String>) {
        let Some(largest) = self.lines.iter().flat_map(Line::points).map(|point| point.1).reduce(f64::max) else {
            return (String::new(), None);
        };
        let (first, last) = self.x_range;
        let [width, height] = SIZE;
        let x_axis = Axis {
            from: first,
            to: if last > first { last } else { first + 1e-3 },
            is_log: self.is_log_x,
            pixels: [LEFT, width - RIGHT],
        };
        let ranges = || self.lines.iter().filter_map(|line| line.y_range);
        let low = ranges().map(|range| range.0).fold(f64::INFINITY, f64::min);
        let high = ranges().map(|range| range.1).fold(f64::NEG_INFINITY, f64::max);
        let low = if self.starts_at_zero { 0.0 } else { low };
        let margin = (0.08 * (high - low)).max(1e-6 * high.abs()).max(1e-9);
        let y_axis = Axis {
            from: if self.starts_at_zero { 0.0 } else { low - margin },
            to: high + margin,
            is_log: false,
            pixels: [height - BOTTOM, TOP],
        };
        let mut svg = format!(
            "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{label}\"><clipPath id=\"c{number}\"><rect x=\"{LEFT}\" y=\"{TOP}\" width=\"{:.1}\" height=\"{:.1}\"/></clipPath>",
            width - LEFT - RIGHT,
            height - TOP - BOTTOM,
            label = escape(self.y_label),
        );
        self.draw_axes(&mut svg, &x_axis, &y_axis);
        let _ = write!(svg, "<g clip-path=\"url(#c{number})\">");
        // The reference is drawn last, on top, and the first stage above the other stages.
        let (reference, stages): (Vec<_>, Vec<_>) = self.lines.iter().partition(|line| line.stage.is_none());
        for line in stages.into_iter().rev().chain(reference) {
            draw_line(&mut svg, line, &x_axis, &y_axis);
        }
        svg.push_str("</g></svg>");
        let clip_note =
            (largest > y_axis.to).then(|| format!("axis ends at {:.2}; the largest value is {largest:.2}", y_axis.to));
        (svg, clip_note)
    }

    /// Draws grid, tick values and labels. Writing to a `String` cannot fail.
    fn draw_axes(&self, svg: &mut String, x_axis: &Axis, y_axis: &Axis) {
        let [width, height] = SIZE;
        for value in y_axis.ticks() {
            let y = y_axis.pixel(value);
            let _ = write!(
                svg,
                "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                width - RIGHT,
                LEFT - 6.0,
                y + 4.0,
                format_number(value)
            );
        }
        for value in x_axis.ticks() {
            let (x, bottom) = (x_axis.pixel(value), height - BOTTOM);
            let _ = write!(
                svg,
                "<line class=\"grid\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{TOP}\" y2=\"{bottom:.1}\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                bottom + 16.0,
                format_number(value)
            );
        }
        let middle = TOP + 0.5 * (height - TOP - BOTTOM);
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text><text transform=\"translate(14 {middle:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            0.5 * (LEFT + width - RIGHT),
            height - 6.0,
            escape(self.x_label),
            escape(self.y_label)
        );
    }
}

fn draw_line(svg: &mut String, line: &Line, x_axis: &Axis, y_axis: &Axis) {
    let css_class = stage_class(line.stage);
    for segment in &line.segments {
        let _ = write!(svg, "<polyline class=\"{css_class}\" points=\"");
        for (x, y) in segment {
            let _ = write!(svg, "{:.1},{:.1} ", x_axis.pixel(*x), y_axis.pixel(*y).clamp(-1e4, 1e4));
        }
        svg.push_str("\"/>");
        for (x, y) in segment.iter().filter(|_| line.has_markers) {
            let _ = write!(
                svg,
                "<circle class=\"{css_class}\" r=\"3\" cx=\"{:.1}\" cy=\"{:.1}\"/>",
                x_axis.pixel(*x),
                y_axis.pixel(*y)
            );
        }
    }
}

/// Returns the CSS class of a line.
pub(super) fn stage_class(stage: Option<usize>) -> String {
    stage.map_or("reference".into(), |index| format!("stage{}", index % STYLE_COUNT))
}

/// Formats a number without trailing zeros.
fn format_number(value: f64) -> String {
    let text = if value != 0.0 && value.abs() < 0.01 { format!("{value:.1e}") } else { format!("{value:.3}") };
    let short = if text.contains('e') { &text } else { text.trim_end_matches('0').trim_end_matches('.') };
    if short == "-0" { "0".into() } else { short.into() }
}

/// Number of line styles available for stages. Further stages reuse the styles in order.
pub(super) const STYLE_COUNT: usize = 6;

/// Escapes a text for HTML.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers() {
        let axis = |from, to, is_log| Axis { from, to, is_log, pixels: [0.0, 100.0] }.ticks();
        assert_eq!(axis(0.0, 10.0, false), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(axis(-0.7, 0.7, false).len(), 3);
        assert_eq!(axis(0.01, 0.5, true), [0.01, 0.02, 0.05, 0.1, 0.2, 0.5]);
        assert_eq!([0.0, -0.0, 20.0, 0.5, 1e-4].map(format_number), ["0", "0", "20", "0.5", "1.0e-4"]);
    }

    #[test]
    fn spike_is_clipped_and_reported() {
        let mut curve = Curve::with_bins(1000, 400);
        for i in 0..1000 {
            curve.push(f64::from(i), if i == 500 { 90.0 } else { 1.0 + f64::from(i % 7) });
        }
        curve.finish();
        let lines = vec![Line::from_curve(&curve, Some(0))];
        let chart = Chart {
            y_label: "error, °",
            x_label: "time, s",
            x_range: (0.0, 1000.0),
            is_log_x: false,
            starts_at_zero: true,
            lines,
        };
        let (svg, note) = chart.svg(1);
        assert!(note.is_some_and(|note| note.ends_with("largest value is 90.00")));
        assert!(svg.contains(">6</text>") && !svg.contains(">80</text>"), "{svg}");
    }
}
