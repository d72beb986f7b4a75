//! Real Zenoh sessions with the configurations that `plumb keys` writes, but for paths and ports.

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

/// How long an attempt to connect may take; one that succeeds takes much less.
const CONNECT_LIMIT_MS: u32 = 4000;
/// How long an answer is waited for.
const ANSWER_LIMIT: Duration = Duration::from_secs(3);

/// A folder of keys, and the port of its router.
pub(super) struct Site {
    folder: TempDir,
    pub(super) keys: Keys,
    pub(super) port: u16,
    vehicles_are_peers: bool,
}

impl Site {
    /// With a certificate for each of the parties.
    pub(super) fn new(parties: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (keys, _) = Keys::init(folder.path(), &["127.0.0.1".parse().unwrap()], 30, false).unwrap();
        let site = Self { folder, keys, port: free_port(), vehicles_are_peers: false };
        parties.iter().for_each(|party| site.issue(party));
        site
    }

    /// One whose vehicles are clients of the router, as their configuration has it, and one where they are its peers.
    pub(super) fn both(parties: &[&str]) -> [Self; 2] {
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

    /// The router, as its folder has it.
    pub(super) fn router(&self) -> Session {
        listening(&self.configuration(&self.path("router")))
    }

    /// A session as a party's folder has it.
    pub(super) fn session(&self, party: &str) -> Session {
        self.open(&self.path(party)).unwrap()
    }

    /// A session that listens with the certificate of a vehicle, as its gateway does without a router.
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

    /// The same from another folder, which may be refused.
    pub(super) fn open(&self, folder: &Path) -> zenoh::Result<Session> {
        let mut config = self.configuration(folder);
        config.insert_json5("connect/timeout_ms", &CONNECT_LIMIT_MS.to_string()).unwrap();
        if self.vehicles_are_peers && folder.join("vehicle.json5").exists() {
            config.insert_json5("mode", "\"peer\"").unwrap();
            config.insert_json5("listen/endpoints", "[]").unwrap();
            config.insert_json5("connect/exit_on_failure", "true").unwrap();
        }
        zenoh::open(config).wait()
    }

    /// The configuration of a folder, with the folder's paths and this site's port.
    pub(super) fn configuration(&self, folder: &Path) -> Config {
        let files = ["router.json5", "vehicle.json5", "ground.json5"].map(|file| folder.join(file));
        let text = fs::read_to_string(files.iter().find(|file| file.exists()).unwrap()).unwrap();
        let text = text
            .replace(INSTALL_DIR, folder.to_str().unwrap())
            .replace("0.0.0.0:7447", &format!("127.0.0.1:{}", self.port))
            .replace("127.0.0.1:7447", &format!("127.0.0.1:{}", self.port));
        Config::from_json5(&text).unwrap()
    }

    /// A copy of a party's folder, to be tampered with.
    pub(super) fn copy_of(&self, party: &str) -> TempDir {
        let copy = tempfile::tempdir().unwrap();
        for file in fs::read_dir(self.path(party)).unwrap().flatten() {
            fs::copy(file.path(), copy.path().join(file.file_name())).unwrap();
        }
        copy
    }
}

/// A session that listens. The port of one that has just closed is free a little later.
fn listening(config: &Config) -> Session {
    let mut session = None;
    until("the port", || {
        session = zenoh::open(config.clone()).wait().ok();
        session.is_some()
    });
    session.unwrap()
}

fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// A vehicle as its gateway is: telemetry, last values, liveliness, commands.
pub(super) struct Vehicle {
    pub session: Session,
    name: String,
    /// The commands that arrived.
    pub commands: Heard,
    _kept: Vec<Box<dyn std::any::Any>>,
}

impl Vehicle {
    pub(super) fn new(session: Session, name: &str) -> Self {
        let key = |rest: &str| format!("plumbline/v1/{name}/{rest}");
        let commands = Heard::default();
        let mut kept: Vec<Box<dyn std::any::Any>> = Vec::new();
        for (rest, answer) in [("attitude", "level"), ("schema", "types"), ("command/swap", "committed")] {
            let (heard, key) = (commands.clone(), key(rest));
            let answer_to = {
                let key = key.clone();
                move |query: zenoh::query::Query| {
                    if rest.starts_with("command") {
                        heard.add(query.key_expr().as_str());
                    }
                    query.reply(&key, answer).wait().unwrap();
                }
            };
            kept.push(Box::new(session.declare_queryable(key).callback(answer_to).wait().unwrap()));
        }
        for rest in ["@live", "@live/fuser"] {
            kept.push(Box::new(session.liveliness().declare_token(key(rest)).wait().unwrap()));
        }
        Self { session, name: name.into(), commands, _kept: kept }
    }

    pub(super) fn publish(&self) {
        self.session.put(format!("plumbline/v1/{}/attitude", self.name), "level").wait().unwrap();
    }
}

/// Keys of what was heard.
#[derive(Clone, Default)]
pub(super) struct Heard {
    keys: Arc<Mutex<Vec<String>>>,
    /// It hears as long as its session is open.
    _open: Option<Session>,
}

impl Heard {
    /// What a subscriber of `key` hears.
    pub(super) fn of(session: &Session, key: &str) -> Self {
        let heard = Self::default();
        let to = heard.clone();
        session
            .declare_subscriber(key)
            .callback(move |sample| to.add(sample.key_expr().as_str()))
            .background()
            .wait()
            .unwrap();
        Self { _open: Some(session.clone()), ..heard }
    }

    /// Who is heard to be alive.
    pub(super) fn alive(session: &Session, key: &str) -> Self {
        let heard = Self::default();
        let to = heard.clone();
        let alive = session.liveliness().declare_subscriber(key).history(true);
        alive.callback(move |sample| to.add(sample.key_expr().as_str())).background().wait().unwrap();
        Self { _open: Some(session.clone()), ..heard }
    }

    pub(super) fn add(&self, key: &str) {
        self.keys.lock().unwrap().push(key.into());
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.all().iter().any(|heard| heard == key)
    }

    pub(super) fn all(&self) -> Vec<String> {
        self.keys.lock().unwrap().clone()
    }
}

/// The keys of the answers to a query.
pub(super) fn ask(session: &Session, key: &str) -> Vec<String> {
    let answers = session.get(key).payload("request").timeout(ANSWER_LIMIT).wait().unwrap();
    std::iter::from_fn(|| answers.recv().ok())
        .filter_map(|answer| Some(answer.result().ok()?.key_expr().to_string()))
        .collect()
}

/// Who is alive.
pub(super) fn ask_alive(session: &Session, key: &str) -> Vec<String> {
    let answers = session.liveliness().get(key).timeout(ANSWER_LIMIT).wait().unwrap();
    std::iter::from_fn(|| answers.recv().ok())
        .filter_map(|answer| Some(answer.result().ok()?.key_expr().to_string()))
        .collect()
}

/// Waits for something that must come; the limit is only there to end a failed test.
pub(super) fn until(what: &str, mut done: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while !done() {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}
