//! Draws a snapshot to fit the size of the terminal.
//!
//! A terminal of 80×24 or more shows everything. A smaller terminal shows no horizon and no trends,
//! and a terminal below 40×8 shows only state and attitude.

use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::{Modifier, Style},
    text::{Line, Span},
    widgets::{Block, Paragraph, Sparkline, SparklineBar, Wrap},
};

use crate::{
    Attitude, DataState, Panel, Row, RowStyle, Snapshot, Trend,
    colours::{BLUE, GREEN, MUTED, VERMILION},
    horizon,
    trend::format_signed,
};

/// Minimum size for the full view: columns, lines.
const FULL_SIZE: (u16, u16) = (80, 24);
/// Minimum size for the reduced view: columns, lines.
const MIN_SIZE: (u16, u16) = (40, 8);
/// Number of different heights of a bar within one character.
const STEPS_PER_CHARACTER: u64 = 8;

/// Draws a snapshot over the whole frame.
pub(crate) fn draw(frame: &mut Frame<'_>, snapshot: &Snapshot) {
    let area = frame.area();
    if area.width < MIN_SIZE.0 || area.height < MIN_SIZE.1 {
        draw_too_small(frame, area, snapshot);
    } else if area.width < FULL_SIZE.0 || area.height < FULL_SIZE.1 {
        draw_reduced(frame, area, snapshot);
    } else {
        draw_full(frame, area, snapshot);
    }
}

fn draw_full(frame: &mut Frame<'_>, area: Rect, snapshot: &Snapshot) {
    let upper = if area.height >= 36 { 14 } else { 9 };
    let [status_area, upper, panels_area, keys_area] =
        Layout::vertical([Constraint::Length(1), Constraint::Length(upper), Constraint::Min(3), Constraint::Length(1)])
            .areas(area);
    let horizon_width = 2 * upper.height + 1;
    let [horizon_area, attitude_area, trends_area] =
        Layout::horizontal([Constraint::Length(horizon_width), Constraint::Length(30), Constraint::Min(20)])
            .areas(upper);
    frame.render_widget(status_line(snapshot), status_area);
    let dim = !is_fresh(&snapshot.state);
    let horizon_inner = draw_frame(frame, horizon_area, "horizon");
    if let Some(attitude) = &snapshot.attitude {
        horizon::draw(frame, horizon_inner, attitude.up, dim);
    }
    let title =
        snapshot.attitude.as_ref().map_or("attitude".into(), |attitude| format!("attitude, {}", attitude.frame));
    let inner = draw_frame(frame, attitude_area, &title);
    frame.render_widget(Paragraph::new(attitude_lines(snapshot)).style(text_style(dim)), inner);
    let inner = draw_frame(frame, trends_area, "last minute");
    draw_trends(frame, inner, &snapshot.trends.all, dim);
    draw_panels(frame, panels_area, &snapshot.panels);
    frame.render_widget(Line::styled(snapshot.key_help, MUTED), keys_area);
}

fn draw_reduced(frame: &mut Frame<'_>, area: Rect, snapshot: &Snapshot) {
    let [status_area, attitude_area, panels_area, keys_area] =
        Layout::vertical([Constraint::Length(1), Constraint::Length(1), Constraint::Min(3), Constraint::Length(1)])
            .areas(area);
    frame.render_widget(status_line(snapshot), status_area);
    frame.render_widget(Line::styled(attitude_line(snapshot), text_style(!is_fresh(&snapshot.state))), attitude_area);
    draw_panels(frame, panels_area, &snapshot.panels);
    frame.render_widget(Line::styled(snapshot.key_help, MUTED), keys_area);
}

fn draw_too_small(frame: &mut Frame<'_>, area: Rect, snapshot: &Snapshot) {
    let (columns, lines) = FULL_SIZE;
    let text = vec![
        Line::from(format!("{} {}", snapshot.name, snapshot.state.label())),
        Line::from(attitude_line(snapshot)),
        Line::from(format!("{}×{} is too small; {columns}×{lines} shows all", area.width, area.height)),
    ];
    frame.render_widget(Paragraph::new(text).wrap(Wrap { trim: true }), area);
}

/// Returns the status line. A narrow terminal cuts off the end, so the least important figures come
/// last.
fn status_line(snapshot: &Snapshot) -> Line<'static> {
    let Snapshot { name, state, figures, .. } = snapshot;
    let or_dash = |number: Option<String>| number.unwrap_or_else(|| "–".into());
    let state_style = match state {
        DataState::Live => Style::new().fg(GREEN).add_modifier(Modifier::BOLD),
        DataState::Connecting => Style::new().add_modifier(Modifier::BOLD),
        DataState::Stale(_) | DataState::Ended(_) => alert_style(),
    };
    let lost_style = if figures.lost.is_none_or(|lost| lost == 0) { Style::new().fg(MUTED) } else { alert_style() };
    let latency = figures.latency_us.map(|[p50, p99]| format!("p50 {p50:.0} p99 {p99:.0} µs"));
    Line::from(vec![
        Span::styled(name.clone(), Modifier::BOLD),
        Span::raw("  "),
        Span::styled(state.label(), state_style),
        Span::raw("  "),
        Span::styled(format!("lost {}", or_dash(figures.lost.map(|lost| lost.to_string()))), lost_style),
        Span::raw(format!("  latency {}", or_dash(latency))),
        Span::raw(format!("  {} Hz", or_dash(figures.rate_hz.map(|hz| format!("{hz:.1}"))))),
        Span::raw(format!("  tick {}", or_dash(figures.tick.map(|tick| tick.to_string())))),
    ])
}

fn attitude_lines(snapshot: &Snapshot) -> Vec<Line<'static>> {
    let Some(attitude) = &snapshot.attitude else {
        return vec![Line::styled("no attitude yet", MUTED)];
    };
    let Attitude { course_deg, course_reference, rate_deg_s, flags, .. } = attitude;
    let [roll, pitch, yaw] = attitude.roll_pitch_yaw_deg;
    let flags = match &flags[..] {
        [] => Line::styled("no flags", MUTED),
        [flag] => Line::styled(*flag, VERMILION),
        [first, rest @ ..] => Line::styled(format!("{first} and {} more", rest.len()), VERMILION),
    };
    let bold = |name: &'static str, degrees: f64| {
        Line::from(vec![Span::raw(name), Span::styled(format!("{:>7}°", format_signed(degrees)), Modifier::BOLD)])
    };
    vec![
        bold("roll   ", roll),
        bold("pitch  ", pitch),
        Line::from(format!("tilt   {:>10}", format_sd(attitude.inclination_sd_deg, 2))),
        bold("yaw    ", yaw),
        Line::from(format!("course {course_deg:>7.1}° {course_reference} {}", format_sd(attitude.course_sd_deg, 1))),
        Line::from(format!("rate {} °/s", rate_deg_s.map(format_signed).join(" "))),
        flags,
    ]
}

fn attitude_line(snapshot: &Snapshot) -> String {
    let Some(Attitude { roll_pitch_yaw_deg: [roll, pitch, yaw], course_deg, course_reference, .. }) =
        &snapshot.attitude
    else {
        return "no attitude yet".into();
    };
    let [roll, pitch, yaw] = [roll, pitch, yaw].map(|degrees| format_signed(*degrees));
    format!("roll {roll}° pitch {pitch}° yaw {yaw}° course {course_deg:.1}° {course_reference}")
}

fn format_sd(degrees: Option<f64>, digits: usize) -> String {
    degrees.map_or("± –".into(), |degrees| format!("± {degrees:.digits$}°"))
}

/// Draws each trend in a separate row: name, bars, newest value.
fn draw_trends(frame: &mut Frame<'_>, area: Rect, trends: &[Trend], dim: bool) {
    let height = (area.height / trends.len().max(1) as u16).max(1);
    for (i, trend) in (0..).zip(trends) {
        let line = Rect { y: area.y + i * height, height, ..area }.intersection(area);
        let [name, bars_area, value] =
            Layout::horizontal([Constraint::Length(6), Constraint::Min(4), Constraint::Length(10)]).areas(line);
        let middle =
            |area: Rect| Rect { y: area.y + area.height.saturating_sub(1), height: area.height.min(1), ..area };
        frame.render_widget(Line::raw(trend.name), middle(name));
        let steps = STEPS_PER_CHARACTER * u64::from(line.height);
        let bars = trend.bars(bars_area.width.into(), steps).into_iter().map(SparklineBar::from);
        let colour = match trend.name {
            _ if dim => MUTED,
            "lost" => VERMILION,
            _ => BLUE,
        };
        frame.render_widget(Sparkline::default().data(bars).max(steps).style(colour), bars_area);
        frame.render_widget(Line::styled(trend.newest(), text_style(dim)).right_aligned(), middle(value));
    }
}

/// Draws the panels from top to bottom. The last one takes the remaining height.
fn draw_panels(frame: &mut Frame<'_>, area: Rect, panels: &[Panel]) {
    let [upper @ .., _] = panels else { return };
    let max_height = area.height / 2;
    let heights =
        upper.iter().map(|panel| Constraint::Length((panel.rows.len() as u16).saturating_add(2).min(max_height)));
    let areas = Layout::vertical(heights.chain([Constraint::Min(0)])).split(area);
    for (panel, area) in panels.iter().zip(areas.iter()) {
        draw_panel(frame, *area, panel);
    }
}

fn draw_panel(frame: &mut Frame<'_>, area: Rect, panel: &Panel) {
    let capacity = usize::from(area.height.saturating_sub(2));
    let header_count = panel.rows.iter().take_while(|row| row.style == RowStyle::Header).count();
    let (headers, rows) = panel.rows.split_at(header_count);
    let capacity = capacity.saturating_sub(headers.len());
    let selected = rows.iter().position(|row| row.style == RowStyle::Selected).unwrap_or_default();
    let first = (selected + 1).saturating_sub(capacity).min(rows.len().saturating_sub(capacity));
    let visible = &rows[first..rows.len().min(first + capacity)];
    let title = if visible.len() < rows.len() {
        format!("{}: {} to {} of {}", panel.title, first + 1, first + visible.len(), rows.len())
    } else {
        panel.title.clone()
    };
    let inner = draw_frame(frame, area, &title);
    let lines: Vec<_> = headers.iter().chain(visible).map(styled_line).collect();
    frame.render_widget(Paragraph::new(lines), inner);
}

fn styled_line(row: &Row) -> Line<'_> {
    let style = match row.style {
        RowStyle::Header => Style::new().fg(MUTED),
        RowStyle::Normal => Style::new(),
        RowStyle::Alert => Style::new().fg(VERMILION).add_modifier(Modifier::BOLD),
        RowStyle::Selected => Style::new().add_modifier(Modifier::REVERSED),
    };
    Line::styled(row.text.as_str(), style)
}

/// Draws a titled border and returns the area inside it.
fn draw_frame(frame: &mut Frame<'_>, area: Rect, title: &str) -> Rect {
    let block = Block::bordered().border_style(MUTED).title(Span::styled(format!(" {title} "), Style::reset()));
    let inner = block.inner(area);
    frame.render_widget(block, area);
    inner
}

fn is_fresh(state: &DataState) -> bool {
    *state == DataState::Live
}

fn text_style(dim: bool) -> Style {
    if dim { Style::new().fg(MUTED) } else { Style::new() }
}

fn alert_style() -> Style {
    Style::new().fg(VERMILION).add_modifier(Modifier::BOLD | Modifier::REVERSED)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use ratatui::{Terminal, backend::TestBackend, buffer::Buffer};

    use super::*;
    use crate::Figures;

    fn example_snapshot(state: DataState) -> Snapshot {
        let figures =
            Figures { tick: Some(123_456), rate_hz: Some(1000.04), latency_us: Some([45.2, 120.7]), lost: Some(0) };
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
            let figures = Figures { rate_hz: Some(f64::from(i)), ..figures };
            trends.push(&figures, Some(&attitude));
        }
        let rows = [
            Row::new(RowStyle::Header, "service state"),
            Row::new(RowStyle::Normal, "gyro running"),
            Row::new(RowStyle::Alert, "fuser failed"),
        ];
        let panels = vec![Panel { title: "services".into(), rows: rows.into() }];
        Snapshot { name: "boat".into(), state, figures, attitude: Some(attitude), trends, panels, key_help: "q: quit" }
    }

    fn render(width: u16, height: u16, snapshot: &Snapshot) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, snapshot)).unwrap();
        terminal.backend().buffer().clone()
    }

    fn lines(buffer: &Buffer) -> Vec<String> {
        let symbols: Vec<_> = buffer.content.iter().map(ratatui::buffer::Cell::symbol).collect();
        symbols.chunks(buffer.area.width.into()).map(|line| line.concat()).collect()
    }

    #[test]
    fn everything_is_shown_from_80_by_24() {
        for (width, height) in [(80, 24), (120, 40), (200, 60)] {
            let lines = lines(&render(width, height, &example_snapshot(DataState::Live)));
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
                "fuser failed",
            ] {
                assert!(text.contains(words), "{words:?} at {width}×{height}:\n{text}");
            }
            assert_eq!(lines.last().unwrap().trim_end(), "q: quit");
        }
    }

    #[test]
    fn horizon_tilts_opposite_to_body() {
        let buffer = render(80, 24, &example_snapshot(DataState::Live));
        let blue: Vec<_> = (1..18).filter_map(|x| Some((x, (2..9).find(|y| buffer[(x, *y)].fg == BLUE)?))).collect();
        assert!(blue.len() > 10, "{blue:?}");
        assert!(
            blue.first().unwrap().1 > blue.last().unwrap().1,
            "right side down, the horizon rises at the right: {blue:?}"
        );
    }

    #[test]
    fn stale_data_are_muted_and_labelled() {
        let roll = |state| {
            let buffer = render(80, 24, &example_snapshot(state));
            let lines = lines(&buffer);
            let y = lines.iter().position(|line| line.contains("roll     +20.0°")).unwrap();
            let x = lines[y].chars().position(|letter| letter == '+').unwrap();
            (lines[0].clone(), buffer[(x as u16, y as u16)].fg)
        };
        let (bar, colour) = roll(DataState::Stale(Duration::from_millis(1200)));
        assert!(bar.starts_with("boat  stale 1.2 s  lost 0"), "{bar}");
        assert_eq!(colour, MUTED);
        assert_ne!(roll(DataState::Live).1, MUTED);
        let (bar, colour) = roll(DataState::Ended("stopped".into()));
        assert!(bar.starts_with("boat  ended: stopped"), "{bar}");
        assert_eq!(colour, MUTED);
    }

    #[test]
    fn losses_and_faults_are_highlighted() {
        let mut snapshot = example_snapshot(DataState::Live);
        snapshot.figures.lost = Some(3);
        let buffer = render(80, 24, &snapshot);
        let lines = lines(&buffer);
        let x = lines[0].find("lost 3").unwrap();
        assert_eq!(buffer[(x as u16, 0)].fg, VERMILION);
        let y = lines.iter().position(|line| line.contains("fuser failed")).unwrap();
        assert_eq!(buffer[(1, y as u16)].fg, VERMILION);
    }

    #[test]
    fn unknown_values_are_dashes() {
        let snapshot = Snapshot { name: "boat".into(), key_help: "q: quit", ..Snapshot::default() };
        let lines = lines(&render(80, 24, &snapshot));
        assert_eq!(lines[0].trim_end(), "boat  connecting  lost –  latency –  – Hz  tick –");
        assert!(lines.concat().contains("no attitude yet"), "{}", lines.join("\n"));
    }

    #[test]
    fn every_size_is_drawn_and_small_one_shows_hint() {
        for width in 1..130 {
            for height in 1..45 {
                render(width, height, &example_snapshot(DataState::Live));
                render(width, height, &Snapshot::default());
            }
        }
        let text = lines(&render(60, 12, &example_snapshot(DataState::Live))).join("\n");
        for words in ["boat  live", "roll +20.0° pitch +0.0° yaw +123.5° course 236.6° arb.", "fuser failed", "q: quit"]
        {
            assert!(text.contains(words), "{words:?}\n{text}");
        }
        let text = lines(&render(30, 7, &example_snapshot(DataState::Live))).join("\n");
        assert!(text.contains("boat live") && text.contains("30×7 is too small"), "{text}");
    }

    #[test]
    fn panel_scrolls_to_selected_row() {
        let rows = (0..50)
            .map(|i| Row::new(if i == 40 { RowStyle::Selected } else { RowStyle::Normal }, format!("vehicle {i}")));
        let rows = [Row::new(RowStyle::Header, "name")].into_iter().chain(rows).collect();
        let fleet = Panel { title: "vehicles".into(), rows };
        let snapshot = Snapshot { panels: vec![fleet], ..example_snapshot(DataState::Live) };
        let text = lines(&render(80, 24, &snapshot)).join("\n");
        assert!(text.contains("vehicle 40") && text.contains(" of 50") && text.contains("name"), "{text}");
    }
}
