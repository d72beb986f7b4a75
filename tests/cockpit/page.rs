//! Page of a running system.
use std::{
    fs,
    io::{BufRead as _, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
};

use super::browser::{PACKAGES, Page, run, wait_for_browser_slot};
use crate::common::{Running, System, plumb, remote::free_port, signal, wait_for};
use attitude::frames::Frame;
use rustix::process::Signal;
use serde_json::Value;

const PAGE: &str = "services/cockpit/page";

/// Restart settings for tests with browsers. Software rendering may delay a service, and the
/// delayed service must not be killed.
pub(crate) const LENIENT_RESTART: &str = "restart.silence_s = 10.0";

/// Returns a system with a cockpit and the port of its page.
pub(crate) fn with_cockpit(more: &str) -> (System, u16) {
    let port = free_port();
    let services = "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"cockpit\"]";
    (System::new(&format!("{services}\ncockpit.listen = \"127.0.0.1:{port}\"\n{more}")), port)
}

/// Waits until this test may open pages, then returns a system with a cockpit.
pub(crate) fn with_cockpit_for_browser(more: &str) -> (System, u16) {
    wait_for_browser_slot();
    with_cockpit(more)
}

pub(crate) fn address(system: &System, port: u16) -> String {
    let token = system.path("plumbline").join(&system.name).join("cockpit.token");
    wait_for("the token", || token.is_file());
    format!("http://127.0.0.1:{port}/#{}", fs::read_to_string(token).unwrap().trim())
}

/// `plumb view` process. It is killed when dropped.
pub(crate) struct View {
    child: Child,
    /// Printed address of the page.
    pub(crate) address: String,
}

impl View {
    /// Starts `plumb view` for a system on this machine, which need not be running.
    pub(crate) fn of_system(system: &System, listen: &str) -> Self {
        let mut command = plumb(&["view", "--system", &system.name, "--listen", listen]);
        command.env("XDG_STATE_HOME", system.path("")).env_remove("STATE_DIRECTORY");
        Self::start(command)
    }

    pub(crate) fn start(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut address = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut address).unwrap();
        Self { child, address: address.trim().into() }
    }

    pub(crate) fn stop(mut self) {
        signal(self.child.id(), Signal::INT);
        assert!(self.child.wait().unwrap().success());
    }
}

impl Drop for View {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub(crate) fn start_all(system: &System, arguments: &[&str]) -> Running {
    let running = system.start(arguments);
    system.wait_until_running();
    running
}

/// Returns the row of a tick in an attitude file.
pub(crate) fn row(file: &Path, tick: u64) -> Vec<f64> {
    let text = fs::read_to_string(file).unwrap();
    let line = text.lines().nth(1 + tick as usize).unwrap();
    line.split(',').map(|number| number.parse().unwrap()).collect()
}

#[test]
fn every_view_shows_published_values() {
    let (system, port) = with_cockpit_for_browser("");
    let out = system.path("out.csv");
    let running = start_all(&system, &["--out", out.to_str().unwrap()]);
    let Some(mut page) = Page::new() else { return };
    let mut samples = Vec::new();
    for (size, scheme) in [((1280, 720), "light"), ((820, 1180), "dark")] {
        let headers = page.goto(&address(&system, port), size, scheme, true);
        assert!(headers["content-security-policy"].as_str().unwrap().starts_with("default-src 'none'"), "{headers}");
        page.until("plumb.state().kind === 'live' && plumb.data.frames.length > 60");
        for (key, view) in ["fly", "method", "sensors", "system"].iter().enumerate() {
            page.key(&(key + 1).to_string());
            page.until(&format!("plumb.view() === '{view}' && plumb.drawn()"));
            page.wait_for_redraw();
            page.assert_readable(view);
            page.shot(&format!("{view}-{}-{scheme}.png", size.0));
            // The key switches to the theme that the browser does not prefer.
            page.key("t");
            page.wait_for_redraw();
            page.assert_readable(&format!("{view}, in the other theme than {scheme}"));
            page.key("t");
        }
        page.key("1");
        page.key(" ");
        page.until("document.getElementById('state').textContent === 'paused'");
        page.until("plumb.drawn().quaternion");
        let tick = page.number("plumb.data.shown().snapshot.attitude.header.tick") as u64;
        let drawn: Vec<f64> = serde_json::from_value(page.eval("plumb.drawn().quaternion")).unwrap();
        let pitch_deg = page.number("plumb.drawn().pitch_deg");
        page.key("2");
        page.until("plumb.drawn()?.w");
        let w: Vec<f64> = serde_json::from_value(page.eval("plumb.drawn().w")).unwrap();
        let w_tick = page.number("plumb.data.shown().snapshot.fused.header.tick") as u64;
        let width = page.number("document.documentElement.scrollWidth");
        assert!(width <= f64::from(size.0), "horizontal scrolling: {width} px");
        samples.push((tick, drawn, pitch_deg, w_tick, w));
    }
    let mut costs: Vec<f64> = serde_json::from_value(page.eval("plumb.frameCosts")).unwrap();
    costs.sort_by(f64::total_cmp);
    println!("script of a frame: median {:.1} ms, of {}", costs[costs.len() / 2], costs.len());
    page.assert_clean();
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
    let up = |row: &[f64]| {
        let [qw, x, y, z] = [row[1], row[2], row[3], row[4]];
        (2.0 * (x * z - qw * y), 2.0 * (y * z + qw * x), 1.0 - 2.0 * (x * x + y * y))
    };
    for (tick, drawn, pitch_deg, w_tick, w) in samples {
        let attitude = row(&out, tick);
        assert_eq!(drawn, attitude[1..5], "tick {tick}");
        let (_, b, _) = up(&attitude);
        assert!((pitch_deg - b.asin().to_degrees()).abs() < 1e-9, "{pitch_deg}");
        // The attitude is published one hop after the fused state, so the two in a snapshot may
        // belong to different ticks.
        let fused = row(&out, w_tick);
        let (a, b, c) = up(&fused);
        assert!((w[0] - a / (1.0 + c)).abs() < 1e-9 && (w[1] - b / (1.0 + c)).abs() < 1e-9, "{w:?} {fused:?}");
    }
}

#[test]
fn missing_webgl_falls_back_to_2d_with_reason() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::new() else { return };
    page.goto(&address(&system, port), (1280, 720), "light", false);
    page.until("plumb.state().kind === 'live' && plumb.drawn()?.quaternion");
    assert_eq!(page.text("plumb.fallbackReason()"), "this browser does not support WebGL 2; using the 2-D fallback");
    // Checks that the picture is not empty, and that the vertical axis is drawn between the middle
    // of the picture and the label "up z".
    let code = "(() => {
        const c = document.querySelector('.panel canvas');
        const { data } = c.getContext('2d').getImageData(0, 0, c.width, c.height);
        const drawn = (place) => data[4 * place + 3] > 0;
        const middle = Math.round(0.2 * c.height) * c.width + Math.round(c.width / 2);
        return { all: [...Array(c.width * c.height).keys()].filter(drawn).length, axis: [-2, -1, 0, 1, 2].some((off) => drawn(middle + off)) };
    })()";
    let result = page.eval(code);
    assert!(result["all"].as_u64() > Some(1000) && result["axis"] == true, "{result}");
    page.shot("fly-flat.png");
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn swap_by_click_requires_token() {
    let (system, port) = with_cockpit_for_browser(LENIENT_RESTART);
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live'");
    page.key("4");
    page.until("document.getElementById('slot').value === 'fuser'");
    page.eval("document.getElementById('stage').value = 'vqf'");
    page.click("#swap");
    page.click("#yes");
    page.until("/^(committed|aborted|refused)/.test(document.getElementById('outcome').textContent)");
    let outcome = page.text("document.getElementById('outcome').textContent");
    assert!(outcome.starts_with("committed: fuser: multiple-model → vqf from tick"), "{outcome}");
    assert!(outcome.contains("lost 0, duplicated 0"), "{outcome}");
    let fuser = system.ps().into_iter().find(|one| one["service"] == "fuser").unwrap();
    assert_eq!(fuser["stage"], "vqf");
    page.until("plumb.data.events.some((event) => event.kind === 'EVENT_KIND_SWAPPED')");
    page.until("plumb.drawn().services.some(([service, , stage]) => service === 'fuser' && stage === 'vqf')");
    page.shot("system-swapped.png");
    page.assert_clean();

    // Opens a second page without the token.
    let mut without_token = Page::open(&format!("http://127.0.0.1:{port}/")).unwrap();
    without_token.until("plumb.state().kind === 'live'");
    without_token.key("4");
    without_token.until("document.getElementById('slot').value === 'fuser'");
    without_token.eval("document.getElementById('stage').value = 'wz'");
    without_token.click("#swap");
    without_token.click("#yes");
    let outcome = without_token.text("document.getElementById('outcome').textContent");
    assert!(outcome.starts_with("commands require a token"), "{outcome}");
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn shadow_is_drawn_at_its_reported_difference() {
    let (system, port) = with_cockpit_for_browser(LENIENT_RESTART);
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live' && plumb.drawn()?.quaternion");
    assert_eq!(page.eval("plumb.drawn().shadow"), Value::Null);
    page.key("4");
    page.until("document.getElementById('slot').value === 'fuser' && !document.getElementById('shadow').disabled");
    assert_eq!(page.eval("document.getElementById('cancel').disabled"), true, "there is no shadow");
    page.eval("document.getElementById('stage').value = 'vqf'");
    page.click("#shadow");
    page.click("#yes");
    page.until("plumb.data.shown().snapshot.differences.length");
    page.key("1");
    page.until("plumb.drawn()?.shadow");
    let drawn = page.eval("plumb.drawn()");
    let numbers = |name: &str| serde_json::from_value::<[f64; 4]>(drawn[name].clone()).unwrap();
    let along: f64 = numbers("quaternion").into_iter().zip(numbers("shadow")).map(|(own, shadow)| own * shadow).sum();
    let (drawn_deg, reported_deg) =
        (2.0 * along.abs().min(1.0).acos().to_degrees(), drawn["shadow_difference_deg"].as_f64().unwrap());
    assert!(reported_deg > 0.0 && (drawn_deg - reported_deg).abs() < 1e-5, "{drawn_deg}° of {reported_deg}°");
    let label = page.text("[...document.querySelectorAll('.legend .c-shadow')].find((one) => !one.hidden).textContent");
    assert!(label.starts_with("shadow of fuser, difference ") && label.ends_with('°'), "{label}");
    page.shot("fly-shadow.png");
    page.key("4");
    page.until("!document.getElementById('promote').disabled");
    page.shot("system-shadow.png");
    page.click("#promote");
    page.click("#yes");
    page.until("plumb.data.events.some((event) => event.kind === 'EVENT_KIND_SWAPPED' && event.service === 'fuser' && event.stage === 'vqf')");
    page.key("1");
    page.until("plumb.drawn() && !plumb.drawn().shadow && plumb.state().kind === 'live'");
    // First waits until the page has received the new owner, then starts another shadow and cancels
    // it.
    page.key("4");
    page.until("plumb.drawn()?.services?.some(([service, state, stage]) => service === 'fuser' && state !== 'candidate' && stage === 'vqf')");
    page.eval("document.getElementById('stage').value = 'wz'");
    page.click("#shadow");
    page.click("#yes");
    page.until("!document.getElementById('promote').disabled");
    page.click("#cancel");
    page.click("#yes");
    page.until("document.getElementById('cancel').disabled");
    page.key("1");
    page.until("plumb.drawn() && !plumb.drawn().shadow && plumb.state().kind === 'live'");
    let fuser = system.ps().into_iter().find(|one| one["service"] == "fuser").unwrap();
    assert_eq!(fuser["stage"], "vqf");
    // A cancelled shadow does not count as a fault.
    assert_eq!(
        page.text("JSON.stringify(plumb.data.events.filter((event) => event.fault && event.service === 'fuser'))"),
        "[]"
    );
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn restarts_and_outages_are_shown_and_page_reconnects() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live'");
    page.key("4");
    page.until("plumb.drawn()?.services?.length > 5");
    signal(running.service("gyro"), Signal::KILL);
    page.until("document.querySelector('[data-service=gyro]')?.classList.contains('down')");
    page.shot("system-killed.png");
    page.until("plumb.data.events.some((event) => event.fault && event.service === 'gyro')");
    page.until("document.querySelector('[data-service=gyro]') && !document.querySelector('[data-service=gyro]').classList.contains('down')");
    page.until("plumb.drawn().services.some(([service, , , restarts]) => service === 'gyro' && restarts === 1)");

    // Without a new attitude, the page turns stale after 200 to 500 ms.
    page.until("plumb.data.state(plumb.data.received_ms + 200).kind === 'live'");
    assert_eq!(page.eval("plumb.data.state(plumb.data.received_ms + 500).kind"), "stale");
    // Outdated content is grey, and the state shows its age. The supervisor is frozen as well,
    // because it would otherwise restart the frozen source.
    let ingest = running.service("ingest");
    [running.pid(), ingest].iter().for_each(|pid| signal(*pid, Signal::STOP));
    page.until("/^stale \\d/.test(document.getElementById('state').textContent) && document.getElementById('view').classList.contains('stale')");
    for (key, view) in [("1", "fly"), ("4", "system")] {
        page.key(key);
        page.until("plumb.drawn()");
        page.wait_for_redraw();
        page.assert_readable(&format!("{view}, stale"));
    }
    [ingest, running.pid()].iter().for_each(|pid| signal(*pid, Signal::CONT));
    page.until("plumb.state().kind === 'live' && !document.getElementById('view').classList.contains('stale')");

    running.interrupt();
    let run = running.wait();
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    page.until("plumb.state().kind === 'connecting' && !document.getElementById('reason').hidden");
    assert!(page.text("document.getElementById('reason').textContent").contains("plumb up"));
    let second_run = start_all(&system, &[]);
    page.until("plumb.state().kind === 'live'");
    second_run.interrupt();
    second_run.wait().assert_complete();
    // The browser itself logs the failed connection attempts.
    let others: Vec<_> = page.errors().into_iter().filter(|error| !error.contains("ERR_CONNECTION")).collect();
    assert_eq!(others, Vec::<String>::new());
}

#[test]
fn all_views_share_time_line_and_cursor() {
    let fault = "[[ingest.fault]]\nsensor = \"accel\"\nkind = \"stuck\"\nfrom_s = 4\nuntil_s = 6\n";
    let system = System::new(&format!("faults = true\n{fault}"));
    // The page is opened before the system starts, so that it misses no event.
    let view = View::of_system(&system, &format!("127.0.0.1:{}", free_port()));
    let Some(mut page) = Page::open(&view.address) else { return };
    let running = start_all(&system, &[]);
    // A flag event lasts from the first to the last snapshot with the flag, even if snapshots in
    // between are missing.
    page.until("plumb.data.events.some(({ label, until }) => label === 'fault-injected' && until > 5.5)");
    page.until("plumb.data.events.some(({ label }) => label === 'force-stuck')");
    let code = "(events => [Math.min(...events.map(({ t }) => t)), Math.max(...events.map(({ until }) => until))])(plumb.data.events.filter(({ label }) => label === 'fault-injected'))";
    let [from_s, until_s]: [f64; 2] = serde_json::from_value(page.eval(code)).unwrap();
    assert!((3.9..5.0).contains(&from_s) && (5.5..7.0).contains(&until_s), "{from_s} s to {until_s} s");
    signal(running.service("accel"), Signal::KILL);
    page.until(
        "['accel ended', 'accel restarted'].every((label) => plumb.timeline().some((event) => event.label === label))",
    );
    page.eval("plumb.ended_s = plumb.timeline().find((event) => event.label === 'accel ended').t");
    page.key(" ");
    for view in ["1", "2", "3", "4"] {
        page.key(view);
        page.until("plumb.timeline().some((event) => event.label === 'accel ended' && event.t === plumb.ended_s)");
    }
    // Moves the cursor to the event with the keyboard. The strips, the scene and the description
    // must show that time.
    let mut steps = 0;
    while page.eval("plumb.data.cursor === plumb.ended_s") != true {
        steps += 1;
        assert!(steps < 50, "{}", page.eval("JSON.stringify(plumb.timeline())"));
        page.key("[");
    }
    page.until("document.querySelector('#timeline output').textContent.includes('accel ended')");
    page.key("1");
    page.until("plumb.drawn()?.quaternion && document.getElementById('time').textContent === `${plumb.data.shown().t.toFixed(2)} s`");
    let off_s = page.number("Math.abs(plumb.data.shown().t - plumb.data.cursor)");
    assert!(off_s < 0.2, "{off_s} s");
    page.shot("fly-event.png");
    page.assert_clean();
    view.stop();
    running.interrupt();
    running.wait();
}

#[test]
fn values_and_quaternion_at_cursor_are_copied() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    // The services start one after the other, so the first snapshots have no attitude.
    page.until(
        "plumb.state().kind === 'live' && plumb.data.frames.length > 100 && plumb.data.shown()?.snapshot.attitude",
    );
    page.key(" ");
    page.until("document.getElementById('state').textContent === 'paused'");
    let ours: [f64; 4] = serde_json::from_value(page.eval("plumb.drawn().quaternion")).unwrap();
    for (name, frame) in Frame::NAMES {
        page.eval(&format!("document.getElementById('frame').value = '{name}'"));
        page.click("#copy-quaternion");
        page.until(&format!(
            "document.getElementById('timeline').textContent.includes('copied: w, x, y, z in {name}')"
        ));
        let copied: Vec<f64> = page.clipboard().split(", ").map(|part| part.parse().unwrap()).collect();
        let expected = frame.quaternion(ours);
        assert!(
            copied.iter().zip(expected).all(|(copied, expected)| (copied - expected).abs() < 1e-15),
            "{name}: {copied:?} of {expected:?}"
        );
    }
    page.key("c");
    page.until("document.getElementById('timeline').textContent.includes(' values')");
    let copied = page.clipboard();
    let (names, values) = copied.trim().split_once('\n').unwrap();
    let column = |wanted: &str| {
        let place =
            names.split(',').position(|name| name == wanted).unwrap_or_else(|| panic!("no {wanted} in {names}"));
        values.split(',').nth(place).unwrap().parse::<f64>().unwrap()
    };
    assert_eq!(["qw", "qx", "qy", "qz"].map(column), ours);
    assert_eq!(column("pitch_rad"), page.number("plumb.data.shown().snapshot.attitude.pitch_rad"));
    assert!(column("force_m_s2_min") <= column("force_m_s2_max"));
    assert_eq!(column("t_s"), page.number("plumb.data.shown().t"));
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn open_page_does_not_grow() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    // Measures the growth of the heap between 100 and 400 snapshots. The first 300 snapshots are a
    // warm-up and are discarded.
    page.until("plumb.data.frames.length > 300");
    page.eval("plumb.data.frames.splice(0, plumb.data.frames.length)");
    page.until("plumb.data.frames.length > 100");
    let first = page.heap();
    page.until("plumb.data.frames.length > 400");
    let (second, frames) = (page.heap(), page.number("plumb.data.frames.length"));
    let each = (second - first) / (frames - 100.0);
    println!("{first} → {second} bytes, {each:.0} per snapshot");
    assert!(each < 60_000.0, "{each} bytes for each of up to 3000 snapshots");
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn cursor_pauses_and_unknown_vehicle_is_reported() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live' && plumb.data.frames.length > 100 && plumb.drawn()?.quaternion");
    page.eval("plumb.data.zoom(0.04)");
    page.click(".panel.wide canvas");
    page.until("document.getElementById('state').textContent === 'paused' && plumb.data.cursor !== null");
    page.key("l");
    page.until("document.getElementById('state').textContent === 'live' && plumb.data.cursor === null");
    // The last output of a stopped service must not be shown as current. Everything is done in a
    // single call, because further snapshots could otherwise arrive in between.
    let hidden = page.eval(
        "(() => {
            const { data } = plumb, { snapshot, number } = data.frames.at(-1), gyro = data.newest.gyro;
            data.newest.gyro = { ...gyro, header: { ...gyro.header, t_end_ns: 1 } };
            data.push({ ...snapshot, gyro: null, number: number + 1, flags: 0, events: [], extremes: [] }, performance.now());
            return data.frames.at(-1).snapshot.gyro === undefined;
        })()",
    );
    assert_eq!(hidden, Value::Bool(true));
    page.assert_clean();
    page.goto(&format!("http://127.0.0.1:{port}/?vehicle=no%23body"), (1280, 720), "dark", true);
    page.until("document.getElementById('state').textContent === 'no such vehicle' && document.getElementById('reason').textContent.includes('body\" is not available')");
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn page_starts_with_the_last_minute() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut first) = Page::open(&address(&system, port)) else { return };
    first.until("plumb.data.frames.length > 100");
    let newest_s = first.number("plumb.data.frames.at(-1).t");
    // A page that is opened later also receives earlier frames.
    let mut second = Page::open(&address(&system, port)).unwrap();
    second.until("plumb.state().kind === 'live' && plumb.data.frames.length > 100");
    let oldest_s = second.number("plumb.data.frames[0].t");
    assert!(oldest_s < newest_s - 2.0, "the page starts at {oldest_s} s, the other one was at {newest_s} s");
    first.assert_clean();
    second.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn strips_have_ticks_limits_and_switchable_lines() {
    let (system, port) = with_cockpit_for_browser("[ingest.sim]\nscenario = \"tumble\"\n");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live' && plumb.data.frames.length > 200");
    page.until("plumb.strips()?.[0]?.least === -180 && plumb.strips()[0].most === 180");
    // The body tumbles, so yaw and roll pass ±180°. The values before and after the wrap are not
    // connected.
    page.until("plumb.strips()[0].largest_step > 1");
    assert!(page.number("plumb.strips()[0].largest_step") <= 180.0);
    assert!(page.number("plumb.strips()[2].least") >= 0.0, "a negative error");
    assert_eq!(page.eval("plumb.strips().every(({ ticks }) => ticks.length >= 2)"), Value::Bool(true));
    page.click(".strip-legends button");
    page.until("plumb.strips()[0].lines.join() === 'pitch,roll'");
    assert_eq!(page.eval("document.querySelector('.strip-legends button').ariaPressed"), "false");
    // The line stays hidden in a view that is opened again.
    page.key("2");
    page.key("1");
    page.until("plumb.view() === 'fly' && plumb.strips()?.[0]?.lines.join() === 'pitch,roll'");
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn views_have_addresses_and_fit_small_screens() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::new() else { return };
    let url = address(&system, port);
    let (_, token) = url.split_once('#').unwrap();
    page.goto(&format!("{url}/system"), (1280, 800), "light", true);
    page.until("plumb.view() === 'system' && plumb.drawn()?.services?.length > 5");
    let names = page.eval("[...document.querySelectorAll('.services tbody tr')].map((row) => row.dataset.service)");
    assert_eq!(names.as_array().unwrap()[..5], ["ingest", "gyro", "accel", "fuser", "course"]);
    page.until("!document.getElementById('shadow').disabled");
    page.eval("document.getElementById('stage').value = 'vqf'");
    page.click("#shadow");
    page.click("#yes");
    page.until("plumb.data.shown().snapshot.differences.length");
    let bottom = page.number("document.getElementById('cancel').getBoundingClientRect().bottom");
    let top = page.number("document.getElementById('timeline').getBoundingClientRect().top");
    assert!(bottom < top, "the swap controls end at {bottom} px, below the view, which ends at {top} px");
    assert_eq!(page.eval("document.getElementById('tab-fleet').checkVisibility()"), Value::Bool(false));
    page.key("5");
    page.key("2");
    page.until(&format!("plumb.view() === 'method' && location.hash === '#{token}/method'"));
    for size in [(1280, 800), (390, 844)] {
        for view in ["fly", "method", "sensors", "system"] {
            page.goto(&format!("http://127.0.0.1:{port}/?{}#{token}/{view}", size.0), size, "dark", true);
            page.until(&format!("plumb.view() === '{view}' && plumb.state().kind === 'live' && plumb.drawn()"));
            page.assert_laid_out(&format!("{view} at {size:?}"));
            page.shot(&format!("{view}-{}.png", size.0));
            let width = page.number("document.documentElement.scrollWidth");
            assert!(width <= f64::from(size.0), "{view}: {width} px at {size:?}");
            let hidden_px =
                page.number("(view => view.scrollWidth - view.clientWidth)(document.getElementById('view'))");
            assert!(hidden_px <= 0.0, "{view}: {hidden_px} px are cut off at {size:?}");
            if view == "sensors" {
                let rows = page.eval("[...document.querySelectorAll('.samples tbody tr')].map((row) => row.hidden)");
                assert_eq!(rows, serde_json::json!([false, false, true, true]), "no magnetometer, no receiver");
            }
            let strip_px = page.number(
                "document.querySelector('.strips > canvas').clientHeight / document.querySelectorAll('.strip-legends > div:not([hidden])').length",
            );
            assert!(strip_px >= 90.0, "{view}: strips of {strip_px} px at {size:?}");
        }
    }
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn page_recovers_from_files_that_do_not_arrive() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let lost = ["calibration.js", "style.css", "schema.json"];
    let Some(mut page) = Page::open_with_lost_files(&address(&system, port), &lost) else { return };
    page.until("globalThis.plumb?.state().kind === 'live' && plumb.drawn()?.quaternion");
    assert_eq!(page.text("getComputedStyle(document.body).display"), "flex", "the page has no style");
    let errors = page.errors();
    assert!(errors.iter().all(|error| error.contains("ERR_CONNECTION_RESET")), "{errors:?}");
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn body_and_signals_are_selected_and_remembered() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live' && plumb.drawn()?.quaternion && plumb.strips().length === 3");
    let select_boat =
        "(body => { body.value = 'boat'; body.dispatchEvent(new Event('change')); })(document.getElementById('body'))";
    page.eval(select_boat);
    page.click("#signals");
    page.click("[name='fly/rate']");
    page.click("[name='fly/angles/pitch']");
    let selected = "plumb.drawn()?.body === 'boat' && JSON.stringify(plumb.strips()?.map(({ lines }) => lines)) === '[[\"yaw\",\"roll\"],[\"error\",\"inclination sd\",\"shadow\"]]'";
    page.until(selected);
    // The other strips share the space of the hidden strip.
    page.until("document.querySelectorAll('.strip-legends > div:not([hidden])').length === 2");
    // A body that rolls to the right sees the zenith on its left.
    let bank = page.eval("(({ bank, roll_deg }) => [bank.marks_deg, bank.pointer_deg + roll_deg])(plumb.drawn())");
    assert_eq!(bank[0], serde_json::json!([10, 20, 30, 45, 60]));
    assert!(bank[1].as_f64().unwrap().abs() < 1e-9, "{bank}");

    page.click("#copy-picture");
    page.until("document.getElementById('timeline').textContent.includes('copied: picture')");
    let read = "(async () => {
        const [item] = await navigator.clipboard.read(), picture = await createImageBitmap(await item.getType('image/png'));
        return [picture.width, document.querySelector('.strips > canvas').width];
    })()";
    let widths = page.eval(read);
    assert_eq!(widths[0], widths[1], "{widths}");
    page.eval("delete globalThis.ClipboardItem");
    page.click("#copy-picture");
    page.until("/saved: .*-fly\\.png/.test(document.getElementById('timeline').textContent)");

    page.reload();
    page.until(&format!("globalThis.plumb?.state().kind === 'live' && {selected}"));
    // Without storage, the page has its defaults and still works.
    page.reload_without_storage();
    page.until("globalThis.plumb?.state().kind === 'live' && plumb.drawn()?.body === 'aeroplane' && plumb.strips()?.length === 3");
    page.eval(select_boat);
    page.until("plumb.drawn().body === 'boat'");
    page.click(".strip-legends button");
    page.until("plumb.strips()[0].lines.join() === 'pitch,roll'");

    // Thick lines in one frame must not make the grid of the next frame thick.
    page.key("2");
    page.eval(
        "(() => {
            const own = CanvasRenderingContext2D.prototype.stroke;
            plumb.thickest = 0;
            CanvasRenderingContext2D.prototype.stroke = function (...path) {
                if (this.canvas.ariaLabel === 'Plane of w' && this.globalAlpha < 1) plumb.thickest = Math.max(plumb.thickest, this.lineWidth);
                own.call(this, ...path);
            };
        })()",
    );
    page.until("plumb.view() === 'method' && plumb.thickest > 0");
    page.wait_for_redraw();
    assert_eq!(page.number("plumb.thickest"), 1.0);
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn paused_view_is_kept_and_page_does_not_grow() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.data.frames.length > 100");
    page.key(" ");
    page.until("document.getElementById('state').textContent === 'paused'");
    // Pushes ten minutes of snapshots in one call, so that no other snapshots arrive in between.
    let result = page.eval(
        "(() => {
            const { data } = plumb, { number, snapshot } = data.frames.at(-1);
            const tick = () => data.shown().snapshot.attitude.header.tick;
            const [cursor, before] = [data.cursor, tick()];
            for (let i = 1; i <= 18000; i++) {
                const header = { ...snapshot.attitude.header, t_end_ns: snapshot.attitude.header.t_end_ns + i * 33e6 };
                data.push({ ...snapshot, number: number + i, attitude: { ...snapshot.attitude, header }, flags: 0, events: [], extremes: [] }, performance.now());
            }
            const stays = data.cursor === cursor && tick() === before;
            data.step(-1, 0);
            const one_back = data.cursor < cursor;
            // A snapshot may lack an attitude.
            for (let i = 1; i < 30; i++) data.step(-1, 0);
            return { stays, goes_back: one_back && tick() < before, kept: data.frames.length };
        })()",
    );
    assert_eq!((&result["stays"], &result["goes_back"]), (&Value::Bool(true), &Value::Bool(true)), "{result}");
    assert!((3000..=6000).contains(&result["kept"].as_u64().unwrap()), "{result}");
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn plumb_view_shows_system_without_cockpit() {
    let system = System::new("");
    let running = start_all(&system, &[]);
    let listen = format!("127.0.0.1:{}", free_port());
    let view = View::of_system(&system, &listen);
    assert!(view.address.starts_with(&format!("http://{listen}/#")), "{}", view.address);
    if let Some(mut page) = Page::open(&view.address) {
        page.until("plumb.state().kind === 'live' && plumb.drawn()?.quaternion");
        page.assert_clean();
    }
    view.stop();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn page_mathematics_matches_conventions() {
    if PACKAGES.is_none() {
        return;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cockpit/conventions.mjs");
    let output = run(Command::new("node").arg(script).args([PAGE, "docs/reference/conventions.json"])).unwrap();
    println!("{output}");
    let largest: Value = serde_json::from_str(&output).unwrap();
    assert_eq!(largest["cases"], 14);
    assert_eq!(largest["names"], serde_json::json!(Frame::NAMES.map(|(name, _)| name)));
    for name in ["angles", "up", "attitude", "point", "frames"] {
        assert!(largest[name].as_f64().unwrap() < 1e-14, "{name}: {largest}");
    }
}

#[test]
fn page_scripts_pass_type_check() {
    let Some(folder) = &*PACKAGES else { return };
    let tsc = folder.join("node_modules/typescript/bin/tsc");
    let options = ["--noEmit", "--allowJs", "--checkJs", "--strict", "--target", "es2022", "--module", "es2022"];
    let libraries = ["--moduleResolution", "bundler", "--lib", "es2022,dom,dom.iterable"];
    let main = format!("{PAGE}/main.js");
    run(Command::new("node").arg(tsc).args(options).args(libraries).arg(main)).unwrap();
}
