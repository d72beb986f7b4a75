//! Links over QUIC with certificates: delivery before close, lost peers, half-open handshakes,
//! addresses.
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

const TIMEOUT: Duration = Duration::from_secs(60);
/// Timeout of one poll.
const POLL_TIMEOUT: Duration = Duration::from_millis(50);

/// Listening vehicle with its own key folder and the key folders of other parties.
struct Board {
    folder: TempDir,
    port: u16,
    link: Link,
}

impl Board {
    fn new(parties: &[&str]) -> Self {
        Self::listening_at("127.0.0.1", parties)
    }

    fn listening_at(address: &str, parties: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let hosts = ["127.0.0.1".parse().unwrap()];
        let (keys, _) = Keys::init(folder.path(), &hosts, 2, false).unwrap();
        keys.issue(&"vehicle.board".parse().unwrap(), &hosts, &[], 2, false).unwrap();
        parties.iter().for_each(|party| drop(keys.issue(&party.parse().unwrap(), &[], &[], 2, false).unwrap()));
        let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let tls = tls(&folder.path().join("vehicle.board"));
        let endpoints = Endpoints { listen: vec![format!("quic/{address}:{port}")], tls, ..Endpoints::default() };
        let link = Link::open(&endpoints).unwrap();
        Self { folder, port, link }
    }

    /// Returns the endpoints that a party uses to connect to `port`.
    fn endpoints(&self, party: &str, port: u16) -> Endpoints {
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

/// UDP proxy between one client and `port`. The connection can be cut.
struct CuttableProxy {
    port: u16,
    is_cut: Arc<AtomicBool>,
}

impl CuttableProxy {
    fn start(port: u16) -> Self {
        let (client_side, server_side) = (socket(), socket());
        let proxy = Self { port: client_side.local_addr().unwrap().port(), is_cut: Arc::default() };
        let is_cut = proxy.is_cut.clone();
        thread::spawn(move || {
            let (mut datagram, mut caller) = ([0; 65536], None);
            client_side.set_nonblocking(true).unwrap();
            server_side.set_nonblocking(true).unwrap();
            while !is_cut.load(Ordering::SeqCst) {
                let mut idle = true;
                if let Ok((length, from)) = client_side.recv_from(&mut datagram) {
                    (idle, caller) = (false, Some(from));
                    let _ = server_side.send_to(&datagram[..length], (Ipv4Addr::LOCALHOST, port));
                }
                if let (Ok((length, _)), Some(to)) = (server_side.recv_from(&mut datagram), caller) {
                    idle = false;
                    let _ = client_side.send_to(&datagram[..length], to);
                }
                if idle {
                    thread::sleep(Duration::from_millis(1));
                }
            }
        });
        proxy
    }

    fn cut(&self) {
        self.is_cut.store(true, Ordering::SeqCst);
    }
}

impl Drop for CuttableProxy {
    fn drop(&mut self) {
        self.cut();
    }
}

fn socket() -> UdpSocket {
    UdpSocket::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).unwrap()
}

#[test]
fn messages_sent_before_close_arrive() {
    const MESSAGES: u32 = 200;
    let board = Board::new(&["vehicle.alpha"]);
    let subscriber = board.link.subscribe("last").unwrap();
    let alpha = Link::open(&board.endpoints("vehicle.alpha", board.port)).unwrap();
    let publisher = alpha.publisher("last", "number").unwrap();
    while subscriber.next(POLL_TIMEOUT).is_none() {
        publisher.send(b"first").unwrap();
    }
    for number in 0..MESSAGES {
        publisher.send(&number.to_le_bytes()).unwrap();
    }
    alpha.close();
    let numbers = std::iter::from_fn(|| subscriber.next(Duration::from_secs(3)));
    let numbers: Vec<_> =
        numbers.filter_map(|sample| Some(u32::from_le_bytes(sample.bytes.try_into().ok()?))).collect();
    assert_eq!(numbers, Vec::from_iter(0..MESSAGES));
}

#[test]
fn silent_peer_is_detected_before_default_lease() {
    let board = Board::new(&["vehicle.alpha", "vehicle.beta"]);
    let liveliness = board.link.subscribe_liveliness("live/*").unwrap();
    let proxies = [CuttableProxy::start(board.port), CuttableProxy::start(board.port)];
    let alpha = Link::open(&board.endpoints("vehicle.alpha", proxies[0].port)).unwrap();
    let _alpha_token = alpha.declare_liveliness("live/alpha").unwrap();

    let mut config = zenoh::Config::default();
    let folder = board.folder.path().join("vehicle.beta");
    let quoted = |file: &str| format!("{:?}", folder.join(file).to_str().unwrap());
    for (key, value) in [
        ("mode", "\"client\"".into()),
        ("connect/endpoints", format!("[\"quic/127.0.0.1:{}\"]", proxies[1].port)),
        ("scouting/multicast/enabled", "false".into()),
        ("transport/link/tls/enable_mtls", "true".into()),
        ("transport/link/tls/root_ca_certificate", quoted("ca.pem")),
        ("transport/link/tls/connect_certificate", quoted("cert.pem")),
        ("transport/link/tls/connect_private_key", quoted("key.pem")),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    let beta = zenoh::open(config).wait().unwrap();
    let _beta_token = beta.liveliness().declare_token("live/beta").wait().unwrap();

    let next = || liveliness.next(TIMEOUT).map(|change| (change.key, change.is_present)).unwrap();
    let mut present = [next(), next()];
    present.sort();
    assert_eq!(present, [("live/alpha".into(), true), ("live/beta".into(), true)]);
    // Alpha goes silent 3 s later than beta. The loss of alpha is nevertheless detected first,
    // because only beta uses Zenoh's default lease, which is longer.
    proxies[1].cut();
    thread::sleep(Duration::from_secs(3));
    proxies[0].cut();
    assert_eq!([next(), next()], [("live/alpha".into(), false), ("live/beta".into(), false)]);
}

#[test]
fn half_open_handshake_does_not_block_next_client() {
    let board = Board::new(&["viewer.wall", "viewer.desk"]);
    // Only the first datagram of this client reaches the vehicle.
    let relay = socket();
    let endpoints = board.endpoints("viewer.wall", relay.local_addr().unwrap().port());
    let half_open = thread::spawn(move || Link::open(&endpoints).map(drop));
    let mut datagram = [0; 65536];
    let (length, _) = relay.recv_from(&mut datagram).unwrap();
    relay.send_to(&datagram[..length], (Ipv4Addr::LOCALHOST, board.port)).unwrap();
    // The response shows that the datagram has arrived.
    while relay.recv_from(&mut datagram).unwrap().1.port() != board.port {}

    let desk = Link::open(&board.endpoints("viewer.desk", board.port)).unwrap();
    assert!(desk.wait_for_peer(TIMEOUT));
    // The half-open client receives no response and reports this.
    let error = half_open.join().unwrap().unwrap_err();
    assert!(matches!(error, LinkError::Unreachable { .. }) && error.to_string().contains("no response"), "{error}");
}

#[test]
fn rejected_client_receives_reason() {
    let (board, other) = (Board::new(&[]), Board::new(&["operator.ann"]));
    let error = Link::open(&other.endpoints("operator.ann", board.port)).unwrap_err();
    assert!(error.to_string().contains("its certificate was issued by another authority"), "{error}");
}

#[test]
fn wildcard_ipv6_listener_is_reached_over_ipv4() {
    let board = Board::listening_at("[::]", &["viewer.wall"]);
    let wall = Link::open(&board.endpoints("viewer.wall", board.port)).unwrap();
    assert!(wall.wait_for_peer(TIMEOUT));
}

#[test]
fn ipv6_endpoint_is_rejected_with_remedy() {
    for endpoint in ["quic/[::1]:7447", "quic/fd00::1:7447"] {
        let error = Link::open(&Endpoints::with_connect(&[endpoint.into()])).unwrap_err();
        assert!(matches!(error, LinkError::Ipv6 { .. }), "{error}");
        assert!(error.to_string().contains("use a DNS name or an IPv4 address"), "{error}");
    }
}
