//! Page over TLS: access with no token, as a viewer and as an operator.
use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use super::{browser::Page, page::with_cockpit_for_browser};
use crate::common::{System, plumb, remote::free_port, signal, site::Site, wait_for};
use rustix::process::Signal;

/// Sends a request with Python's standard library, which trusts only the site's authority. Returns
/// the HTTP status or the error.
fn status(site: &Site, url: &str, token: &str) -> String {
    let script = r#"
import http.client, ssl, sys, urllib.error, urllib.request
ca, url, token = sys.argv[1:]
context = ssl.create_default_context(cafile=ca)
request = urllib.request.Request(url, headers={"Authorization": f"Bearer {token}"} if token else {})
try:
    print(urllib.request.urlopen(request, timeout=20, context=context).status)
except urllib.error.HTTPError as error:
    print(error.code)
except (OSError, http.client.HTTPException) as error:
    print(error)
"#;
    let ca = site.holder_folder("vehicle.alpha").join("ca.pem");
    let output = Command::new("python3").args(["-c", script]).arg(ca).args([url, token]).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

fn with_tls_cockpit() -> (Site, System, u16) {
    let site = Site::new(&[&["vehicle", "alpha", "--host", "127.0.0.1"]]);
    let folder = site.holder_folder("vehicle.alpha");
    let [cert, key] = ["cert.pem", "key.pem"].map(|file| folder.join(file));
    let (system, port) = with_cockpit_for_browser(&format!("cockpit.tls = {{ cert = {cert:?}, key = {key:?} }}\n"));
    (site, system, port)
}

fn token(system: &System, file: &str) -> String {
    let path = system.path("plumbline").join(&system.name).join(file);
    wait_for("the token", || path.is_file());
    fs::read_to_string(path).unwrap().trim().to_owned()
}

#[test]
fn tls_requires_token_and_viewer_cannot_command() {
    let (site, system, port) = with_tls_cockpit();
    let running = system.start(&[]);
    system.wait_until_running();
    let (operator, viewer) = (token(&system, "cockpit.token"), token(&system, "cockpit.viewer.token"));
    assert_ne!(operator, viewer);
    let page_url = |rest: &str| format!("https://127.0.0.1:{port}/{rest}");
    wait_for("the page", || status(&site, &page_url(""), "") == "200");
    for (token, expected) in [("", "401"), ("wrong", "401"), (&viewer, "200"), (&operator, "200")] {
        assert_eq!(status(&site, &page_url("metrics"), token), expected, "{token}");
    }
    // A client that does not trust the authority, or does not use TLS, is rejected.
    let other = Site::new(&[&["vehicle", "alpha", "--host", "127.0.0.1"]]);
    assert!(status(&other, &page_url(""), &viewer).contains("CERTIFICATE_VERIFY_FAILED"));
    assert!(!status(&site, &format!("http://127.0.0.1:{port}/"), &viewer).contains("200"));

    let Some(mut without_token) = Page::open(&page_url("")) else { return };
    without_token.until("document.getElementById('state').textContent === 'no token'");
    assert_eq!(without_token.eval("plumb.data.frames.length"), 0);
    let mut viewing = Page::open(&page_url(&format!("#{viewer}"))).unwrap();
    viewing.until("plumb.state().kind === 'live' && plumb.drawn()?.quaternion");
    viewing.key("4");
    viewing.until("document.getElementById('slot').value === 'fuser'");
    swap(&mut viewing);
    let outcome = viewing.text("document.getElementById('outcome').textContent");
    assert!(outcome.contains("a viewer's token cannot send commands"), "{outcome}");
    let mut operating = Page::open(&page_url(&format!("#{operator}"))).unwrap();
    operating.until("plumb.state().kind === 'live'");
    operating.key("4");
    operating.until("document.getElementById('slot').value === 'fuser'");
    swap(&mut operating);
    let outcome = operating.text("document.getElementById('outcome').textContent");
    assert!(outcome.starts_with("committed: fuser: multiple-model → vqf from tick"), "{outcome}");
    viewing.assert_clean();
    operating.assert_clean();
    running.interrupt();
    running.wait().assert_complete();
}

fn swap(page: &mut Page) {
    page.eval("document.getElementById('stage').value = 'vqf'");
    page.click("#swap");
    page.click("#yes");
    page.until("/^(committed|aborted|refused)/.test(document.getElementById('outcome').textContent)");
}

#[test]
fn non_loopback_address_requires_valid_certificate() {
    let site = Site::new(&[&["vehicle", "alpha", "--host", "127.0.0.1"], &["vehicle", "beta"]]);
    let view = |more: &[&str]| -> Output {
        let listen = format!("0.0.0.0:{}", free_port());
        let state = site.holder_folder("state");
        let mut command = plumb(&["view", "--for", "1", "--listen", &listen]);
        command.args(more).env("XDG_STATE_HOME", state).env_remove("STATE_DIRECTORY").output().unwrap()
    };
    let stderr = |output: &Output| String::from_utf8_lossy(&output.stderr).into_owned();
    let open = view(&[]);
    assert_eq!(open.status.code(), Some(2), "{open:?}");
    assert!(stderr(&open).contains("without --tls") && stderr(&open).contains("ssh -L"), "{}", stderr(&open));
    let folder = |party: &str| site.holder_folder(party).to_str().unwrap().to_owned();
    let served = view(&["--tls", &folder("vehicle.alpha")]);
    assert!(served.status.success(), "{}", stderr(&served));
    let printed = String::from_utf8(served.stdout).unwrap();
    assert!(printed.starts_with("https://") && !printed.contains("0.0.0.0"), "{printed}");
    let viewer = view(&["--tls", &folder("vehicle.alpha"), "--viewer"]);
    assert_ne!(token_of(&printed), token_of(&String::from_utf8(viewer.stdout).unwrap()));

    let nothing = view(&["--tls", &folder("nowhere")]);
    assert!(stderr(&nothing).contains("nowhere/cert.pem"), "{}", stderr(&nothing));
    // A key that belongs to another certificate is rejected, and so is a key that other users can
    // read.
    let mixed = site.holder_folder("mixed");
    fs::create_dir(&mixed).unwrap();
    copy(&site.holder_folder("vehicle.alpha").join("cert.pem"), &mixed.join("cert.pem"));
    copy(&site.holder_folder("vehicle.beta").join("key.pem"), &mixed.join("key.pem"));
    let mismatched = view(&["--tls", mixed.to_str().unwrap()]);
    assert!(stderr(&mismatched).contains("plumb keys vehicle"), "{}", stderr(&mismatched));
    use std::os::unix::fs::PermissionsExt as _;
    fs::set_permissions(mixed.join("key.pem"), fs::Permissions::from_mode(0o644)).unwrap();
    let readable = view(&["--tls", mixed.to_str().unwrap()]);
    assert!(stderr(&readable).contains("readable by other users"), "{}", stderr(&readable));
}

fn token_of(address: &str) -> &str {
    address.trim().split_once('#').map(|(_, token)| token).unwrap_or_else(|| panic!("no token: {address}"))
}

fn copy(from: &Path, to: &Path) {
    fs::copy(from, to).unwrap();
}

#[test]
fn token_is_valid_for_one_start_of_system() {
    let (site, system, port) = with_tls_cockpit();
    let metrics = |token: &str| status(&site, &format!("https://127.0.0.1:{port}/metrics"), token);
    let running = system.start(&[]);
    system.wait_until_running();
    let [operator, viewer] = ["cockpit.token", "cockpit.viewer.token"].map(|file| token(&system, file));
    wait_for("the page", || metrics(&viewer) == "200");
    let cockpit = running.service("cockpit");
    signal(cockpit, Signal::KILL);
    wait_for("the restart", || running.services().iter().any(|(name, pid)| name == "cockpit" && *pid != cockpit));
    wait_for("the page", || metrics(&viewer) == "200");
    running.interrupt();
    running.wait().assert_complete();

    let running = system.start(&[]);
    system.wait_until_running();
    wait_for("the new token", || token(&system, "cockpit.viewer.token") != viewer);
    wait_for("the page", || metrics(&token(&system, "cockpit.viewer.token")) == "200");
    assert_eq!(metrics(&token(&system, "cockpit.token")), "200");
    assert_eq!((metrics(&viewer).as_str(), metrics(&operator).as_str()), ("401", "401"));
    running.interrupt();
    running.wait().assert_complete();
}
