//! Charts of the figures and of the HTML report: curves over time, and the error over a setting.

use std::ops::Range;

use figures::{Axis, Chart, style::LineStyle};
use plotters::style::RGBColor;

use super::curve::{Curve, min_and_max};
use crate::{table::Sweep, tune::is_log_range};

/// Largest step of an angle between two consecutive points, degrees. A larger step means that the
/// angle has wrapped around, so the curve is interrupted.
const WRAP_DEG: f64 = 180.0;

/// A curve over time with its name and line style.
pub(crate) struct Series<'a> {
    pub(crate) name: &'a str,
    pub(crate) style: (RGBColor, LineStyle),
    pub(crate) curve: &'a Curve,
}

/// Returns a chart of curves over time without a legend. Values outside `y_range` are drawn at the
/// nearest end of this range. The smallest and the largest value of each `merged_bins` bins of a
/// curve are drawn.
pub(crate) fn time_chart(
    label: &'static str,
    x_range: Range<f64>,
    y_range: Range<f64>,
    series: &[Series<'_>],
    merged_bins: usize,
) -> Chart {
    let clipped = |(t_s, value): (f64, f64)| (t_s, value.clamp(y_range.start, y_range.end));
    let curves = series.iter().map(|Series { name, style: (color, style), curve }| {
        let with_gap = |line: &[(f64, f64)]| -> Vec<_> {
            min_and_max(line, merged_bins).into_iter().map(clipped).chain([(f64::NAN, f64::NAN)]).collect()
        };
        figures::Curve::new(*name, *color, *style, curve.segments(WRAP_DEG).flat_map(with_gap).collect())
    });
    Chart {
        title: String::new(),
        curves: curves.collect(),
        x: Axis::new("time, s", x_range),
        y: Axis::new(label, y_range),
        has_legend: false,
    }
}

/// Returns a chart of the error over the values of one setting; `None` if there are no sweeps.
///
/// Each sweep has its own line style.
pub(crate) fn sweep_chart(sweeps: &[(&Sweep, (RGBColor, LineStyle))]) -> Option<Chart> {
    let (Sweep { setting, unit, objective, .. }, _) = sweeps.first()?;
    let points = || sweeps.iter().flat_map(|(sweep, _)| &sweep.curve);
    let values = || points().map(|point| point.value);
    let (from, to) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    let max_deg = points().map(|point| point.error_deg).fold(0.0, f64::max);
    let unit = if unit.is_empty() { String::new() } else { format!(", {unit}") };
    let curves = sweeps.iter().map(|(sweep, (color, style))| {
        let points = sweep.curve.iter().map(|point| (point.value, point.error_deg)).collect();
        figures::Curve { has_markers: true, ..figures::Curve::new(&sweep.fuser, *color, *style, points) }
    });
    Some(Chart {
        title: String::new(),
        x: Axis { is_log: is_log_range(from, to), ..Axis::new(format!("{setting}{unit}"), from..to) },
        y: Axis::new(format!("{objective} error, °"), 0.0..1.05 * max_deg.max(1e-9)),
        curves: curves.collect(),
        has_legend: sweeps.len() > 1,
    })
}
