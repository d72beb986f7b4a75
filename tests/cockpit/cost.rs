//! Cost of the page for the browser and the board. The measured figures are printed;
//! docs/evidence.md quotes them.
use std::{
    fs,
    io::{Read as _, Write as _},
    net::TcpStream,
    sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst},
    thread,
    time::{Duration, Instant},
};

use super::{
    access::UPGRADE,
    browser::Page,
    page::{address, with_cockpit, with_cockpit_for_browser},
};
use crate::common::{wait_for, wait_for_within};
use rustix::net::sockopt::set_socket_recv_buffer_size;

/// Upper bound on the number of bytes that the buffers at both ends of a connection can hold.
const MAX_BUFFERED_BYTES: usize = 300_000;
const SECOND: Duration = Duration::from_secs(1);

/// Returns the duration of each measurement, s. The default is short. Set `PLUMBLINE_MEASURE_S` to
/// measure figures for docs/evidence.md.
fn measurement_s() -> u32 {
    std::env::var("PLUMBLINE_MEASURE_S").map_or(1, |text| text.parse().unwrap())
}

/// Returns the CPU time of a process, s.
fn processor_s(pid: u32) -> f64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<_> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) / 100.0
}

/// Returns the private resident memory of a process, KiB.
///
/// Shared memory has a fixed size and is excluded, because the segments of the topics become
/// resident in the cockpit only when their publishers first use them. On a busy machine this may be
/// late.
fn private_kib(pid: u32) -> f64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with("RssAnon:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// Returns the response of `/metrics`, with headers.
fn metrics_text(port: u16) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    let request = format!("GET /metrics HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    text
}

fn median(mut figures: Vec<f64>) -> f64 {
    figures.sort_by(f64::total_cmp);
    figures.get(figures.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Measures the CPU usage of a process as a percentage of one core.
fn core_percent(pid: u32) -> f64 {
    let (before_s, started) = (processor_s(pid), Instant::now());
    thread::sleep(measurement_s() * SECOND);
    100.0 * (processor_s(pid) - before_s) / started.elapsed().as_secs_f64()
}

#[test]
fn viewer_traffic_is_small() {
    let (system, port) = with_cockpit_for_browser("");
    let running = system.start(&[]);
    system.wait_until_running();
    let cockpit = running.service("cockpit");
    let without = core_percent(cockpit);
    let Some(mut page) = Page::open_at_full_rate(&address(&system, port)) else { return };
    // Before a long measurement, the history of the page must be full.
    let filled_s = if measurement_s() == 1 { 1 } else { 55 };
    page.until(&format!(
        "plumb.state().kind === 'live' && plumb.data.frames.at(-1)?.t - plumb.data.frames[0]?.t > {filled_s}"
    ));
    for (key, view) in [("2", "method"), ("3", "sensors"), ("4", "system"), ("1", "fly")] {
        page.key(key);
        page.until(&format!("plumb.view() === '{view}' && plumb.drawn()"));
        let costs_ms = (0..measurement_s()).map(|_| {
            let (script_s, frames) = (page.metric("ScriptDuration"), page.number("plumb.frames()"));
            thread::sleep(SECOND);
            1e3 * (page.metric("ScriptDuration") - script_s) / (page.number("plumb.frames()") - frames)
        });
        println!("{view}: {:.1} ms of script for a frame, median of {} s", median(costs_ms.collect()), measurement_s());
    }
    let (bytes, t_s) = (page.number("plumb.data.bytes"), page.number("plumb.data.frames.at(-1).t"));
    let with = core_percent(cockpit);
    page.until(&format!("plumb.data.frames.at(-1).t > {t_s} + 5"));
    let bytes_s = (page.number("plumb.data.bytes") - bytes) / (page.number("plumb.data.frames.at(-1).t") - t_s);
    println!("{bytes_s:.0} bytes/s; {without:.2} % of a core without a viewer, {with:.2} % with one");
    assert!(bytes_s < 100_000.0, "{bytes_s} bytes/s");
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn ten_viewers_with_one_frozen_cost_no_tick() {
    let (system, port) = with_cockpit("");
    let running = system.start(&[]);
    system.wait_until_running();
    wait_for("the page", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    let host = format!("Host: 127.0.0.1:{port}\r\n");
    let p99_us = || {
        let figure = || {
            thread::sleep(SECOND);
            let text = metrics_text(port);
            let line =
                text.lines().find(|line| line.starts_with("plumbline_attitude_latency_seconds{quantile=\"0.99\"}"));
            line.and_then(|line| line.rsplit_once(' ')?.1.parse::<f64>().ok()).map(|seconds| 1e6 * seconds)
        };
        median((0..measurement_s()).filter_map(|_| figure()).collect())
    };
    wait_for("the figures", || metrics_text(port).contains("plumbline_attitude_latency_seconds"));
    let without_us = p99_us();
    let viewers: Vec<_> = (0..10)
        .map(|_| {
            let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
            stream.write_all(format!("GET /socket HTTP/1.1\r\n{host}{UPGRADE}\r\n").as_bytes()).unwrap();
            stream
        })
        .collect();
    // The tenth viewer never reads.
    set_socket_recv_buffer_size(&viewers[9], 4096).unwrap();
    let (is_done, received) = (AtomicBool::new(false), [const { AtomicUsize::new(0) }; 9]);
    let with_us = thread::scope(|scope| {
        for (mut viewer, taken) in viewers.iter().zip(&received) {
            let over = &is_done;
            scope.spawn(move || {
                let mut bytes = vec![0; 65_536];
                while !over.load(SeqCst) {
                    taken.fetch_add(viewer.read(&mut bytes).unwrap(), SeqCst);
                }
            });
        }
        let with_us = p99_us();
        wait_for("more data than the buffers of a stalled viewer hold", || {
            received.iter().all(|bytes| bytes.load(SeqCst) > MAX_BUFFERED_BYTES)
        });
        is_done.store(true, SeqCst);
        with_us
    });
    println!(
        "end-to-end latency p99, median of {} s: {without_us:.0} µs without a viewer, {with_us:.0} µs with ten; received {received:?} bytes",
        measurement_s()
    );
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
#[ignore = "long: a session in a browser with software rendering"]
fn session_memory_does_not_grow() {
    let session_s: f64 = std::env::var("PLUMBLINE_SESSION_S").map_or(40.0, |text| text.parse().unwrap());
    let (system, port) = with_cockpit_for_browser("");
    let running = system.start(&[]);
    system.wait_until_running();
    // The memory of the cockpit grows until it has kept a minute of snapshots for new viewers.
    wait_for_within(120 * SECOND, "a full history", || {
        thread::sleep(SECOND);
        let text = metrics_text(port);
        let tick = text.lines().find_map(|line| line.strip_prefix("plumbline_attitude_tick ")?.parse::<f64>().ok());
        tick.is_some_and(|tick| tick > 65_000.0)
    });
    let Some(mut page) = Page::open_at_full_rate(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live'");
    // In a short session the page keeps a shorter history, so that the history is full when the
    // measurement starts.
    let kept_s = if session_s < 100.0 { 3.0 } else { 60.0 };
    page.eval(&format!("plumb.data.kept_s = {kept_s}"));
    let t_s = |page: &mut Page| page.number("plumb.data.frames.at(-1).t");
    let start_s = t_s(&mut page);
    let cockpit = running.service("cockpit");
    let mut measure = |at_s: f64| {
        while t_s(&mut page) < start_s + at_s {
            thread::sleep(SECOND);
        }
        // The heap may include a snapshot that is being decoded; the minimum of several
        // measurements excludes it.
        let heaps = (0..5).map(|_| {
            thread::sleep(SECOND / 5);
            page.heap() / 1024.0
        });
        let (heap, private) = (heaps.fold(f64::INFINITY, f64::min), private_kib(cockpit));
        println!("after {at_s:.0} s: {heap:.0} KiB of script in the browser, {private:.0} KiB on board");
        (heap, private)
    };
    let first = measure(kept_s + 15.0);
    measure((kept_s + 15.0 + session_s) / 2.0);
    let last = measure(session_s);
    // A page that kept every snapshot would grow by 90 KiB per second: 3 KiB for each of 30
    // snapshots.
    let sent = 90.0 * (session_s - kept_s - 15.0);
    assert!(last.0 - first.0 < (0.3 * sent).max(1200.0), "{first:?} → {last:?} KiB");
    assert!(last.1 - first.1 < 1024.0, "{first:?} → {last:?} KiB");
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}
