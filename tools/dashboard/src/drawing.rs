//! A picture on as many columns and lines as there are.
//!
//! From 80×24 on everything is there. Below that the horizon and the trends are left out, and below what a line of text needs there is a word about it.

use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::{Color, Modifier, Style},
    text::{Line, Span},
    widgets::{Block, Paragraph, Sparkline, SparklineBar, Wrap},
};

use crate::{Attitude, Mark, Panel, Picture, Row, State, Trend, horizon};

/// Colours of the estimate, of the earth, of faults and of what matters less (Okabe and Ito 2008, in the palette of 256).
pub(crate) const BLUE: Color = Color::Indexed(32);
pub(crate) const GROUND: Color = Color::Indexed(178);
const GREEN: Color = Color::Indexed(36);
const VERMILION: Color = Color::Indexed(166);
pub(crate) const QUIET: Color = Color::Indexed(244);

/// The size from which on everything is shown.
const WHOLE: (u16, u16) = (80, 24);
/// The size below which there is no picture.
const LEAST: (u16, u16) = (40, 8);
/// Steps of a character's height.
const STEPS: u64 = 8;

/// Draws a picture over all there is.
pub(crate) fn draw(frame: &mut Frame<'_>, picture: &Picture) {
    let area = frame.area();
    if area.width < LEAST.0 || area.height < LEAST.1 {
        too_small(frame, area, picture);
    } else if area.width < WHOLE.0 || area.height < WHOLE.1 {
        reduced(frame, area, picture);
    } else {
        whole(frame, area, picture);
    }
}

fn whole(frame: &mut Frame<'_>, area: Rect, picture: &Picture) {
    let upper = if area.height >= 36 { 14 } else { 9 };
    let [bar_area, upper, panels_area, keys] =
        Layout::vertical([Constraint::Length(1), Constraint::Length(upper), Constraint::Min(3), Constraint::Length(1)])
            .areas(area);
    let horizon_width = 2 * upper.height + 1;
    let [horizon_area, attitude_area, trends_area] =
        Layout::horizontal([Constraint::Length(horizon_width), Constraint::Length(30), Constraint::Min(20)])
            .areas(upper);
    frame.render_widget(bar(picture), bar_area);
    let dim = !is_fresh(&picture.state);
    let horizon_inner = framed(frame, horizon_area, "horizon");
    if let Some(attitude) = &picture.attitude {
        horizon::draw(frame, horizon_inner, attitude.up, dim);
    }
    let title = picture.attitude.as_ref().map_or("attitude".into(), |it| format!("attitude, {}", it.frame));
    let inner = framed(frame, attitude_area, &title);
    frame.render_widget(Paragraph::new(attitude_lines(picture)).style(faded(dim)), inner);
    let inner = framed(frame, trends_area, "last minute");
    trends(frame, inner, &picture.trends.each, dim);
    panels(frame, panels_area, &picture.panels);
    frame.render_widget(Line::styled(picture.keys, QUIET), keys);
}

fn reduced(frame: &mut Frame<'_>, area: Rect, picture: &Picture) {
    let [bar_area, attitude_area, panels_area, keys] =
        Layout::vertical([Constraint::Length(1), Constraint::Length(1), Constraint::Min(3), Constraint::Length(1)])
            .areas(area);
    frame.render_widget(bar(picture), bar_area);
    frame.render_widget(Line::styled(attitude_in_a_line(picture), faded(!is_fresh(&picture.state))), attitude_area);
    panels(frame, panels_area, &picture.panels);
    frame.render_widget(Line::styled(picture.keys, QUIET), keys);
}

fn too_small(frame: &mut Frame<'_>, area: Rect, picture: &Picture) {
    let (columns, lines) = WHOLE;
    let text = vec![
        Line::from(format!("{} {}", picture.name, picture.state.word())),
        Line::from(attitude_in_a_line(picture)),
        Line::from(format!("{}×{} is too small; {columns}×{lines} shows all", area.width, area.height)),
    ];
    frame.render_widget(Paragraph::new(text).wrap(Wrap { trim: true }), area);
}

/// Name, state and numbers; those that matter least at the end, where a narrow terminal cuts them off.
fn bar(picture: &Picture) -> Line<'static> {
    let Picture { name, state, facts, .. } = picture;
    let known = |number: Option<String>| number.unwrap_or_else(|| "–".into());
    let state_style = match state {
        State::Live => Style::new().fg(GREEN).add_modifier(Modifier::BOLD),
        State::Connecting => Style::new().add_modifier(Modifier::BOLD),
        State::Stale(_) | State::Ended(_) => loud(),
    };
    let lost_style = if facts.lost.is_none_or(|lost| lost == 0) { Style::new().fg(QUIET) } else { loud() };
    let latency = facts.latency_us.map(|[p50, p99]| format!("p50 {p50:.0} p99 {p99:.0} µs"));
    Line::from(vec![
        Span::styled(name.clone(), Modifier::BOLD),
        Span::raw("  "),
        Span::styled(state.word(), state_style),
        Span::raw("  "),
        Span::styled(format!("lost {}", known(facts.lost.map(|lost| lost.to_string()))), lost_style),
        Span::raw(format!("  latency {}", known(latency))),
        Span::raw(format!("  {} Hz", known(facts.rate_hz.map(|hz| format!("{hz:.1}"))))),
        Span::raw(format!("  tick {}", known(facts.tick.map(|tick| tick.to_string())))),
    ])
}

fn attitude_lines(picture: &Picture) -> Vec<Line<'static>> {
    let Some(attitude) = &picture.attitude else {
        return vec![Line::styled("none yet: the first tick", QUIET)];
    };
    let Attitude { course_deg, course_reference, rate_deg_s, flags, .. } = attitude;
    let [roll, pitch, yaw] = attitude.roll_pitch_yaw_deg;
    let flags = match &flags[..] {
        [] => Line::styled("no flags", QUIET),
        [one] => Line::styled(*one, VERMILION),
        [first, more @ ..] => Line::styled(format!("{first} and {} more", more.len()), VERMILION),
    };
    let bold = |name: &'static str, degrees: f64| {
        Line::from(vec![Span::raw(name), Span::styled(format!("{:>7}°", signed(degrees)), Modifier::BOLD)])
    };
    vec![
        bold("roll   ", roll),
        bold("pitch  ", pitch),
        Line::from(format!("tilt   {:>10}", deviation(attitude.inclination_sd_deg, 2))),
        bold("yaw    ", yaw),
        Line::from(format!("course {course_deg:>7.1}° {course_reference} {}", deviation(attitude.course_sd_deg, 1))),
        Line::from(format!("rate {} °/s", rate_deg_s.map(signed).join(" "))),
        flags,
    ]
}

fn attitude_in_a_line(picture: &Picture) -> String {
    let Some(Attitude { roll_pitch_yaw_deg: [roll, pitch, yaw], course_deg, course_reference, .. }) = &picture.attitude
    else {
        return "no attitude yet".into();
    };
    let [roll, pitch, yaw] = [roll, pitch, yaw].map(|degrees| signed(*degrees));
    format!("roll {roll}° pitch {pitch}° yaw {yaw}° course {course_deg:.1}° {course_reference}")
}

/// To a tenth, with its sign; what is rounded to zero is +0.0.
pub(crate) fn signed(number: f64) -> String {
    let rounded = (number * 10.0).round() / 10.0 + 0.0;
    format!("{rounded:+.1}")
}

fn deviation(degrees: Option<f64>, digits: usize) -> String {
    degrees.map_or("± –".into(), |degrees| format!("± {degrees:.digits$}°"))
}

/// A line or more for each: its name, its bars, its newest value.
fn trends(frame: &mut Frame<'_>, area: Rect, trends: &[Trend], dim: bool) {
    let height = (area.height / trends.len().max(1) as u16).max(1);
    for (i, trend) in (0..).zip(trends) {
        let line = Rect { y: area.y + i * height, height, ..area }.intersection(area);
        let [name, bars_area, value] =
            Layout::horizontal([Constraint::Length(6), Constraint::Min(4), Constraint::Length(10)]).areas(line);
        let middle =
            |area: Rect| Rect { y: area.y + area.height.saturating_sub(1), height: area.height.min(1), ..area };
        frame.render_widget(Line::raw(trend.name), middle(name));
        let steps = STEPS * u64::from(line.height);
        let bars = trend.bars(bars_area.width.into(), steps).into_iter().map(SparklineBar::from);
        let colour = match trend.name {
            _ if dim => QUIET,
            "lost" => VERMILION,
            _ => BLUE,
        };
        frame.render_widget(Sparkline::default().data(bars).max(steps).style(colour), bars_area);
        frame.render_widget(Line::styled(trend.newest(), faded(dim)).right_aligned(), middle(value));
    }
}

/// Below one another; the last takes what is left.
fn panels(frame: &mut Frame<'_>, area: Rect, panels: &[Panel]) {
    let [before @ .., _] = panels else { return };
    let most = area.height / 2;
    let heights = before.iter().map(|panel| Constraint::Length((panel.rows.len() as u16).saturating_add(2).min(most)));
    let areas = Layout::vertical(heights.chain([Constraint::Min(0)])).split(area);
    for (panel, area) in panels.iter().zip(areas.iter()) {
        panel_in(frame, *area, panel);
    }
}

fn panel_in(frame: &mut Frame<'_>, area: Rect, panel: &Panel) {
    let room = usize::from(area.height.saturating_sub(2));
    let heads = panel.rows.iter().take_while(|row| row.mark == Mark::Head).count();
    let (heads, rows) = panel.rows.split_at(heads);
    let room = room.saturating_sub(heads.len());
    let chosen = rows.iter().position(|row| row.mark == Mark::Chosen).unwrap_or_default();
    let first = (chosen + 1).saturating_sub(room).min(rows.len().saturating_sub(room));
    let shown = &rows[first..rows.len().min(first + room)];
    let title = if shown.len() < rows.len() {
        format!("{}: {} to {} of {}", panel.title, first + 1, first + shown.len(), rows.len())
    } else {
        panel.title.clone()
    };
    let inner = framed(frame, area, &title);
    let lines: Vec<_> = heads.iter().chain(shown).map(line).collect();
    frame.render_widget(Paragraph::new(lines), inner);
}

fn line(row: &Row) -> Line<'_> {
    let style = match row.mark {
        Mark::Head => Style::new().fg(QUIET),
        Mark::Usual => Style::new(),
        Mark::Bad => Style::new().fg(VERMILION).add_modifier(Modifier::BOLD),
        Mark::Chosen => Style::new().add_modifier(Modifier::REVERSED),
    };
    Line::styled(row.text.as_str(), style)
}

/// A frame with a title; what is inside it.
fn framed(frame: &mut Frame<'_>, area: Rect, title: &str) -> Rect {
    let block = Block::bordered().border_style(QUIET).title(Span::styled(format!(" {title} "), Style::reset()));
    let inner = block.inner(area);
    frame.render_widget(block, area);
    inner
}

fn is_fresh(state: &State) -> bool {
    *state == State::Live
}

fn faded(dim: bool) -> Style {
    if dim { Style::new().fg(QUIET) } else { Style::new() }
}

fn loud() -> Style {
    Style::new().fg(VERMILION).add_modifier(Modifier::BOLD | Modifier::REVERSED)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use std::time::Duration;

    use ratatui::{Terminal, backend::TestBackend, buffer::Buffer};

    use super::*;
    use crate::Facts;

    fn picture(state: State) -> Picture {
        let facts =
            Facts { tick: Some(123_456), rate_hz: Some(1000.04), latency_us: Some([45.2, 120.7]), lost: Some(0) };
        let (sin, cos) = 20_f64.to_radians().sin_cos();
        let attitude = Attitude {
            up: [-sin, 0.0, cos],
            roll_pitch_yaw_deg: [20.0, -0.04, 123.45],
            inclination_sd_deg: Some(0.25),
            course_deg: 236.55,
            course_sd_deg: None,
            course_reference: "arb.",
            rate_deg_s: [0.04, -1.25, 3.0],
            frame: "enu-rfu",
            flags: vec!["force-clipped"],
        };
        let mut trends = crate::Trends::default();
        for i in 0..120 {
            let facts = Facts { rate_hz: Some(f64::from(i)), ..facts };
            trends.step(&facts, Some(&attitude));
        }
        let rows = [
            Row::new(Mark::Head, "service state"),
            Row::new(Mark::Usual, "gyro running"),
            Row::new(Mark::Bad, "fuser gone"),
        ];
        let panels = vec![Panel { title: "services".into(), rows: rows.into() }];
        Picture { name: "boat".into(), state, facts, attitude: Some(attitude), trends, panels, keys: "q ends" }
    }

    fn drawn(width: u16, height: u16, picture: &Picture) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, picture)).unwrap();
        terminal.backend().buffer().clone()
    }

    fn lines(buffer: &Buffer) -> Vec<String> {
        let symbols: Vec<_> = buffer.content.iter().map(ratatui::buffer::Cell::symbol).collect();
        symbols.chunks(buffer.area.width.into()).map(|line| line.concat()).collect()
    }

    #[test]
    fn from_80_by_24_on_everything_is_there() {
        for (width, height) in [(80, 24), (120, 40), (200, 60)] {
            let lines = lines(&drawn(width, height, &picture(State::Live)));
            let text = lines.join("\n");
            assert_eq!(
                lines[0].trim_end(),
                "boat  live  lost 0  latency p50 45 p99 121 µs  1000.0 Hz  tick 123456",
                "{text}"
            );
            for words in [
                "attitude, enu-rfu",
                "roll     +20.0°",
                "pitch     +0.0°",
                "tilt      ± 0.25°",
                "yaw     +123.5°",
                "course   236.6° arb. ± –",
                "rate +0.0 -1.3 +3.0 °/s",
                "force-clipped",
                "last minute",
                "119 Hz",
                "horizon",
                "services",
                "gyro running",
                "fuser gone",
            ] {
                assert!(text.contains(words), "{words:?} at {width}×{height}:\n{text}");
            }
            assert_eq!(lines.last().unwrap().trim_end(), "q ends");
        }
    }

    #[test]
    fn the_horizon_is_tilted_as_the_body_is_not() {
        let buffer = drawn(80, 24, &picture(State::Live));
        let blue: Vec<_> = (1..18).filter_map(|x| Some((x, (2..9).find(|y| buffer[(x, *y)].fg == BLUE)?))).collect();
        assert!(blue.len() > 10, "{blue:?}");
        assert!(
            blue.first().unwrap().1 > blue.last().unwrap().1,
            "right side down, the horizon rises at the right: {blue:?}"
        );
    }

    #[test]
    fn what_is_stale_is_grey_and_says_so() {
        let roll = |state| {
            let buffer = drawn(80, 24, &picture(state));
            let lines = lines(&buffer);
            let y = lines.iter().position(|line| line.contains("roll     +20.0°")).unwrap();
            let x = lines[y].chars().position(|letter| letter == '+').unwrap();
            (lines[0].clone(), buffer[(x as u16, y as u16)].fg)
        };
        let (bar, colour) = roll(State::Stale(Duration::from_millis(1200)));
        assert!(bar.starts_with("boat  stale 1.2 s  lost 0"), "{bar}");
        assert_eq!(colour, QUIET);
        assert_ne!(roll(State::Live).1, QUIET);
        let (bar, colour) = roll(State::Ended("stopped".into()));
        assert!(bar.starts_with("boat  ended: stopped"), "{bar}");
        assert_eq!(colour, QUIET);
    }

    #[test]
    fn a_loss_and_a_fault_are_loud() {
        let mut picture = picture(State::Live);
        picture.facts.lost = Some(3);
        let buffer = drawn(80, 24, &picture);
        let lines = lines(&buffer);
        let x = lines[0].find("lost 3").unwrap();
        assert_eq!(buffer[(x as u16, 0)].fg, VERMILION);
        let y = lines.iter().position(|line| line.contains("fuser gone")).unwrap();
        assert_eq!(buffer[(1, y as u16)].fg, VERMILION);
    }

    #[test]
    fn what_is_unknown_is_a_dash() {
        let picture = Picture { name: "boat".into(), keys: "q ends", ..Picture::default() };
        let lines = lines(&drawn(80, 24, &picture));
        assert_eq!(lines[0].trim_end(), "boat  connecting  lost –  latency –  – Hz  tick –");
        assert!(lines.concat().contains("none yet: the first tick"), "{}", lines.join("\n"));
    }

    #[test]
    fn every_size_is_drawn_and_a_small_one_says_what_would_do() {
        for width in 1..130 {
            for height in 1..45 {
                drawn(width, height, &picture(State::Live));
                drawn(width, height, &Picture::default());
            }
        }
        let text = lines(&drawn(60, 12, &picture(State::Live))).join("\n");
        for words in ["boat  live", "roll +20.0° pitch +0.0° yaw +123.5° course 236.6° arb.", "fuser gone", "q ends"]
        {
            assert!(text.contains(words), "{words:?}\n{text}");
        }
        let text = lines(&drawn(30, 7, &picture(State::Live))).join("\n");
        assert!(text.contains("boat live") && text.contains("30×7 is too small"), "{text}");
    }

    #[test]
    fn of_many_lines_those_are_shown_that_hold_the_chosen_one() {
        let rows = (0..50).map(|i| Row::new(if i == 40 { Mark::Chosen } else { Mark::Usual }, format!("vehicle {i}")));
        let rows = [Row::new(Mark::Head, "name")].into_iter().chain(rows).collect();
        let fleet = Panel { title: "vehicles".into(), rows };
        let picture = Picture { panels: vec![fleet], ..picture(State::Live) };
        let text = lines(&drawn(80, 24, &picture)).join("\n");
        assert!(text.contains("vehicle 40") && text.contains(" of 50") && text.contains("name"), "{text}");
    }
}
