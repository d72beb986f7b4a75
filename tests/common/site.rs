//! Keys created by `plumb keys`, and systems that use them.

use std::path::PathBuf;

use tempfile::TempDir;

use super::{System, plumb};

/// Temporary key folder.
pub(crate) struct Site(TempDir);

impl Site {
    /// Creates an authority and the keys of these holders.
    ///
    /// Each holder is given by the arguments for `plumb keys`.
    pub(crate) fn new(holders: &[&[&str]]) -> Self {
        let site = Self(tempfile::tempdir().unwrap());
        site.keys(&["init"]);
        holders.iter().for_each(|holder| site.keys(holder));
        site
    }

    fn keys(&self, arguments: &[&str]) {
        let output = plumb(&["keys"]).args(arguments).arg("--dir").arg(self.0.path()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    /// Returns the folder with a holder's keys.
    pub(crate) fn holder_folder(&self, holder: &str) -> PathBuf {
        self.0.path().join(holder)
    }

    /// Returns the `tls` key of `[gateway]` for a holder's certificate.
    pub(crate) fn tls(&self, holder: &str) -> String {
        let [ca, cert, key] = ["ca.pem", "cert.pem", "key.pem"].map(|file| self.holder_folder(holder).join(file));
        format!("tls = {{ ca = {ca:?}, cert = {cert:?}, key = {key:?} }}")
    }
}

/// Creates a system with this `[gateway]` table.
pub(crate) fn system_with_gateway(gateway: &str) -> System {
    System::new(&format!(
        "services = [\"ingest\", \"gyro\", \"accel\", \"fuser\", \"course\", \"gateway\"]\n[ingest.sim]\nrate_hz = 100\n[gateway]\n{gateway}\n"
    ))
}

/// Creates a system with a gateway that listens on `port` and uses the keys of vehicle `alpha`.
pub(crate) fn listening_vehicle(site: &Site, port: u16) -> System {
    let access = site.holder_folder("vehicle.alpha").join("access.json5");
    let tls = site.tls("vehicle.alpha");
    system_with_gateway(&format!(
        "vehicle = \"alpha\"\nlisten = [\"quic/127.0.0.1:{port}\"]\naccess = {access:?}\n{tls}"
    ))
}
