//! Calibration and mounting check on the page, with a sensor unit that is first level and then nose
//! down.
use std::{
    fs,
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
    operator::viewer_address,
    page::{address, with_cockpit_for_browser},
};
use crate::common::{Running, wait_for};

const RATE_RAD_S: f64 = 0.5;
const NOSE_DOWN_RAD: f64 = 0.7;

/// Feeds samples from a sensor unit at rest through standard input until the system ends.
///
/// The unit is rotated nose down once the returned flag is set.
fn feed(running: &mut Running) -> Arc<AtomicBool> {
    let mut input = running.stdin();
    let down = Arc::new(AtomicBool::new(false));
    let is_down = down.clone();
    thread::spawn(move || {
        let (mut tick, mut pitch_rad) = (0u32, 0.0_f64);
        loop {
            let mut lines = String::new();
            for _ in 0..2 {
                tick += 1;
                let rate_rad_s = if is_down.load(SeqCst) && pitch_rad > -NOSE_DOWN_RAD { -RATE_RAD_S } else { 0.0 };
                pitch_rad += rate_rad_s * 0.01;
                // Real samples are never identical, and constant values would be flagged as stuck.
                let noise = 1e-3 * (f64::from(tick) * 1.7).sin();
                let (t_s, sin, cos) = (f64::from(tick) * 0.01, pitch_rad.sin(), pitch_rad.cos());
                let rate = format!("{:.5},{noise:.5},{:.5}", rate_rad_s + noise, -noise);
                lines += &format!("{t_s:.2},{rate},{noise:.5},{:.5},{:.5}\n", 9.80665 * sin + noise, 9.80665 * cos);
            }
            if input.write_all(lines.as_bytes()).is_err() {
                return;
            }
            thread::sleep(Duration::from_millis(20));
        }
    });
    down
}

fn start_calibration(page: &mut Page, what: &str) {
    page.eval(&format!("document.getElementById('calibration-kind').value = '{what}'"));
    page.click("#calibrate");
    page.until(&format!("plumb.drawn()?.calibration?.what === '{what}'"));
}

#[test]
fn calibration_reports_missing_data_and_finds_mounting() {
    let (system, port) = with_cockpit_for_browser("ingest.source = \"stdin\"\ningest.stdin.rate_hz = 100\n");
    let mut command = system.command(&[]);
    command.stdin(Stdio::piped());
    let mut running = Running::spawn(command);
    let down = feed(&mut running);
    system.wait_until_running();
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live'");
    page.key("3");

    // So far, the unit has rested in only one of the six positions.
    start_calibration(&mut page, "accel");
    page.until("plumb.drawn().calibration.covered === 4 && plumb.drawn().calibration.share > 0");
    let message = page.text("document.getElementById('coverage').textContent");
    assert!(message.contains("2 s of rest in each position: x up, x down"), "{message}");
    page.shot("sensors-coverage.png");

    start_calibration(&mut page, "mounting");
    page.click("#mounting");
    page.until("plumb.drawn().mounting.step === 'nose down'");
    page.until(
        "(({ missing }) => missing.length === 1 && missing[0].startsWith('a second pose'))(plumb.drawn().calibration)",
    );
    down.store(true, SeqCst);
    page.until("plumb.drawn().mounting.step === 'done'");
    let verdict = page.text("plumb.drawn().mounting.verdict");
    assert!(verdict.starts_with("Mounting correct: level within 0."), "{verdict}");
    page.until("plumb.drawn().calibration.report");
    let report = page.text("document.getElementById('report').textContent");
    assert!(report.contains("[ingest.mounting]\nquaternion = [1.0000000, "), "{report}");
    page.shot("sensors-found.png");

    // Every viewer sees the result, but only an operator can apply it.
    let launch_file = system.path("launch.toml");
    let before = fs::read_to_string(&launch_file).unwrap();
    let applied = "document.getElementById('applied').textContent";
    let mut viewer = Page::open(&format!("{}/sensors", viewer_address(&system, port))).unwrap();
    viewer.until("plumb.drawn()?.calibration?.report");
    viewer.click("#apply");
    viewer.until(&format!("{applied}.includes('cannot send commands')"));
    assert_eq!(fs::read_to_string(&launch_file).unwrap(), before);
    page.click("#apply");
    page.until(&format!("{applied}.startsWith('Written to the launch file.')"));
    let after = fs::read_to_string(&launch_file).unwrap();
    assert!(after.starts_with(&before) && after.contains("[ingest.mounting]\nquaternion = [1.0000000, "), "{after}");
    page.shot("sensors-applied.png");
    page.assert_clean();

    // A calibration requires the token.
    let mut without_token = Page::open(&format!("http://127.0.0.1:{port}/")).unwrap();
    without_token.until("plumb.state().kind === 'live'");
    without_token.key("3");
    without_token.click("#calibrate");
    without_token.until("plumb.drawn()?.calibration.error.startsWith('commands require a token')");
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
}

#[test]
fn mounting_check_detects_unit_on_its_side() {
    // The launch file wrongly declares the unit's x axis to be forward. A unit with its nose down
    // therefore seems to have its right side raised.
    let mounting =
        "[ingest]\nsource = \"stdin\"\nstdin.rate_hz = 100\n[ingest.mounting]\naxes = \"x-forward-y-left\"\n";
    let (system, port) = with_cockpit_for_browser(mounting);
    let mut command = system.command(&[]);
    command.stdin(Stdio::piped());
    let mut running = Running::spawn(command);
    let down = feed(&mut running);
    system.wait_until_running();
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live'");
    page.key("3");
    page.until("plumb.drawn()?.mounting");
    page.click("#mounting");
    page.until("plumb.drawn().mounting.step === 'nose down'");
    down.store(true, SeqCst);
    page.until("plumb.drawn().mounting.step === 'done'");
    let verdict = page.text("plumb.drawn().mounting.verdict");
    assert!(verdict.contains("the right rises instead of the tail: the unit is rotated by 90.0°"), "{verdict}");
    page.assert_clean();
    running.interrupt();
    assert_eq!(running.wait().code, Some(0));
}

#[test]
fn calibration_without_readings_reports_remedy() {
    let (system, port) = with_cockpit_for_browser("");
    let running = system.start(&[]);
    system.wait_until_running();
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live'");
    page.key("3");
    page.until("plumb.drawn()?.calibration");
    page.click("#calibrate");
    page.until("plumb.drawn().calibration.error.includes('plumb up --readings')");
    running.interrupt();
    running.wait().assert_complete();
    wait_for("the end", || system.leftovers().is_empty());
}
