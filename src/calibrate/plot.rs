//! Figure of the Allan deviations of a sensor unit at rest.

use std::{fs, io, ops::Range, path::Path};

use ::calibrate::noise::{AllanPoint, NoiseReport, SensorNoise};
use figures::{
    Axis, Chart, Curve, Stack,
    style::{LineStyle, series_style},
};

/// Width and height of the figure, in pixels.
const SIZE: (u32, u32) = (900, 900);
/// Factor by which each axis extends beyond the smallest and the largest value.
const MARGIN: f64 = 1.3;

/// Writes the figure as an SVG. It shows the measured deviations with confidence intervals, and
/// the fitted model as dashed lines.
///
/// # Errors
///
/// Returns an error if the figure cannot be drawn or the file cannot be written.
pub(super) fn write(file: &Path, report: &NoiseReport) -> io::Result<()> {
    let charts = report.sensors.iter().map(chart).collect();
    let stack = Stack { title: "Allan deviation at rest".into(), charts };
    let svg = figures::svg(SIZE, &stack).map_err(|cause| io::Error::other(cause.to_string()))?;
    fs::write(file, svg)
}

fn chart(sensor: &SensorNoise) -> Chart {
    let unit = if sensor.sensor == "gyro" { "°/s" } else { "m/s²" };
    let points = || sensor.axes.iter().flat_map(|axis| &axis.curve);
    let heights = points().flat_map(|point| {
        let interval = point.interval.into_iter().flatten();
        interval.chain(point.model).chain([point.deviation])
    });
    let x = log_axis("τ, s".into(), points().map(|point| point.tau_s));
    let y = log_axis(format!("{}, {unit}", sensor.sensor), heights);
    let mut curves = Vec::new();
    for (index, axis) in sensor.axes.iter().enumerate() {
        let (color, _) = series_style(index);
        let line = |value: fn(&AllanPoint) -> Option<f64>| -> Vec<_> {
            axis.curve.iter().filter_map(|point| Some((point.tau_s, value(point)?))).collect()
        };
        let measured = line(|point| Some(point.deviation));
        curves.push(Curve { has_markers: true, ..Curve::new(axis.axis, color, LineStyle::Thin, measured) });
        let model = line(|point| point.model);
        curves.push(Curve::new(format!("{}, model", axis.axis), color, LineStyle::Dashed(7, 4), model));
        curves.extend(axis.curve.iter().filter_map(|point| {
            let [low, high] = point.interval?;
            Some(Curve::new("", color, LineStyle::Thick, vec![(point.tau_s, low), (point.tau_s, high)]))
        }));
    }
    Chart { title: String::new(), x, y, curves, has_legend: true }
}

fn log_axis(label: String, values: impl Iterator<Item = f64>) -> Axis {
    let positive = values.filter(|value| *value > 0.0);
    let Range { start, end } =
        positive.fold(f64::INFINITY..0.0, |range, value| range.start.min(value)..range.end.max(value));
    Axis { is_log: true, ..Axis::new(label, start / MARGIN..end * MARGIN) }
}
