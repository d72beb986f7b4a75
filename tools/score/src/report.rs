//! HTML report: charts, tables and recommendation in one self-contained file.
//!
//! Input: the scores, and the decimated curves of each trial.
//!
//! Output: an HTML file that loads no external resource and is readable by its owner only.
//!
//! Failure: an error if the file cannot be written.

mod chart;

use std::{fmt::Write, path::Path};

use launch::{Calibration, Ingest, Launch};

use crate::{
    ScoreError,
    overlay::{AngleCurves, ErrorCurves, Overlay},
    recommendation::ranking_error,
    table::{ErrorsDeg, Scores, StageScore, Sweep},
    tune::is_log_range,
};
use chart::{Chart, Line, escape, stage_class};

/// Style sheet, with the colours of Okabe and Ito 2008. The reference has the colour of the text.
const CSS: &str = "\
:root{color-scheme:light dark;--back:#fff;--text:#1a1a1a;--grid:#8884}\
@media (prefers-color-scheme:dark){:root{--back:#141414;--text:#e8e8e8}}\
body{background:var(--back);color:var(--text);font:15px/1.5 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em}\
h1{font-size:1.5em}h2{font-size:1.25em;margin-top:2em}h3{font-size:1em;margin:1.2em 0 0}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums}th,td{padding:.2em .8em;text-align:right;border-bottom:1px solid var(--grid)}\
th:first-child,td:first-child,.words td{text-align:left}pre,code{font:13px/1.5 ui-monospace,monospace;white-space:pre-wrap;overflow-wrap:anywhere}\
circle{fill:var(--back)}svg{width:100%;height:auto}svg text{font-size:13px;fill:var(--text)}.grid{stroke:var(--grid)}polyline,svg .key{fill:none;stroke-width:1.5}\
.advice{border-left:4px solid #0072B2;padding-left:1em}.note{opacity:.8;margin:0}.legend svg{width:40px;height:10px;margin:0 .4em 0 1em}\
.reference{stroke:var(--text);stroke-width:1;stroke-dasharray:7 4}.stage0{stroke:#0072B2}.stage1{stroke:#CC79A7;stroke-dasharray:9 2}\
.stage2{stroke:#009E73;stroke-dasharray:5 2}.stage3{stroke:#E69F00;stroke-dasharray:9 2 2 2}.stage4{stroke:#56B4E9;stroke-dasharray:2 2}\
.stage5{stroke:#D55E00;stroke-dasharray:12 3 2 3 2 3}";

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
        Ok(recording::write_atomic(path, &self.html())?)
    }

    fn html(&self) -> String {
        let mut page = PageBuilder::default();
        self.add_summary(&mut page);
        self.scores.swept.iter().chain(&self.scores.tuned).for_each(|sweep| self.add_sweep(&mut page, sweep));
        self.overlays.iter().enumerate().for_each(|(index, overlay)| self.add_trial(&mut page, index, overlay));
        self.add_settings(&mut page);
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/>\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\"/>\
             <meta name=\"viewport\" content=\"width=device-width\"/><title>Plumbline: score</title><style>{CSS}</style></head>\n\
             <body>{}</body></html>\n",
            page.text
        )
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
                row(page, &trial.name, stage, &trial.error.attitude, trial.ns_per_update);
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
            let [trial, from, to] = [&difference.trial, &difference.from, &difference.to].map(|text| escape(text));
            let [total, heading, inclination] =
                [difference.rms.total, difference.rms.heading, difference.rms.inclination].map(format_deg);
            page.push(&format!(
                "<tr><td>{trial}</td><td>{from}</td><td>{to}</td><td>{total}</td><td>{heading}</td><td>{inclination}</td></tr>"
            ));
        }
        page.push("</table>");
    }

    fn add_sweep(&self, page: &mut PageBuilder, sweep: &Sweep) {
        let Sweep { fuser, setting, unit, objective, before, best, curve, .. } = sweep;
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
        let points: Vec<_> = curve.iter().map(|point| (point.value, point.error_deg)).collect();
        let errors = || points.iter().map(|point| point.1);
        let y_range = Some((errors().fold(f64::INFINITY, f64::min), errors().fold(f64::NEG_INFINITY, f64::max)));
        let is_log_x = points.first().zip(points.last()).is_some_and(|(a, b)| is_log_range(a.0, b.0));
        let x_range = points.first().zip(points.last()).map_or((0.0, 1.0), |(a, b)| (a.0, b.0));
        let stage = self.scores.stages.iter().position(|stage| stage.fuser == *fuser);
        let line = Line { stage: stage.or(Some(0)), segments: vec![points], y_range, has_markers: true };
        let x_label = format!("{setting}{}", if unit.is_empty() { String::new() } else { format!(", {unit}") });
        let y_label = format!("{objective} error, °");
        page.push_chart(&Chart {
            y_label: &y_label,
            x_label: &x_label,
            x_range,
            is_log_x,
            starts_at_zero: false,
            lines: vec![line],
        });
    }

    fn add_trial(&self, page: &mut PageBuilder, index: usize, overlay: &Overlay) {
        page.push(&format!("\n<h2>{}</h2>", escape(&overlay.name)));
        let x_range = (0.0, overlay.end_s());
        page.push_legend(&self.scores.stages, overlay.has_reference());
        let (kind, rms_label, curves, first) = if overlay.has_reference() {
            ("error", "RMS over scored samples", &overlay.errors, 0)
        } else {
            ("difference from the first stage", "RMS", &overlay.differences, 1)
        };
        if !curves.is_empty() {
            // If the heading is arbitrary, the heading and total errors are undefined.
            let is_meaningful = |at: usize, which: usize| {
                let trial = self.scores.stages.get(at).and_then(|stage| stage.trials.get(index));
                which == 0 || !overlay.has_reference() || trial.is_some_and(|trial| trial.heading_is_known)
            };
            let errors = [("inclination", 0), ("heading", 1), ("total", 2)];
            for (name, which) in errors {
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
                let line =
                    |(at, curves): (usize, &ErrorCurves)| Line::from_curve(&curves.curves[which], Some(at + first));
                let lines = shown.into_iter().map(line).collect();
                let label = format!("{name}, °");
                page.push_chart(&Chart {
                    y_label: &label,
                    x_label: "time, s",
                    x_range,
                    is_log_x: false,
                    starts_at_zero: true,
                    lines,
                });
            }
        }
        for (which, label) in ["roll, °", "pitch, °", "yaw, °"].into_iter().enumerate() {
            let line = |angles: &AngleCurves, stage| Line::from_curve(&angles.0[which], stage);
            let stages = overlay.stages.iter().enumerate().map(|(at, angles)| line(angles, Some(at)));
            let lines = stages.chain([line(&overlay.reference, None)]).collect();
            page.push(&format!("<h3>{}</h3>", label.trim_end_matches(", °")));
            page.push_chart(&Chart {
                y_label: label,
                x_label: "time, s",
                x_range,
                is_log_x: false,
                starts_at_zero: false,
                lines,
            });
        }
    }

    fn add_settings(&self, page: &mut PageBuilder) {
        let (name, _) = ranking_error(self.heading_is_known);
        page.push("\n<h2>Settings</h2><table class=\"words\"><tr><th>fuser</th><th>gyro</th><th>accel</th><th>course</th><th>settings</th></tr>");
        for stage in &self.scores.stages {
            let set: Vec<_> = stage.settings.iter().map(|(key, value)| format!("{key} = {value}")).collect();
            let cells =
                [&stage.fuser, &stage.gyro, &stage.accel, &stage.course].map(|text| escape(text)).join("</td><td>");
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
    charts: usize,
}

impl PageBuilder {
    fn push(&mut self, text: &str) {
        self.text.push_str(text);
    }

    fn push_chart(&mut self, chart: &Chart<'_>) {
        self.charts += 1;
        let (svg, clip_note) = chart.svg(self.charts);
        self.push(&svg);
        if let Some(note) = clip_note {
            self.push(&format!("<p class=\"note\">{note}</p>"));
        }
    }

    fn push_legend(&mut self, stages: &[StageScore], has_reference: bool) {
        let stages = stages.iter().enumerate().map(|(at, stage)| (Some(at), stage.fuser.as_str()));
        self.push("<p class=\"legend\">");
        for (stage, name) in stages.chain(has_reference.then_some((None, "reference"))) {
            let css_class = stage_class(stage);
            // Writing to a `String` cannot fail.
            let _ = write!(
                self.text,
                "<svg viewBox=\"0 0 40 10\" role=\"presentation\"><line class=\"key {css_class}\" x1=\"0\" x2=\"40\" y1=\"5\" y2=\"5\"/></svg>{}",
                escape(name)
            );
        }
        self.push("</p>");
    }
}

fn format_deg(deg: Option<f64>) -> String {
    deg.map_or("–".into(), |deg| format!("{deg:.3}"))
}
