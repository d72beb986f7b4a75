//! Access control on the loopback interface: foreign web pages and other programs.
use std::{
    fs,
    io::{Read as _, Write as _},
    net::TcpStream,
    os::unix::fs::MetadataExt as _,
    time::Duration,
};

use super::page::{address, with_cockpit};
use crate::common::wait_for;

/// Sends a request. Returns the connection, and the status line and headers of the response in
/// lower case.
pub(crate) fn connect(port: u16, request: &str) -> (TcpStream, String) {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut text = Vec::new();
    let mut part = [0; 4096];
    while !text.windows(4).any(|four| four == b"\r\n\r\n") {
        let read = stream.read(&mut part).unwrap();
        assert!(read > 0, "{request}: {}", String::from_utf8_lossy(&text));
        text.extend_from_slice(&part[..read]);
    }
    let text = String::from_utf8_lossy(&text).to_lowercase();
    (stream, text)
}

fn response(port: u16, request: &str) -> String {
    connect(port, request).1
}

pub(crate) fn get(port: u16, path: &str, headers: &str) -> String {
    response(port, &format!("GET {path} HTTP/1.1\r\n{headers}\r\n"))
}

pub(crate) const UPGRADE: &str = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";

#[test]
fn foreign_origins_and_host_names_are_rejected() {
    let (system, port) = with_cockpit("");
    let running = system.start(&[]);
    system.wait_until_running();
    let own = address(&system, port);
    wait_for("the page", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    let host = format!("Host: 127.0.0.1:{port}\r\n");
    let page = get(port, "/", &host);
    assert!(page.starts_with("http/1.1 200"), "{page}");
    for field in
        ["content-security-policy: default-src 'none'", "x-frame-options: deny", "x-content-type-options: nosniff"]
    {
        assert!(page.contains(field), "{field}: {page}");
    }
    let token = own.split_once('#').unwrap().1;
    assert!(!page.contains(token));
    assert!(get(port, "/socket", &format!("{host}{UPGRADE}")).starts_with("http/1.1 101"));
    for evil in ["http://evil.example", "null", &format!("http://localhost:{port}")] {
        for path in ["/socket", "/metrics"] {
            let rejected = get(port, path, &format!("{host}Origin: {evil}\r\n{UPGRADE}"));
            assert!(rejected.starts_with("http/1.1 403"), "{path}, {evil}: {rejected}");
        }
    }
    // Simulates an attacker's host name that resolves to the loopback interface.
    for path in ["/", "/socket", "/schema.json", "/metrics"] {
        let rejected = get(port, path, &format!("Host: evil.example:{port}\r\n{UPGRADE}"));
        assert!(rejected.starts_with("http/1.1 421"), "{path}: {rejected}");
    }
    assert!(
        response(port, &format!("POST / HTTP/1.1\r\n{host}Content-Length: 3\r\n\r\nabc")).starts_with("http/1.1 405")
    );
    assert!(get(port, "/../../etc/passwd", &host).starts_with("http/1.1 404"));
    let token_file = fs::metadata(system.path("plumbline/cockpit.token")).unwrap();
    assert_eq!(token_file.mode() & 0o777, 0o600);
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn many_viewers_with_one_frozen_cost_no_tick() {
    let (system, port) = with_cockpit("");
    let running = system.start(&[]);
    system.wait_until_running();
    wait_for("the page", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    let host = format!("Host: 127.0.0.1:{port}\r\n");
    let request = format!("GET /socket HTTP/1.1\r\n{host}{UPGRADE}\r\n");
    let viewers: Vec<_> = (0..10)
        .map(|_| {
            let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
            stream.write_all(request.as_bytes()).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
            stream
        })
        .collect();
    let idle: Vec<_> = (0..150).filter_map(|_| TcpStream::connect(("127.0.0.1", port)).ok()).collect();
    // Nine viewers read snapshots for a second; the tenth reads nothing.
    let mut taken = [0; 9];
    for (viewer, taken) in viewers.iter().zip(&mut taken) {
        let mut bytes = vec![0; 4096];
        while *taken < 30_000 {
            *taken += (&*viewer).read(&mut bytes).unwrap();
        }
    }
    drop(idle);
    running.interrupt();
    let run = running.wait();
    run.assert_complete();
}
