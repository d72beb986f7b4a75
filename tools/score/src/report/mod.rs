//! The scores as one page to send: charts, tables and advice in one HTML file that asks nobody for anything.
//!
//! Input: the scores and the curves of each trial. Output: the file, which only this user may read until it is sent. Time: none. Failure: a file that
//! cannot be written.

mod chart;

use std::{fmt::Write, path::Path};

use launch::{Calibration, Ingest, Launch};

use crate::{
    ScoreError,
    overlay::{Angles, Deviations, Overlay},
    table::{ErrorsDeg, Scores, StageScore},
    tune::{Sweep, goes_by_factors},
    verdict::least_of,
};
use chart::{Chart, Line, class};

/// How lines differ: each stage has a colour and a dash of its own, and begins anew after so many.
const STYLES: usize = 6;

/// Colours of Okabe and Ito 2008; the reference has that of the text.
const STYLE: &str = "\
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

/// What the page is of.
pub(crate) struct Report<'a> {
    pub(crate) scores: &'a Scores,
    pub(crate) overlays: &'a [Overlay],
    /// What was asked, as it was typed.
    pub(crate) command: &'a str,
    /// How readings were calibrated and mounted.
    pub(crate) ingest: &'a Ingest,
    pub(crate) heading_is_known: bool,
}

impl Report<'_> {
    /// Writes the page.
    pub(crate) fn write(&self, path: &Path) -> Result<(), ScoreError> {
        Ok(recording::write_atomic(path, &self.html())?)
    }

    fn html(&self) -> String {
        let mut page = Page::default();
        self.summary(&mut page);
        self.scores.swept.iter().chain(&self.scores.tuned).for_each(|tuned| self.tuned(&mut page, tuned));
        self.overlays.iter().enumerate().for_each(|(index, overlay)| self.trial(&mut page, index, overlay));
        self.settings(&mut page);
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/>\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\"/>\
             <meta name=\"viewport\" content=\"width=device-width\"/><title>Plumbline: score</title><style>{STYLE}</style></head>\n\
             <body>{}</body></html>\n",
            page.text
        )
    }

    fn summary(&self, page: &mut Page) {
        page.add("<h1>Plumbline: score</h1>");
        page.add(&format!("<pre>{}</pre>", escaped(self.command)));
        if let Some(choice) = &self.scores.choice {
            page.add(&format!("<div class=\"advice\"><p>{}</p>", escaped(&choice.text)));
            if !choice.launch.is_empty() {
                page.add(&format!(
                    "<p class=\"note\">For <code>launch.toml</code>:</p><pre>{}</pre>",
                    escaped(&choice.launch)
                ));
            }
            page.add("</div>");
        }
        for warning in &self.scores.warnings {
            page.add(&format!("<p><strong>{}</strong></p>", escaped(&warning.to_string())));
        }
        page.add("\n<h2>Errors</h2><p class=\"note\">RMSE over the samples that count, degrees; mean over the trials. No heading offset is taken out.</p><table>");
        page.add(
            "<tr><th>trial</th><th>fuser</th><th>total</th><th>heading</th><th>inclination</th><th>ns/update</th></tr>",
        );
        let row = |page: &mut Page, name: &str, stage: &StageScore, error: &ErrorsDeg, ns: Option<f64>| {
            let [total, heading, inclination] = [error.total, error.heading, error.inclination].map(degrees);
            let ns = ns.map_or("–".into(), |ns| format!("{ns:.0}"));
            page.add(&format!(
                "<tr><td>{}</td><td>{}</td><td>{total}</td><td>{heading}</td><td>{inclination}</td><td>{ns}</td></tr>",
                escaped(name),
                escaped(&stage.fuser)
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
        page.add("</table>");
        self.differences(page);
    }

    fn differences(&self, page: &mut Page) {
        if self.scores.differences.is_empty() {
            return;
        }
        page.add("\n<h2>Differences between stages</h2><p class=\"note\">Of trials without a reference; RMS, degrees.</p><table>");
        page.add("<tr><th>trial</th><th>from</th><th>to</th><th>total</th><th>heading</th><th>inclination</th></tr>");
        for difference in &self.scores.differences {
            let [trial, from, to] = [&difference.trial, &difference.from, &difference.to].map(|text| escaped(text));
            let [total, heading, inclination] =
                [difference.rms.total, difference.rms.heading, difference.rms.inclination].map(degrees);
            page.add(&format!(
                "<tr><td>{trial}</td><td>{from}</td><td>{to}</td><td>{total}</td><td>{heading}</td><td>{inclination}</td></tr>"
            ));
        }
        page.add("</table>");
    }

    fn tuned(&self, page: &mut Page, tuned: &Sweep) {
        let Sweep { fuser, setting, unit, least_of, before, best, curve, .. } = tuned;
        let unit_said = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        page.add(&format!(
            "\n<h2>{} of {}</h2><h3>{least_of} error {:.3}° at {}{unit_said}, {:.3}° at {}{unit_said} as before</h3>",
            escaped(setting),
            escaped(fuser),
            best.error_deg,
            best.value,
            before.error_deg,
            before.value
        ));
        let points: Vec<_> = curve.iter().map(|point| (point.value, point.error_deg)).collect();
        let errors = || points.iter().map(|point| point.1);
        let range = Some((errors().fold(f64::INFINITY, f64::min), errors().fold(f64::NEG_INFINITY, f64::max)));
        let by_factors = points.first().zip(points.last()).is_some_and(|(a, b)| goes_by_factors(a.0, b.0));
        let span = points.first().zip(points.last()).map_or((0.0, 1.0), |(a, b)| (a.0, b.0));
        let place = self.scores.stages.iter().position(|stage| stage.fuser == *fuser);
        let line = Line { place: place.or(Some(0)), parts: vec![points], range, marked: true };
        let across = format!("{setting}{}", if unit.is_empty() { String::new() } else { format!(", {unit}") });
        let label = format!("{least_of} error, °");
        page.chart(&Chart { label: &label, across: &across, span, by_factors, from_zero: false, lines: vec![line] });
    }

    fn trial(&self, page: &mut Page, index: usize, overlay: &Overlay) {
        page.add(&format!("\n<h2>{}</h2>", escaped(&overlay.name)));
        let span = (0.0, overlay.end_s());
        page.legend(&self.scores.stages, overlay.has_reference());
        let (said, deviations, first) = if overlay.has_reference() {
            ("error where it counts", &overlay.errors, 0)
        } else {
            ("difference from the first stage", &overlay.differences, 1)
        };
        if !deviations.is_empty() {
            // Of a heading from nowhere, the heading and the whole attitude have no error.
            let counts = |at: usize, which: usize| {
                let trial = self.scores.stages.get(at).and_then(|stage| stage.trials.get(index));
                which == 0 || !overlay.has_reference() || trial.is_some_and(|trial| trial.heading_is_known)
            };
            let heads = [("inclination", 0), ("heading", 1), ("total", 2)];
            for (name, which) in heads {
                let counted: Vec<_> =
                    deviations.iter().enumerate().filter(|(at, _)| counts(at + first, which)).collect();
                if counted.is_empty() {
                    continue;
                }
                let of = |rms: ErrorsDeg| [rms.inclination, rms.heading, rms.total][which];
                let each = |(at, deviation): &(usize, &Deviations)| {
                    let stage = self.scores.stages.get(at + first).map_or("", |stage| &stage.fuser);
                    format!("{stage} {}°", degrees(of(deviation.rms())))
                };
                let all: Vec<_> = counted.iter().map(each).collect();
                page.add(&format!("<h3>{name} {said}, RMS: {}</h3>", escaped(&all.join(", "))));
                let line = |(at, deviation): (usize, &Deviations)| Line::of(&deviation.curves[which], Some(at + first));
                let lines = counted.into_iter().map(line).collect();
                let label = format!("{name}, °");
                page.chart(&Chart {
                    label: &label,
                    across: "time, s",
                    span,
                    by_factors: false,
                    from_zero: true,
                    lines,
                });
            }
        }
        for (which, label) in ["roll, °", "pitch, °", "yaw, °"].into_iter().enumerate() {
            let line = |angles: &Angles, place| Line::of(&angles.0[which], place);
            let stages = overlay.stages.iter().enumerate().map(|(at, angles)| line(angles, Some(at)));
            let lines = stages.chain([line(&overlay.reference, None)]).collect();
            page.add(&format!("<h3>{}</h3>", label.trim_end_matches(", °")));
            page.chart(&Chart { label, across: "time, s", span, by_factors: false, from_zero: false, lines });
        }
    }

    fn settings(&self, page: &mut Page) {
        let (name, _) = least_of(self.heading_is_known);
        page.add("\n<h2>Settings</h2><table class=\"words\"><tr><th>fuser</th><th>gyro</th><th>accel</th><th>course</th><th>set</th></tr>");
        for stage in &self.scores.stages {
            let set: Vec<_> = stage.settings.iter().map(|(key, value)| format!("{key} = {value}")).collect();
            let cells =
                [&stage.fuser, &stage.gyro, &stage.accel, &stage.course].map(|text| escaped(text)).join("</td><td>");
            page.add(&format!("<tr><td>{cells}</td><td>{}</td></tr>", escaped(&set.join(", "))));
        }
        page.add("</table>");
        self.readings(page);
        page.add(&format!(
            "<p class=\"note\">Where nothing is set a stage has its defaults: <code>plumb stage list</code>. Stages are ranked by the {name} error{}.</p>",
            if self.heading_is_known { "" } else { ", as no heading is known: the course is counted from nowhere" }
        ));
    }
}

impl Report<'_> {
    /// What was done to the readings, where anything was.
    fn readings(&self, page: &mut Page) {
        let Ingest { calibration, mounting, .. } = self.ingest;
        let usual = Launch::default().ingest;
        let sensors = [
            ("gyro, rad/s", calibration.gyro, usual.calibration.gyro),
            ("accelerometer, m/s²", calibration.accel, usual.calibration.accel),
            ("magnetometer, µT", calibration.mag, usual.calibration.mag),
        ];
        let changed = sensors.into_iter().filter(|(_, calibration, usual)| calibration != usual);
        let mut rows: Vec<_> = changed
            .map(|(sensor, Calibration { bias, matrix }, _)| (sensor, format!("bias {bias:?}, matrix {matrix:?}")))
            .collect();
        if *mounting != usual.mounting {
            rows.push(("mounting, v_body = M v_sensor", format!("{mounting:?}")));
        }
        if !rows.is_empty() {
            page.add("<table class=\"words\"><tr><th>readings</th><th>as the launch file says</th></tr>");
            for (name, said) in rows {
                page.add(&format!("<tr><td>{name}</td><td>{said}</td></tr>"));
            }
            page.add("</table>");
        }
    }
}

/// The page's text, as far as it has come.
#[derive(Default)]
struct Page {
    text: String,
    charts: usize,
}

impl Page {
    fn add(&mut self, text: &str) {
        self.text.push_str(text);
    }

    fn chart(&mut self, chart: &Chart<'_>) {
        self.charts += 1;
        let (svg, cut) = chart.svg(self.charts);
        self.add(&svg);
        if let Some(cut) = cut {
            self.add(&format!("<p class=\"note\">{cut}</p>"));
        }
    }

    fn legend(&mut self, stages: &[StageScore], has_reference: bool) {
        let stages = stages.iter().enumerate().map(|(at, stage)| (Some(at), stage.fuser.as_str()));
        self.add("<p class=\"legend\">");
        for (place, name) in stages.chain(has_reference.then_some((None, "reference"))) {
            let class = class(place);
            // Text cannot fail to be written into.
            let _ = write!(
                self.text,
                "<svg viewBox=\"0 0 40 10\" role=\"presentation\"><line class=\"key {class}\" x1=\"0\" x2=\"40\" y1=\"5\" y2=\"5\"/></svg>{}",
                escaped(name)
            );
        }
        self.add("</p>");
    }
}

fn degrees(deg: Option<f64>) -> String {
    deg.map_or("–".into(), |deg| format!("{deg:.3}"))
}

/// Text that stands for itself in a page.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
