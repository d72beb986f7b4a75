//! Commands of an operator on the page, and their rejection for viewers.
use std::fs;

use super::{
    browser::Page,
    page::{LENIENT_RESTART, address, start_all, with_cockpit_for_browser},
};
use crate::common::System;

/// Returns the address of the page with a viewer's token.
fn viewer_address(system: &System, port: u16) -> String {
    let file = system.path("plumbline").join(&system.name).join("cockpit.viewer.token");
    format!("http://127.0.0.1:{port}/#{}", fs::read_to_string(file).unwrap().trim())
}

/// Opens the System view and waits until it shows the parameters of the fuser's stage.
fn open_system_view(url: &str) -> Option<Page> {
    let mut page = Page::open(&format!("{url}/system"))?;
    page.until("plumb.state().kind === 'live' && document.querySelectorAll('.parameters tbody tr').length > 20");
    Some(page)
}

/// Types a value of a parameter, requests it and returns the outcome.
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
    let changed = "plumb.data.standing.slots.find(({ slot }) => slot === 'fuser').set";
    page.until(&format!("{changed}.some(({{ name, value }}) => name === '{name}' && value === 0.05)"));
    page.until(&format!(
        "document.getElementById('swap').disabled && document.getElementById('parameter-{name}').value === '0.05'"
    ));
    page.shot("system-parameters.png");

    // The message is that of the stage's own check, and the value stays.
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
