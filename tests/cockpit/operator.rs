//! Commands of an operator on the page, and their rejection for viewers.
use std::{
    fs,
    io::Write as _,
    path::{Path, PathBuf},
    process::Stdio,
};

use rustix::process::Signal;

use super::{
    browser::Page,
    page::{LENIENT_RESTART, address, start_all, with_cockpit_for_browser},
};
use crate::common::{System, plumb, signal};

/// Returns the address of the page. It contains the token of a viewer.
pub(crate) fn viewer_address(system: &System, port: u16) -> String {
    let file = system.path("plumbline").join(&system.name).join("cockpit.viewer.token");
    format!("http://127.0.0.1:{port}/#{}", fs::read_to_string(file).unwrap().trim())
}

/// Opens the System view and waits until it shows the parameters of the fuser's stage.
fn open_system_view(url: &str) -> Option<Page> {
    let mut page = Page::open(&format!("{url}/system"))?;
    page.until("plumb.state().kind === 'live' && document.querySelectorAll('.parameters tbody tr').length > 20");
    Some(page)
}

/// Types a new value of a parameter, requests the change and returns the outcome.
fn set(page: &mut Page, name: &str, value: &str) -> String {
    page.eval(&format!("document.getElementById('parameter-{name}').value = '{value}'"));
    page.click("#swap");
    page.click("#yes");
    page.until("/^(committed|aborted|refused)/.test(document.getElementById('outcome').textContent)");
    page.text("document.getElementById('outcome').textContent")
}

#[test]
fn parameters_are_shown_and_set_by_operator_only() {
    let (system, port) = with_cockpit_for_browser(LENIENT_RESTART);
    let running = start_all(&system, &[]);
    let Some(mut page) = open_system_view(&address(&system, port)) else { return };
    let name = "gyro_noise_deg_sqrt_s";
    let row = format!("document.getElementById('parameter-{name}').closest('tr').innerText");
    let shown = page.text(&row);
    for part in [name, "White noise of the gyro", "°/√s", "0.01", "0.0001 to 10"] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
    assert_eq!(page.eval("document.getElementById('swap').disabled"), true, "nothing is changed yet");

    let outcome = set(&mut page, name, "0.05");
    assert!(outcome.starts_with("committed: fuser: multiple-model → multiple-model from tick"), "{outcome}");
    assert!(outcome.contains("lost 0, duplicated 0"), "{outcome}");
    let changed = "plumb.data.systemStatus.slots.find(({ slot }) => slot === 'fuser').set";
    page.until(&format!("{changed}.some(({{ name, value }}) => name === '{name}' && value === 0.05)"));
    page.until(&format!(
        "document.getElementById('swap').disabled && document.getElementById('parameter-{name}').value === '0.05'"
    ));
    page.shot("system-parameters.png");

    // The message comes from the check of the stage itself. The value is unchanged.
    let outcome = set(&mut page, name, "99");
    assert!(outcome.contains("gyro_noise_deg_sqrt_s: expected 0.0001 to 10 °/√s, found 99"), "{outcome}");
    page.eval(&format!("document.getElementById('parameter-{name}').value = 'much'"));
    page.click("#swap");
    page.until(&format!("document.getElementById('outcome').textContent === '{name}: expected a number, found much'"));
    page.until(&format!("{changed}.every(({{ value }}) => value === 0.05)"));
    page.assert_clean();

    let mut viewer = open_system_view(&viewer_address(&system, port)).unwrap();
    assert_eq!(viewer.text(&format!("document.getElementById('parameter-{name}').value")), "0.05");
    let outcome = set(&mut viewer, name, "0.02");
    assert!(outcome.contains("a viewer's token cannot send commands"), "{outcome}");
    viewer.until(&format!("{changed}.every(({{ value }}) => value === 0.05)"));
    running.interrupt();
    running.wait().assert_complete();
}

/// Returns the files in a folder, sorted by name.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn recording_is_started_and_stopped_by_operator_only() {
    let (system, port) = with_cockpit_for_browser(LENIENT_RESTART);
    let folder = system.path("flights");
    system.append_launch(&format!("\ncockpit.recordings = {folder:?}\ncockpit.recording_max_mib = 4\n"));
    let running = start_all(&system, &[]);
    let url = address(&system, port);
    let Some(mut viewer) = Page::open(&viewer_address(&system, port)) else { return };
    let text = "document.getElementById('recording').textContent";
    viewer.until("plumb.state().kind === 'live' && !document.getElementById('record').hidden");
    viewer.click("#record");
    viewer.until(&format!("{text}.includes(\"a viewer's token cannot send commands\")"));
    assert!(!folder.exists(), "nothing is recorded");

    // A recording ends at its size limit.
    let mut page = Page::open(&url).unwrap();
    page.until("plumb.state().kind === 'live' && !document.getElementById('record').hidden");
    page.click("#record");
    page.until(&format!("{text}.startsWith('recording ')"));
    page.shot("fly-recording.png");
    viewer.until(&format!("{text}.startsWith('recording ')"));
    page.until(&format!("{text}.endsWith(': the size limit was reached')"));
    // Makes two further recordings, each in a new file. The operator stops the first recording, and
    // the end of the system stops the second one.
    for stop in ["#record", ""] {
        page.until("document.getElementById('record').textContent === 'Record'");
        page.click("#record");
        page.until(&format!("{text}.startsWith('recording ')"));
        if !stop.is_empty() {
            page.click(stop);
            page.until(&format!("/: (stopped by an operator|the size limit was reached)$/.test({text})"));
        }
    }
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
    let recorded = files(&folder);
    assert_eq!(recorded.len(), 3, "{recorded:?}");
    for file in &recorded {
        let name = file.file_name().unwrap().to_string_lossy();
        assert!(name.starts_with(&format!("{}-", system.name)) && name.ends_with(".mcap"), "{name}");
        let info = plumb(&["info", file.to_str().unwrap()]).output().unwrap();
        let info = String::from_utf8_lossy(&info.stdout).into_owned();
        assert!(info.contains("attitude"), "{name}: {info}");
    }
}

#[test]
fn recording_without_folder_is_refused_with_remedy() {
    let (system, port) = with_cockpit_for_browser("");
    let running = start_all(&system, &[]);
    let Some(mut page) = Page::open(&address(&system, port)) else { return };
    page.until("plumb.state().kind === 'live' && !document.getElementById('record').hidden");
    page.click("#record");
    page.until(
        "document.getElementById('recording').textContent.includes('set `recordings` in the section [cockpit]')",
    );
    page.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn log_is_shown_to_operator_without_token() {
    let (system, port) = with_cockpit_for_browser(LENIENT_RESTART);
    let log = system.path("log");
    let mut command = system.command(&[]);
    let mut file = fs::File::options().create(true).append(true).open(&log).unwrap();
    command.stderr(file.try_clone().unwrap());
    let mut running = command.stdin(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
    system.wait_until_running();
    let url = address(&system, port);
    let (_, token) = url.split_once('#').unwrap();
    // Foreign text is shown as plain text and is not interpreted as HTML.
    writeln!(file, "address {url} <b>bold</b> \u{1b}[31mred").unwrap();
    if let Some(mut viewer) = Page::open(&format!("{}/system", viewer_address(&system, port))) {
        let shown = "document.querySelector('.log').textContent";
        viewer.until("plumb.state().kind === 'live'");
        viewer.click("#show-log");
        viewer.until("document.getElementById('log-error').textContent.includes('cannot send commands')");
        assert_eq!(viewer.text(shown), "");
        let mut page = Page::open(&format!("{url}/system")).unwrap();
        page.until("plumb.state().kind === 'live'");
        page.click("#show-log");
        page.until(&format!("{shown}.includes('<b>bold</b>')"));
        let lines = page.text(shown);
        assert!(lines.contains(r"#(token) <b>bold</b> \u{1b}[31mred"), "{lines}");
        assert!(!lines.contains(token), "{lines}");
        page.shot("system-log.png");
        page.assert_clean();
    }
    signal(running.id(), Signal::INT);
    assert!(running.wait().unwrap().success());
}
