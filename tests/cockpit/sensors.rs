//! Calibration and mounting check in the page, of a unit that is laid level and then nose down.
use std::{
    io::Write as _,
    process::Stdio,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::SeqCst},
    },
    thread,
    time::Duration,
};

use super::{
    browser::Page,
    page::{address, looked_at},
};
use crate::common::{Running, until};

const RATE_RAD_S: f64 = 0.5;
const DOWN_RAD: f64 = 0.7;

/// A unit at rest on standard input, which is turned nose down once that is said, until the system ends.
fn fed(running: &mut Running) -> Arc<AtomicBool> {
    let mut input = running.stdin();
    let down = Arc::new(AtomicBool::new(false));
    let is_down = down.clone();
    thread::spawn(move || {
        let (mut tick, mut pitch_rad) = (0u32, 0.0_f64);
        loop {
            let mut lines = String::new();
            for _ in 0..2 {
                tick += 1;
                let rate_rad_s = if is_down.load(SeqCst) && pitch_rad > -DOWN_RAD { -RATE_RAD_S } else { 0.0 };
                pitch_rad += rate_rad_s * 0.01;
                // No sensor says the same twice.
                let tremble = 1e-3 * (f64::from(tick) * 1.7).sin();
                let (t_s, sin, cos) = (f64::from(tick) * 0.01, pitch_rad.sin(), pitch_rad.cos());
                let rate = format!("{:.5},{tremble:.5},{:.5}", rate_rad_s + tremble, -tremble);
                lines += &format!("{t_s:.2},{rate},{tremble:.5},{:.5},{:.5}\n", 9.80665 * sin + tremble, 9.80665 * cos);
            }
            if input.write_all(lines.as_bytes()).is_err() {
                return;
            }
            thread::sleep(Duration::from_millis(20));
        }
    });
    down
}

fn begun(page: &mut Page, what: &str) {
    page.eval(&format!("document.getElementById('calibrated').value = '{what}'"));
    page.click("#calibrate");
    page.until(&format!("plumb.drawn()?.calibration?.what === '{what}'"));
}

#[test]
fn calibration_shows_what_is_missing_and_the_mounting_is_checked_and_found() {
    let (system, port) = looked_at("ingest.source = \"stdin\"\ningest.stdin.rate_hz = 100\n");
    let mut command = system.command(&[]);
    command.stdin(Stdio::piped());
    let mut running = Running::of(command);
    let down = fed(&mut running);
    system.all_run();
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live'");
    page.key("3");

    // One side of six is up.
    begun(&mut page, "accel");
    page.until("plumb.drawn().calibration.covered === 4 && plumb.drawn().calibration.share > 0");
    let said = page.text("document.getElementById('coverage').textContent");
    assert!(said.contains("no rest with x up, nor with x down"), "{said}");
    page.shot("sensors-coverage.png");

    begun(&mut page, "mounting");
    page.click("#mounting");
    page.until("plumb.drawn().mounting.step === 'nose down'");
    page.until(
        "(({ missing }) => missing.length === 1 && missing[0].startsWith('a second pose'))(plumb.drawn().calibration)",
    );
    down.store(true, SeqCst);
    page.until("plumb.drawn().mounting.step === 'done'");
    let verdict = page.text("plumb.drawn().mounting.verdict");
    assert!(verdict.starts_with("The mounting is right: level within 0."), "{verdict}");
    page.until("plumb.drawn().calibration.report");
    let report = page.text("document.getElementById('report').textContent");
    assert!(report.contains("[ingest.mounting]\nquaternion = [1.0000000, "), "{report}");
    page.shot("sensors-found.png");
    page.assert_clean();

    // Who has no token calibrates nothing.
    let mut stranger = Page::open(&format!("http://127.0.0.1:{port}/")).unwrap();
    stranger.until("plumb.state().kind === 'live'");
    stranger.key("3");
    stranger.click("#calibrate");
    stranger.until("plumb.drawn()?.calibration.refused.startsWith('commands need the token')");
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
}

#[test]
fn a_unit_that_sits_on_its_side_is_told_apart() {
    // Forward of the body is the unit's right: nose down raises the body's side.
    let mounting =
        "[ingest]\nsource = \"stdin\"\nstdin.rate_hz = 100\n[ingest.mounting]\naxes = \"x-forward-y-left\"\n";
    let (system, port) = looked_at(mounting);
    let mut command = system.command(&[]);
    command.stdin(Stdio::piped());
    let mut running = Running::of(command);
    let down = fed(&mut running);
    system.all_run();
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live'");
    page.key("3");
    page.until("plumb.drawn()?.mounting");
    page.click("#mounting");
    page.until("plumb.drawn().mounting.step === 'nose down'");
    down.store(true, SeqCst);
    page.until("plumb.drawn().mounting.step === 'done'");
    let verdict = page.text("plumb.drawn().mounting.verdict");
    assert!(verdict.contains("nose down, its right rises, not its tail: the unit is turned by 90.0°"), "{verdict}");
    page.assert_clean();
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
}

#[test]
fn a_simulation_whose_readings_are_not_published_says_what_to_do() {
    let (system, port) = looked_at("");
    let running = system.start(&[]);
    system.all_run();
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live'");
    page.key("3");
    page.until("plumb.drawn()?.calibration");
    page.click("#calibrate");
    page.until("plumb.drawn().calibration.refused.includes('plumb up --readings')");
    running.interrupt();
    running.wait().assert_whole();
    until("the end", || system.remains().is_empty());
}
