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
    let token_file = fs::metadata(system.path("plumbline").join(&system.name).join("cockpit.token")).unwrap();
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

/// Reads `count` bytes. Panics if the connection ends before that.
fn read_bytes(mut stream: &TcpStream, count: usize) {
    let (mut bytes, mut taken) = (vec![0; 4096], 0);
    while taken < count {
        let read = stream.read(&mut bytes).unwrap();
        assert!(read > 0, "disconnected after {taken} bytes");
        taken += read;
    }
}

/// Encodes a WebSocket frame that presents a token. The frame has a zero mask.
fn token_frame(token: &str) -> Vec<u8> {
    let command = [b"\x0a\x04look\x12", &[token.len() as u8][..], token.as_bytes(), b"\x18\x04"].concat();
    [&[0x82, 0x80 | command.len() as u8, 0, 0, 0, 0][..], &command].concat()
}

#[test]
fn operator_is_served_among_crowds_without_token() {
    let (system, port) = with_cockpit("");
    let running = system.start(&[]);
    system.wait_until_running();
    let own = address(&system, port);
    let token = own.split_once('#').unwrap().1;
    wait_for("the page", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    let host = format!("Host: 127.0.0.1:{port}\r\n");
    let authorized = format!("{host}Authorization: Bearer {token}\r\n");
    let mut crowd: Vec<_> = (0..200).map(|_| TcpStream::connect(("127.0.0.1", port)).unwrap()).collect();
    for _ in 0..5 {
        for stream in &mut crowd {
            // The server may have closed the connection.
            let _ = stream.write_all(format!("HEAD / HTTP/1.1\r\n{host}\r\n").as_bytes());
        }
        assert!(get(port, "/metrics", &authorized).starts_with("http/1.1 200"));
    }
    let request = format!("GET /socket HTTP/1.1\r\n{host}{UPGRADE}\r\n");
    let view = || {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        stream
    };
    let _viewers: Vec<_> = (0..40).map(|_| view()).collect();
    let (mut operator, response) = connect(port, &request);
    assert!(response.starts_with("http/1.1 101"), "{response}");
    operator.write_all(&token_frame(token)).unwrap();
    read_bytes(&operator, 30_000);
    let _more: Vec<_> = (0..40).map(|_| view()).collect();
    read_bytes(&operator, 30_000);
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn connection_without_token_ends_after_few_requests() {
    let (system, port) = with_cockpit("");
    let running = system.start(&[]);
    system.wait_until_running();
    let own = address(&system, port);
    let token = own.split_once('#').unwrap().1;
    wait_for("the page", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    // Returns the number of requests that a connection serves, at most 30.
    let served = |headers: &str| {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        let request = format!("HEAD / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{headers}\r\n");
        (1..=30).find(|_| {
            stream.write_all(request.as_bytes()).unwrap();
            let (mut text, mut part) = (Vec::new(), [0; 4096]);
            while !text.ends_with(b"\r\n\r\n") {
                let read = stream.read(&mut part).unwrap();
                assert!(read > 0, "{}", String::from_utf8_lossy(&text));
                text.extend_from_slice(&part[..read]);
            }
            String::from_utf8_lossy(&text).to_lowercase().contains("connection: close")
        })
    };
    assert_eq!(served(""), Some(8));
    assert_eq!(served("Authorization: Bearer wrong\r\n"), Some(8));
    assert_eq!(served(&format!("Authorization: Bearer {token}\r\n")), None);
    running.interrupt();
    running.wait().assert_complete();
}

#[test]
fn viewer_that_sends_empty_fragments_is_disconnected() {
    let (system, port) = with_cockpit("");
    let running = system.start(&[]);
    system.wait_until_running();
    wait_for("the page", || TcpStream::connect(("127.0.0.1", port)).is_ok());
    let (mut stream, response) =
        connect(port, &format!("GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{UPGRADE}\r\n"));
    assert!(response.starts_with("http/1.1 101"), "{response}");
    let fragments = [vec![0x02, 0x80, 0, 0, 0, 0], [0x00, 0x80, 0, 0, 0, 0].repeat(5000)].concat();
    // The server may already have closed the connection.
    let _ = stream.write_all(&fragments);
    let mut bytes = vec![0; 1 << 16];
    let is_closed = (0..300).any(|_| matches!(stream.read(&mut bytes), Ok(0) | Err(_)));
    assert!(is_closed, "the viewer still receives snapshots");
    running.interrupt();
    running.wait().assert_complete();
}
