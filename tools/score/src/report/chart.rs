//! A chart as SVG, to stand in a page.
//!
//! Input: lines of points. Output: an `svg` element that needs nothing else. An axis is as long as all but the outermost hundredth of the points need;
//! the rest is cut off, and the largest value is said.

use std::fmt::Write;

use super::escaped;
use crate::plot::curve::Curve;

/// A step of an angle, degrees, that is only its wrap.
const WRAP_DEG: f64 = 180.0;
/// Hundredths of the points at either end that do not make an axis longer.
const SPARED: f64 = 0.5;
/// Room for the whole, and beside the lines for words, pixels.
const SIZE: [f64; 2] = [960.0, 230.0];
const LEFT: f64 = 64.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 40.0;

/// Lines over one axis.
pub(super) struct Chart<'a> {
    /// What the vertical axis shows, with its unit.
    pub(super) label: &'a str,
    /// What the horizontal axis shows, with its unit.
    pub(super) across: &'a str,
    /// From where to where that goes.
    pub(super) span: (f64, f64),
    /// Equal factors are equally far apart across.
    pub(super) by_factors: bool,
    /// The vertical axis begins at 0.
    pub(super) from_zero: bool,
    pub(super) lines: Vec<Line>,
}

/// A line, which may have gaps.
pub(super) struct Line {
    /// Its place in the order of the stages; none is the reference.
    pub(super) place: Option<usize>,
    pub(super) parts: Vec<Vec<(f64, f64)>>,
    /// All but the outermost values.
    pub(super) range: Option<(f64, f64)>,
    /// Each point is marked.
    pub(super) marked: bool,
}

impl Line {
    /// A curve of degrees over time.
    pub(super) fn of(curve: &Curve, place: Option<usize>) -> Self {
        let parts = curve.lines(WRAP_DEG).map(<[_]>::to_vec).collect();
        Self { place, parts, range: curve.robust_range(SPARED), marked: false }
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        self.parts.iter().flatten().copied()
    }
}

/// From values to pixels.
struct Axis {
    from: f64,
    to: f64,
    by_factors: bool,
    at: [f64; 2],
}

impl Axis {
    fn pixel(&self, value: f64) -> f64 {
        let [value, from, to] = [value, self.from, self.to].map(|x| if self.by_factors { x.ln() } else { x });
        self.at[0] + (value - from) / (to - from) * (self.at[1] - self.at[0])
    }

    /// Values that people read: 1, 2 or 5 with zeros.
    fn ticks(&self) -> Vec<f64> {
        if self.by_factors {
            let decades = self.from.log10().floor() as i32..=self.to.log10().ceil() as i32;
            let of = |decade: i32| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(decade));
            return decades.flat_map(of).filter(|value| (self.from..=self.to).contains(value)).collect();
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
    /// The element; `number` is another for each chart of a page. With it, what was cut off, if anything was.
    pub(super) fn svg(&self, number: usize) -> (String, Option<String>) {
        let Some(largest) = self.lines.iter().flat_map(Line::points).map(|point| point.1).reduce(f64::max) else {
            return (String::new(), None);
        };
        let (first, last) = self.span;
        let [width, height] = SIZE;
        let across = Axis {
            from: first,
            to: if last > first { last } else { first + 1e-3 },
            by_factors: self.by_factors,
            at: [LEFT, width - RIGHT],
        };
        let ranges = || self.lines.iter().filter_map(|line| line.range);
        let least = ranges().map(|range| range.0).fold(f64::INFINITY, f64::min);
        let most = ranges().map(|range| range.1).fold(f64::NEG_INFINITY, f64::max);
        let least = if self.from_zero { 0.0 } else { least };
        let room = (0.08 * (most - least)).max(1e-6 * most.abs()).max(1e-9);
        let up = Axis {
            from: if self.from_zero { 0.0 } else { least - room },
            to: most + room,
            by_factors: false,
            at: [height - BOTTOM, TOP],
        };
        let mut svg = format!(
            "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{label}\"><clipPath id=\"c{number}\"><rect x=\"{LEFT}\" y=\"{TOP}\" width=\"{:.1}\" height=\"{:.1}\"/></clipPath>",
            width - LEFT - RIGHT,
            height - TOP - BOTTOM,
            label = escaped(self.label),
        );
        self.axes(&mut svg, &across, &up);
        let _ = write!(svg, "<g clip-path=\"url(#c{number})\">");
        // The reference lies over all, and the first stage over the others.
        let (reference, stages): (Vec<_>, Vec<_>) = self.lines.iter().partition(|line| line.place.is_none());
        for line in stages.into_iter().rev().chain(reference) {
            draw(&mut svg, line, &across, &up);
        }
        svg.push_str("</g></svg>");
        let cut = (largest > up.to).then(|| format!("cut off at {:.2}; the largest is {largest:.2}", up.to));
        (svg, cut)
    }

    /// Text cannot fail to be written into.
    fn axes(&self, svg: &mut String, across: &Axis, up: &Axis) {
        let [width, height] = SIZE;
        for value in up.ticks() {
            let y = up.pixel(value);
            let _ = write!(
                svg,
                "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                width - RIGHT,
                LEFT - 6.0,
                y + 4.0,
                number_of(value)
            );
        }
        for value in across.ticks() {
            let (x, bottom) = (across.pixel(value), height - BOTTOM);
            let _ = write!(
                svg,
                "<line class=\"grid\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{TOP}\" y2=\"{bottom:.1}\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                bottom + 16.0,
                number_of(value)
            );
        }
        let middle = TOP + 0.5 * (height - TOP - BOTTOM);
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text><text transform=\"translate(14 {middle:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            0.5 * (LEFT + width - RIGHT),
            height - 6.0,
            escaped(self.across),
            escaped(self.label)
        );
    }
}

fn draw(svg: &mut String, line: &Line, across: &Axis, up: &Axis) {
    let class = class(line.place);
    for part in &line.parts {
        let _ = write!(svg, "<polyline class=\"{class}\" points=\"");
        for (x, y) in part {
            let _ = write!(svg, "{:.1},{:.1} ", across.pixel(*x), up.pixel(*y).clamp(-1e4, 1e4));
        }
        svg.push_str("\"/>");
        for (x, y) in part.iter().filter(|_| line.marked) {
            let _ = write!(
                svg,
                "<circle class=\"{class}\" r=\"3\" cx=\"{:.1}\" cy=\"{:.1}\"/>",
                across.pixel(*x),
                up.pixel(*y)
            );
        }
    }
}

/// What a line is called in the page's style.
pub(super) fn class(place: Option<usize>) -> String {
    place.map_or("reference".into(), |place| format!("stage{}", place % super::STYLES))
}

/// A number as short as it is.
fn number_of(value: f64) -> String {
    let text = if value != 0.0 && value.abs() < 0.01 { format!("{value:.1e}") } else { format!("{value:.3}") };
    let short = if text.contains('e') { &text } else { text.trim_end_matches('0').trim_end_matches('.') };
    if short == "-0" { "0".into() } else { short.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_numbers_that_people_read() {
        let axis = |from, to, by_factors| Axis { from, to, by_factors, at: [0.0, 100.0] }.ticks();
        assert_eq!(axis(0.0, 10.0, false), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(axis(-0.7, 0.7, false).len(), 3);
        assert_eq!(axis(0.01, 0.5, true), [0.01, 0.02, 0.05, 0.1, 0.2, 0.5]);
        assert_eq!([0.0, -0.0, 20.0, 0.5, 1e-4].map(number_of), ["0", "0", "20", "0.5", "1.0e-4"]);
    }

    #[test]
    fn a_spike_makes_no_axis_longer_and_is_told() {
        let mut curve = Curve::in_bins(1000, 400);
        for i in 0..1000 {
            curve.push(f64::from(i), if i == 500 { 90.0 } else { 1.0 + f64::from(i % 7) });
        }
        curve.finish();
        let lines = vec![Line::of(&curve, Some(0))];
        let chart = Chart {
            label: "error, °",
            across: "time, s",
            span: (0.0, 1000.0),
            by_factors: false,
            from_zero: true,
            lines,
        };
        let (svg, cut) = chart.svg(1);
        assert!(cut.is_some_and(|cut| cut.ends_with("the largest is 90.00")));
        assert!(svg.contains(">6</text>") && !svg.contains(">80</text>"), "{svg}");
    }
}
