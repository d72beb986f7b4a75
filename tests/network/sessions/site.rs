//! Real Zenoh sessions with the configurations that `plumb keys` writes, except for paths and
//! ports.

use std::{
    fs,
    net::UdpSocket,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use keys::{Keys, Party, configuration::INSTALL_DIR};
use tempfile::TempDir;
use zenoh::{Config, Session, Wait};

/// Timeout for a connection attempt, ms. A successful attempt takes much less.
const CONNECT_TIMEOUT_MS: u32 = 4000;
/// Timeout for a query.
const QUERY_TIMEOUT: Duration = Duration::from_secs(3);

/// Key folder, with the port of its router or listening vehicle.
pub(super) struct Site {
    folder: TempDir,
    pub(super) keys: Keys,
    pub(super) port: u16,
    vehicles_are_peers: bool,
}

impl Site {
    /// Creates a folder with a certificate for each of the parties.
    pub(super) fn new(parties: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (keys, _) = Keys::init(folder.path(), &["127.0.0.1".parse().unwrap()], 30, false).unwrap();
        let site = Self { folder, keys, port: free_port(), vehicles_are_peers: false };
        parties.iter().for_each(|party| site.issue(party));
        site
    }

    /// Returns two sites. In the first, vehicles are clients of the router, as in the configuration
    /// that `plumb keys` writes. In the second, vehicles are peers.
    pub(super) fn with_vehicle_clients_and_peers(parties: &[&str]) -> [Self; 2] {
        [Self::new(parties), Self { vehicles_are_peers: true, ..Self::new(parties) }]
    }

    pub(super) fn issue(&self, party: &str) {
        self.keys.issue(&party.parse().unwrap(), &[], &[], 30, false).unwrap();
    }

    pub(super) fn revoke(&self, party: &str) {
        self.keys.revoke(&party.parse::<Party>().unwrap()).unwrap();
    }

    pub(super) fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    /// Opens the router with the configuration in its folder.
    pub(super) fn router(&self) -> Session {
        listening(&self.configuration(&self.path("router")))
    }

    /// Opens a session with the configuration in a party's folder.
    pub(super) fn session(&self, party: &str) -> Session {
        self.open(&self.path(party)).unwrap()
    }

    /// Opens a session that listens with a vehicle's certificate, like a gateway that uses no
    /// router.
    pub(super) fn listening(&self, vehicle: &str) -> Session {
        let folder = self.path(vehicle);
        let mut config = Config::default();
        let quoted = |file: &str| format!("{:?}", folder.join(file).to_str().unwrap());
        for (key, value) in [
            ("mode", "\"peer\"".into()),
            ("listen/endpoints", format!("[\"quic/127.0.0.1:{}\"]", self.port)),
            ("scouting/multicast/enabled", "false".into()),
            ("scouting/gossip/enabled", "false".into()),
            ("transport/link/tls/enable_mtls", "true".into()),
            ("transport/link/tls/root_ca_certificate", quoted("ca.pem")),
            ("transport/link/tls/listen_certificate", quoted("cert.pem")),
            ("transport/link/tls/listen_private_key", quoted("key.pem")),
            ("access_control", fs::read_to_string(folder.join("access.json5")).unwrap()),
        ] {
            config.insert_json5(key, &value).unwrap();
        }
        listening(&config)
    }

    /// Tries to open a session with the configuration in the given folder.
    pub(super) fn open(&self, folder: &Path) -> zenoh::Result<Session> {
        let mut config = self.configuration(folder);
        config.insert_json5("connect/timeout_ms", &CONNECT_TIMEOUT_MS.to_string()).unwrap();
        if self.vehicles_are_peers && folder.join("vehicle.json5").exists() {
            config.insert_json5("mode", "\"peer\"").unwrap();
            config.insert_json5("listen/endpoints", "[]").unwrap();
            config.insert_json5("connect/exit_on_failure", "true").unwrap();
        }
        zenoh::open(config).wait()
    }

    /// Returns the configuration in a folder, with the paths and the port of this site filled in.
    pub(super) fn configuration(&self, folder: &Path) -> Config {
        let files = ["router.json5", "vehicle.json5", "ground.json5"].map(|file| folder.join(file));
        let text = fs::read_to_string(files.iter().find(|file| file.exists()).unwrap()).unwrap();
        let text = text
            .replace(INSTALL_DIR, folder.to_str().unwrap())
            .replace("0.0.0.0:7447", &format!("127.0.0.1:{}", self.port))
            .replace("127.0.0.1:7447", &format!("127.0.0.1:{}", self.port));
        Config::from_json5(&text).unwrap()
    }

    /// Copies a party's folder, so that a test can modify it.
    pub(super) fn copy_folder(&self, party: &str) -> TempDir {
        let copy = tempfile::tempdir().unwrap();
        for file in fs::read_dir(self.path(party)).unwrap().flatten() {
            fs::copy(file.path(), copy.path().join(file.file_name())).unwrap();
        }
        copy
    }
}

/// Opens a session that listens. Retries if necessary, because the port of a closed session is
/// freed after a delay.
fn listening(config: &Config) -> Session {
    let mut session = None;
    wait_for("the port to be free", || {
        session = zenoh::open(config.clone()).wait().ok();
        session.is_some()
    });
    session.unwrap()
}

fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Session with a gateway's declarations: telemetry, last values, liveliness and commands.
pub(super) struct Vehicle {
    pub session: Session,
    name: String,
    /// Keys of the received commands.
    pub commands: Received,
    _declarations: Vec<Box<dyn std::any::Any>>,
}

impl Vehicle {
    pub(super) fn new(session: Session, name: &str) -> Self {
        let key = |rest: &str| format!("plumbline/v1/{name}/{rest}");
        let commands = Received::default();
        let mut declarations: Vec<Box<dyn std::any::Any>> = Vec::new();
        for (rest, value) in [("attitude", "level"), ("schema", "types"), ("command/swap", "committed")] {
            let (received, key) = (commands.clone(), key(rest));
            let respond = {
                let key = key.clone();
                move |query: zenoh::query::Query| {
                    if rest.starts_with("command") {
                        received.add(query.key_expr().as_str());
                    }
                    query.reply(&key, value).wait().unwrap();
                }
            };
            declarations.push(Box::new(session.declare_queryable(key).callback(respond).wait().unwrap()));
        }
        for rest in ["@live", "@live/fuser"] {
            declarations.push(Box::new(session.liveliness().declare_token(key(rest)).wait().unwrap()));
        }
        Self { session, name: name.into(), commands, _declarations: declarations }
    }

    pub(super) fn publish(&self) {
        self.session.put(format!("plumbline/v1/{}/attitude", self.name), "level").wait().unwrap();
    }
}

/// Keys of the received samples or queries.
#[derive(Clone, Default)]
pub(super) struct Received {
    keys: Arc<Mutex<Vec<String>>>,
    /// Session of the subscriber, which must stay open.
    _session: Option<Session>,
}

impl Received {
    /// Subscribes to `key`.
    pub(super) fn subscribe(session: &Session, key: &str) -> Self {
        let received = Self::default();
        let recorder = received.clone();
        session
            .declare_subscriber(key)
            .callback(move |sample| recorder.add(sample.key_expr().as_str()))
            .background()
            .wait()
            .unwrap();
        Self { _session: Some(session.clone()), ..received }
    }

    /// Subscribes to liveliness tokens.
    pub(super) fn subscribe_liveliness(session: &Session, key: &str) -> Self {
        let received = Self::default();
        let recorder = received.clone();
        let tokens = session.liveliness().declare_subscriber(key).history(true);
        tokens.callback(move |sample| recorder.add(sample.key_expr().as_str())).background().wait().unwrap();
        Self { _session: Some(session.clone()), ..received }
    }

    pub(super) fn add(&self, key: &str) {
        self.keys.lock().unwrap().push(key.into());
    }

    pub(super) fn contains(&self, key: &str) -> bool {
        self.keys().iter().any(|received| received == key)
    }

    pub(super) fn keys(&self) -> Vec<String> {
        self.keys.lock().unwrap().clone()
    }
}

/// Returns the keys of the replies to a query.
pub(super) fn query_keys(session: &Session, key: &str) -> Vec<String> {
    let replies = session.get(key).payload("request").timeout(QUERY_TIMEOUT).wait().unwrap();
    std::iter::from_fn(|| replies.recv().ok())
        .filter_map(|reply| Some(reply.result().ok()?.key_expr().to_string()))
        .collect()
}

/// Returns the keys of the live tokens.
pub(super) fn query_live_tokens(session: &Session, key: &str) -> Vec<String> {
    let replies = session.liveliness().get(key).timeout(QUERY_TIMEOUT).wait().unwrap();
    std::iter::from_fn(|| replies.recv().ok())
        .filter_map(|reply| Some(reply.result().ok()?.key_expr().to_string()))
        .collect()
}

/// Waits for a condition. The timeout elapses only if a test fails.
pub(super) fn wait_for(what: &str, mut done: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while !done() {
        assert!(Instant::now() < deadline, "timed out waiting for {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}
