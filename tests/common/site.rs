//! Keys, and systems that show them.

use std::path::PathBuf;

use tempfile::TempDir;

use super::{System, plumb};

/// A folder of keys.
pub(crate) struct Site(TempDir);

impl Site {
    pub(crate) fn new(parties: &[&[&str]]) -> Self {
        let site = Self(tempfile::tempdir().unwrap());
        site.keys(&["init"]);
        parties.iter().for_each(|party| site.keys(party));
        site
    }

    fn keys(&self, arguments: &[&str]) {
        let made = plumb(&["keys"]).args(arguments).arg("--dir").arg(self.0.path()).output().unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    }

    pub(crate) fn of(&self, party: &str) -> PathBuf {
        self.0.path().join(party)
    }

    /// What `[gateway]` says of a party's certificate.
    pub(crate) fn tls(&self, party: &str) -> String {
        let [ca, cert, key] = ["ca.pem", "cert.pem", "key.pem"].map(|file| self.of(party).join(file));
        format!("tls = {{ ca = {ca:?}, cert = {cert:?}, key = {key:?} }}")
    }
}

/// A system with a gateway whose table is `gateway`.
pub(crate) fn system(gateway: &str) -> System {
    System::new(&format!(
        "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"gateway\"]\n[ingest.sim]\nrate_hz = 100\n[gateway]\n{gateway}\n"
    ))
}

/// A vehicle that listens itself at `port`.
pub(crate) fn listening(site: &Site, port: u16) -> System {
    let access = site.of("vehicle.alpha").join("access.json5");
    let tls = site.tls("vehicle.alpha");
    system(&format!("vehicle = \"alpha\"\nlisten = [\"quic/127.0.0.1:{port}\"]\naccess = {access:?}\n{tls}"))
}
