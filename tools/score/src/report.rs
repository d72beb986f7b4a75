//! HTML report: charts, tables and recommendation in one self-contained file.
//!
//! Input: the scores, and the decimated curves of each trial.
//!
//! Output: an HTML file that loads no external resource. All users of the machine may read it.
//!
//! Failure: an error if the file cannot be written.

use std::{fmt::Write, io, path::Path};

use figures::{
    Chart,
    style::{LineStyle, REFERENCE, series_style},
};
use launch::{Calibration, Ingest, Launch};
use plotters::style::RGBColor;

use crate::{
    ScoreError,
    overlay::{ErrorCurves, Overlay},
    plot::panel::{Series, sweep_chart, time_chart},
    recommendation::ranking_error,
    table::{ErrorsDeg, Scores, StageScore, Sweep},
};

/// Permissions of the file, reduced by the umask. The report is made to be shared.
const REPORT_MODE: u32 = 0o644;
/// Width and height of a chart, pixels.
const CHART_SIZE: (u32, u32) = (960, 230);
/// Percentage of points that the range of the vertical axis ignores at each end.
const OUTLIER_PERCENT: f64 = 0.5;
/// Declaration of the SVG namespace, which HTML does not need.
const SVG_NAMESPACE: &str = " xmlns=\"http://www.w3.org/2000/svg\"";
/// Style sheet. In the charts, it replaces white, black and the near-black of the reference with
/// the colours of the page.
const CSS: &str = "\
:root{color-scheme:light dark;--back:#fff;--text:#1a1a1a;--grid:#8884}\
@media (prefers-color-scheme:dark){:root{--back:#141414;--text:#e8e8e8}}\
body{background:var(--back);color:var(--text);font:15px/1.5 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em}\
h1{font-size:1.5em}h2{font-size:1.25em;margin-top:2em}h3{font-size:1em;margin:1.2em 0 0}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums}th,td{padding:.2em .8em;text-align:right;border-bottom:1px solid var(--grid)}\
th:first-child,td:first-child,.words td{text-align:left}pre,code{font:13px/1.5 ui-monospace,monospace;white-space:pre-wrap;overflow-wrap:anywhere}\
svg{width:100%;height:auto}figure{margin:0}svg text{fill:var(--text)}svg [fill=\"#FFFFFF\"]{fill:var(--back)}\
svg [stroke=\"#000000\"],svg [stroke=\"#1A1A1A\"]{stroke:var(--text)}\
.advice{border-left:4px solid #0072B2;padding-left:1em}.note{opacity:.8;margin:0}.legend svg{width:40px;height:10px;margin:0 .4em 0 1em}";

/// Content of the report.
pub(crate) struct HtmlReport<'a> {
    pub(crate) scores: &'a Scores,
    pub(crate) overlays: &'a [Overlay],
    /// Command line of the run.
    pub(crate) command: &'a str,
    /// Calibration and mounting applied to the readings.
    pub(crate) ingest: &'a Ingest,
    pub(crate) heading_is_known: bool,
}

impl HtmlReport<'_> {
    /// Writes the report.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be written.
    pub(crate) fn write(&self, path: &Path) -> Result<(), ScoreError> {
        let html = self.html().map_err(|cause| ScoreError::Write { path: path.into(), cause })?;
        Ok(recording::write_atomic(path, &html, REPORT_MODE)?)
    }

    fn html(&self) -> io::Result<String> {
        let mut page = PageBuilder::default();
        self.add_summary(&mut page);
        self.scores.swept.iter().chain(&self.scores.tuned).try_for_each(|sweep| self.add_sweep(&mut page, sweep))?;
        self.overlays.iter().enumerate().try_for_each(|(index, overlay)| self.add_trial(&mut page, index, overlay))?;
        self.add_settings(&mut page);
        Ok(format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/>\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\"/>\
             <meta name=\"viewport\" content=\"width=device-width\"/><title>Plumbline: score</title><style>{CSS}</style></head>\n\
             <body>{}</body></html>\n",
            page.text
        ))
    }

    fn add_summary(&self, page: &mut PageBuilder) {
        page.push("<h1>Plumbline: score</h1>");
        page.push(&format!("<pre>{}</pre>", escape(self.command)));
        if let Some(recommendation) = &self.scores.recommendation {
            page.push(&format!("<div class=\"advice\"><p>{}</p>", escape(&recommendation.text)));
            if !recommendation.launch.is_empty() {
                page.push(&format!(
                    "<p class=\"note\">For <code>launch.toml</code>:</p><pre>{}</pre>",
                    escape(&recommendation.launch)
                ));
            }
            page.push("</div>");
        }
        for warning in &self.scores.warnings {
            page.push(&format!("<p><strong>{}</strong></p>", escape(&warning.to_string())));
        }
        page.push("\n<h2>Errors</h2><p class=\"note\">RMSE over the scored samples, degrees, and its mean over the trials. Heading offsets are not removed.</p><table>");
        page.push(
            "<tr><th>trial</th><th>fuser</th><th>total</th><th>heading</th><th>inclination</th><th>ns/update</th></tr>",
        );
        let row = |page: &mut PageBuilder, name: &str, stage: &StageScore, error: &ErrorsDeg, ns: Option<f64>| {
            let [total, heading, inclination] = [error.total, error.heading, error.inclination].map(format_deg);
            let ns = ns.map_or("–".into(), |ns| format!("{ns:.0}"));
            page.push(&format!(
                "<tr><td>{}</td><td>{}</td><td>{total}</td><td>{heading}</td><td>{inclination}</td><td>{ns}</td></tr>",
                escape(name),
                escape(&stage.fuser)
            ));
        };
        let stages = &self.scores.stages;
        let trials = stages.first().map_or(0, |stage| stage.trials.len());
        for index in 0..trials {
            for stage in stages {
                let Some(trial) = stage.trials.get(index) else { continue };
                row(page, &trial.name.to_string(), stage, &trial.error.attitude, trial.ns_per_update);
            }
        }
        for stage in stages.iter().filter(|_| trials > 1) {
            row(page, "mean", stage, &stage.mean.attitude, stage.ns_per_update);
        }
        page.push("</table>");
        self.add_differences(page);
    }

    fn add_differences(&self, page: &mut PageBuilder) {
        if self.scores.differences.is_empty() {
            return;
        }
        page.push("\n<h2>Differences between stages</h2><p class=\"note\">Trials without a reference; RMS, degrees.</p><table>");
        page.push("<tr><th>trial</th><th>from</th><th>to</th><th>total</th><th>heading</th><th>inclination</th></tr>");
        for difference in &self.scores.differences {
            let [trial, from, to] =
                [&difference.trial.to_string(), &difference.from, &difference.to].map(|text| escape(text));
            let [total, heading, inclination] =
                [difference.rms.total, difference.rms.heading, difference.rms.inclination].map(format_deg);
            page.push(&format!(
                "<tr><td>{trial}</td><td>{from}</td><td>{to}</td><td>{total}</td><td>{heading}</td><td>{inclination}</td></tr>"
            ));
        }
        page.push("</table>");
    }

    fn add_sweep(&self, page: &mut PageBuilder, sweep: &Sweep) -> io::Result<()> {
        let Sweep { fuser, setting, unit, objective, before, best, .. } = sweep;
        let unit_suffix = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        page.push(&format!(
            "\n<h2>{} of {}</h2><h3>{objective} error {:.3}° at the best value {}{unit_suffix}, {:.3}° at {}{unit_suffix} before</h3>",
            escape(setting),
            escape(fuser),
            best.error_deg,
            best.value,
            before.error_deg,
            before.value
        ));
        let stage = self.scores.stages.iter().position(|stage| stage.fuser == *fuser);
        let chart = sweep_chart(&[(sweep, series_style(stage.unwrap_or(0)))]);
        chart.map_or(Ok(()), |chart| page.push_chart(&chart))
    }

    fn add_trial(&self, page: &mut PageBuilder, index: usize, overlay: &Overlay) -> io::Result<()> {
        page.push(&format!("\n<h2>{}</h2>", escape(&overlay.name.to_string())));
        let end_s = overlay.end_s().max(1e-3);
        page.push_legend(&self.scores.stages, overlay.has_reference());
        let series = |curve, stage: Option<usize>| {
            let name = stage.and_then(|at| self.scores.stages.get(at)).map_or("reference", |stage| &stage.fuser);
            Series { name, style: stage.map_or(REFERENCE, series_style), curve }
        };
        let (kind, rms_label, curves, first) = if overlay.has_reference() {
            ("error", "RMS over scored samples", &overlay.errors, 0)
        } else {
            ("difference from the first stage", "RMS", &overlay.differences, 1)
        };
        if !curves.is_empty() {
            // If the zero direction of the heading is arbitrary, the heading and total errors are
            // undefined.
            let is_meaningful = |at: usize, which: usize| {
                let trial = self.scores.stages.get(at).and_then(|stage| stage.trials.get(index));
                which == 0 || !overlay.has_reference() || trial.is_some_and(|trial| trial.heading_is_known)
            };
            let errors = [("inclination", "inclination, °"), ("heading", "heading, °"), ("total", "total, °")];
            for (which, (name, label)) in errors.into_iter().enumerate() {
                let shown: Vec<_> =
                    curves.iter().enumerate().filter(|(at, _)| is_meaningful(at + first, which)).collect();
                if shown.is_empty() {
                    continue;
                }
                let rms_of = |rms: ErrorsDeg| [rms.inclination, rms.heading, rms.total][which];
                let stage_rms = |(at, curves): &(usize, &ErrorCurves)| {
                    let stage = self.scores.stages.get(at + first).map_or("", |stage| &stage.fuser);
                    format!("{stage} {}°", format_deg(rms_of(curves.rms())))
                };
                let rms: Vec<_> = shown.iter().map(stage_rms).collect();
                page.push(&format!("<h3>{name} {kind}, {rms_label}: {}</h3>", escape(&rms.join(", "))));
                // The first stage is drawn last, above the others.
                let shown = shown.iter().rev().map(|(at, curves)| series(&curves.curves[which], Some(at + first)));
                page.push_time_chart(label, end_s, true, &shown.collect::<Vec<_>>())?;
            }
        }
        for (which, label) in ["roll, °", "pitch, °", "yaw, °"].into_iter().enumerate() {
            let stages = overlay.stages.iter().enumerate().rev();
            let stages = stages.map(|(at, angles)| series(&angles.0[which], Some(at)));
            let all: Vec<_> = stages.chain([series(&overlay.reference.0[which], None)]).collect();
            page.push(&format!("<h3>{}</h3>", label.trim_end_matches(", °")));
            page.push_time_chart(label, end_s, false, &all)?;
        }
        Ok(())
    }

    fn add_settings(&self, page: &mut PageBuilder) {
        let (name, _) = ranking_error(self.heading_is_known);
        page.push("\n<h2>Settings</h2><table class=\"words\"><tr><th>fuser</th><th>gyro</th><th>accel</th><th>course</th><th>settings</th></tr>");
        for stage in &self.scores.stages {
            let set: Vec<_> = stage.settings.iter().map(|(key, value)| format!("{key} = {value}")).collect();
            let other = [&stage.gyro, &stage.accel, &stage.course].map(|name| name.as_deref().unwrap_or("–"));
            let cells = [&[stage.fuser.as_str()][..], &other].concat();
            let cells = cells.into_iter().map(escape).collect::<Vec<_>>().join("</td><td>");
            page.push(&format!("<tr><td>{cells}</td><td>{}</td></tr>", escape(&set.join(", "))));
        }
        page.push("</table>");
        self.add_calibration(page);
        page.push(&format!(
            "<p class=\"note\">Other settings have their defaults, listed by <code>plumb stage list</code>. Stages are ranked by the {name} error{}.</p>",
            if self.heading_is_known { "" } else { ", because the heading is unknown (arbitrary course reference)" }
        ));
    }
}

impl HtmlReport<'_> {
    /// Adds a table of the calibration and mounting, unless they are the defaults.
    fn add_calibration(&self, page: &mut PageBuilder) {
        let Ingest { calibration, mounting, .. } = self.ingest;
        let default = Launch::default().ingest;
        let sensors = [
            ("gyro, rad/s", calibration.gyro, default.calibration.gyro),
            ("accelerometer, m/s²", calibration.accel, default.calibration.accel),
            ("magnetometer, µT", calibration.mag, default.calibration.mag),
        ];
        let changed = sensors.into_iter().filter(|(_, calibration, default)| calibration != default);
        let mut rows: Vec<_> = changed
            .map(|(sensor, Calibration { bias, matrix }, _)| (sensor, format!("bias {bias:?}, matrix {matrix:?}")))
            .collect();
        if *mounting != default.mounting {
            rows.push(("mounting, v_body = M v_sensor", format!("{mounting:?}")));
        }
        if !rows.is_empty() {
            page.push("<table class=\"words\"><tr><th>input</th><th>value from the launch file</th></tr>");
            for (name, value) in rows {
                page.push(&format!("<tr><td>{name}</td><td>{value}</td></tr>"));
            }
            page.push("</table>");
        }
    }
}

/// Body of the page under construction.
#[derive(Default)]
struct PageBuilder {
    text: String,
}

impl PageBuilder {
    fn push(&mut self, text: &str) {
        self.text.push_str(text);
    }

    /// Adds a chart as an SVG element, labelled by its vertical axis.
    fn push_chart(&mut self, chart: &Chart) -> io::Result<()> {
        let svg = figures::svg(CHART_SIZE, chart).map_err(|cause| io::Error::other(cause.to_string()))?;
        let svg = svg.replacen(SVG_NAMESPACE, "", 1);
        self.push(&format!("<figure role=\"img\" aria-label=\"{}\">{svg}</figure>", escape(&chart.y.label)));
        Ok(())
    }

    /// Adds a chart of curves from time 0 to `end_s`. The range of its vertical axis ignores
    /// outliers. If a curve exceeds the axis, a note states the largest value.
    fn push_time_chart(
        &mut self,
        label: &'static str,
        end_s: f64,
        starts_at_zero: bool,
        series: &[Series<'_>],
    ) -> io::Result<()> {
        let ranges = || series.iter().filter_map(|series| series.curve.robust_range(OUTLIER_PERCENT));
        let low = ranges().map(|range| range.0).reduce(f64::min);
        let high = ranges().map(|range| range.1).reduce(f64::max);
        let (Some(low), Some(high)) = (low, high) else { return Ok(()) };
        let low = if starts_at_zero { 0.0 } else { low };
        let margin = (0.08 * (high - low)).max(1e-6 * high.abs()).max(1e-9);
        let y_range = if starts_at_zero { 0.0 } else { low - margin }..high + margin;
        let end = y_range.end;
        self.push_chart(&time_chart(label, 0.0..end_s, y_range, series, 1))?;
        let largest = series.iter().filter_map(|series| series.curve.range()).map(|range| range.1).reduce(f64::max);
        if let Some(largest) = largest.filter(|largest| *largest > end) {
            self.push(&format!("<p class=\"note\">axis ends at {end:.2}; the largest value is {largest:.2}</p>"));
        }
        Ok(())
    }

    fn push_legend(&mut self, stages: &[StageScore], has_reference: bool) {
        let stages = stages.iter().enumerate().map(|(at, stage)| (series_style(at), stage.fuser.as_str()));
        self.push("<p class=\"legend\">");
        for ((RGBColor(r, g, b), style), name) in stages.chain(has_reference.then_some((REFERENCE, "reference"))) {
            let dashes = if let LineStyle::Dashed(on, off) = style { format!("{on} {off}") } else { "none".into() };
            // Writing to a `String` cannot fail.
            let _ = write!(
                self.text,
                "<svg viewBox=\"0 0 40 10\" role=\"presentation\"><line x1=\"0\" x2=\"40\" y1=\"5\" y2=\"5\" stroke=\"#{r:02X}{g:02X}{b:02X}\" stroke-width=\"2\" stroke-dasharray=\"{dashes}\"/></svg>{}",
                escape(name)
            );
        }
        self.push("</p>");
    }
}

/// Escapes a text for HTML.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn format_deg(deg: Option<f64>) -> String {
    deg.map_or("–".into(), |deg| format!("{deg:.3}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::curve::Curve;

    #[test]
    fn spike_is_clipped_and_reported() {
        let mut curve = Curve::with_bins(1000, 400);
        for i in 0..1000 {
            curve.push(f64::from(i), if i == 500 { 90.0 } else { 1.0 + f64::from(i % 7) });
        }
        curve.finish();
        let mut page = PageBuilder::default();
        let series = [Series { name: "wz", style: series_style(0), curve: &curve }];
        page.push_time_chart("error, °", 1000.0, true, &series).unwrap();
        assert!(page.text.ends_with("axis ends at 7.56; the largest value is 90.00</p>"), "{}", page.text);
        assert!(page.text.contains(">\n6\n<") && !page.text.contains(">\n80\n<"), "{}", page.text);
    }
}
