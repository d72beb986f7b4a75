//! A link with certificates: what QUIC does not do by itself.
use std::{
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use keys::Keys;
use link::{Endpoints, Link, LinkError, endpoints::Tls};
use tempfile::TempDir;
use zenoh::Wait;

const LIMIT: Duration = Duration::from_secs(60);
/// So that an end looks now and then whether it is to end.
const TURN: Duration = Duration::from_millis(50);

/// A vehicle that listens, and a folder with its keys and those of others.
struct Board {
    folder: TempDir,
    port: u16,
    link: Link,
}

impl Board {
    fn with(parties: &[&str]) -> Self {
        Self::at("127.0.0.1", parties)
    }

    fn at(address: &str, parties: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let here = ["127.0.0.1".parse().unwrap()];
        let (keys, _) = Keys::init(folder.path(), &here, 2, false).unwrap();
        keys.issue(&"vehicle.board".parse().unwrap(), &here, &[], 2, false).unwrap();
        parties.iter().for_each(|party| drop(keys.issue(&party.parse().unwrap(), &[], &[], 2, false).unwrap()));
        let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let tls = tls(&folder.path().join("vehicle.board"));
        let ends = Endpoints { listen: vec![format!("quic/{address}:{port}")], tls, ..Endpoints::default() };
        let link = Link::open(&ends).unwrap();
        Self { folder, port, link }
    }

    /// How a party connects at `port`.
    fn ends(&self, party: &str, port: u16) -> Endpoints {
        Endpoints {
            tls: tls(&self.folder.path().join(party)),
            ..Endpoints::with_connect(&[format!("quic/127.0.0.1:{port}")])
        }
    }
}

fn tls(folder: &Path) -> Option<Tls> {
    let [ca, cert, key] = ["ca.pem", "cert.pem", "key.pem"].map(|file| folder.join(file));
    Some(Tls { ca, cert, key })
}

/// Forwards datagrams between one who connects here and `to`, until it is cut.
struct Way {
    port: u16,
    is_cut: Arc<AtomicBool>,
}

impl Way {
    fn to(port: u16) -> Self {
        let (here, there) = (socket(), socket());
        let way = Self { port: here.local_addr().unwrap().port(), is_cut: Arc::default() };
        let is_cut = way.is_cut.clone();
        thread::spawn(move || {
            let (mut datagram, mut caller) = ([0; 65536], None);
            here.set_nonblocking(true).unwrap();
            there.set_nonblocking(true).unwrap();
            while !is_cut.load(Ordering::SeqCst) {
                let mut idle = true;
                if let Ok((length, from)) = here.recv_from(&mut datagram) {
                    (idle, caller) = (false, Some(from));
                    let _ = there.send_to(&datagram[..length], (Ipv4Addr::LOCALHOST, port));
                }
                if let (Ok((length, _)), Some(to)) = (there.recv_from(&mut datagram), caller) {
                    idle = false;
                    let _ = here.send_to(&datagram[..length], to);
                }
                if idle {
                    thread::sleep(Duration::from_millis(1));
                }
            }
        });
        way
    }

    fn cut(&self) {
        self.is_cut.store(true, Ordering::SeqCst);
    }
}

impl Drop for Way {
    fn drop(&mut self) {
        self.cut();
    }
}

fn socket() -> UdpSocket {
    UdpSocket::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).unwrap()
}

#[test]
fn what_was_sent_just_before_a_session_closes_arrives() {
    const MESSAGES: u32 = 200;
    let board = Board::with(&["vehicle.alpha"]);
    let heard = board.link.subscribe("last").unwrap();
    let alpha = Link::open(&board.ends("vehicle.alpha", board.port)).unwrap();
    let outlet = alpha.publisher("last", "number").unwrap();
    while heard.next(TURN).is_none() {
        outlet.send(b"first").unwrap();
    }
    for number in 0..MESSAGES {
        outlet.send(&number.to_le_bytes()).unwrap();
    }
    alpha.close();
    let numbers = std::iter::from_fn(|| heard.next(Duration::from_secs(3)));
    let numbers: Vec<_> = numbers.filter_map(|it| Some(u32::from_le_bytes(it.bytes.try_into().ok()?))).collect();
    assert_eq!(numbers, Vec::from_iter(0..MESSAGES));
}

#[test]
fn a_neighbour_that_falls_silent_is_missed_before_one_of_zenoh_without_a_configuration() {
    let board = Board::with(&["vehicle.alpha", "vehicle.beta"]);
    let signs = board.link.subscribe_liveliness("live/*").unwrap();
    let ways = [Way::to(board.port), Way::to(board.port)];
    let alpha = Link::open(&board.ends("vehicle.alpha", ways[0].port)).unwrap();
    let _sign = alpha.declare_liveliness("live/alpha").unwrap();

    let mut config = zenoh::Config::default();
    let folder = board.folder.path().join("vehicle.beta");
    let quoted = |file: &str| format!("{:?}", folder.join(file).to_str().unwrap());
    for (key, value) in [
        ("mode", "\"client\"".into()),
        ("connect/endpoints", format!("[\"quic/127.0.0.1:{}\"]", ways[1].port)),
        ("scouting/multicast/enabled", "false".into()),
        ("transport/link/tls/enable_mtls", "true".into()),
        ("transport/link/tls/root_ca_certificate", quoted("ca.pem")),
        ("transport/link/tls/connect_certificate", quoted("cert.pem")),
        ("transport/link/tls/connect_private_key", quoted("key.pem")),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    let beta = zenoh::open(config).wait().unwrap();
    let _token = beta.liveliness().declare_token("live/beta").wait().unwrap();

    let next = || signs.next(LIMIT).map(|sign| (sign.key, sign.is_present)).unwrap();
    let mut came = [next(), next()];
    came.sort();
    assert_eq!(came, [("live/alpha".into(), true), ("live/beta".into(), true)]);
    // Alpha falls silent as much later as its lease is long, and is missed first all the same.
    ways[1].cut();
    thread::sleep(Duration::from_secs(3));
    ways[0].cut();
    assert_eq!([next(), next()], [("live/alpha".into(), false), ("live/beta".into(), false)]);
}

#[test]
fn a_client_gets_in_behind_one_that_began_to_connect_and_left() {
    let board = Board::with(&["viewer.wall", "viewer.desk"]);
    // One whose first datagram gets through, and no other.
    let wire = socket();
    let ends = board.ends("viewer.wall", wire.local_addr().unwrap().port());
    let lost = thread::spawn(move || Link::open(&ends).map(drop));
    let mut hello = [0; 65536];
    let (length, _) = wire.recv_from(&mut hello).unwrap();
    wire.send_to(&hello[..length], (Ipv4Addr::LOCALHOST, board.port)).unwrap();
    // It has come when it is answered.
    while wire.recv_from(&mut hello).unwrap().1.port() != board.port {}

    let desk = Link::open(&board.ends("viewer.desk", board.port)).unwrap();
    assert!(desk.wait_for_peer(LIMIT));
    // Nobody answers the other one, who is told so.
    let error = lost.join().unwrap().unwrap_err();
    assert!(matches!(error, LinkError::Unreachable { .. }) && error.to_string().contains("no answer"), "{error}");
}

#[test]
fn who_is_turned_away_is_told_so() {
    let (board, other) = (Board::with(&[]), Board::with(&["operator.ann"]));
    let error = Link::open(&other.ends("operator.ann", board.port)).unwrap_err();
    assert!(error.to_string().contains("its certificate was issued by another authority"), "{error}");
}

#[test]
fn who_listens_at_every_address_of_ipv6_is_reached_at_one_of_ipv4() {
    let board = Board::at("[::]", &["viewer.wall"]);
    let wall = Link::open(&board.ends("viewer.wall", board.port)).unwrap();
    assert!(wall.wait_for_peer(LIMIT));
}

#[test]
fn an_ipv6_address_is_refused_with_the_remedy() {
    for endpoint in ["quic/[::1]:7447", "quic/fd00::1:7447"] {
        let error = Link::open(&Endpoints::with_connect(&[endpoint.into()])).unwrap_err();
        assert!(matches!(error, LinkError::Ipv6 { .. }), "{error}");
        assert!(error.to_string().contains("its DNS name, or by an IPv4 address"), "{error}");
    }
}
