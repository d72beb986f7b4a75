//! Whether a certificate serves now, and how it is made anew.

use std::{fs, path::Path};

use time::OffsetDateTime;

use crate::{KeysError, certificate::Contents};

/// What keeps the certificate of a file from serving now: it is not there, is none, has ended or has not begun, each with the remedy.
pub fn check(path: &Path) -> Result<(), KeysError> {
    let text =
        fs::read_to_string(path).map_err(|cause| KeysError::File { doing: "reading", path: path.into(), cause })?;
    let contents = Contents::read(&text).map_err(|why| KeysError::Damaged { path: path.into(), why })?;
    let now = OffsetDateTime::now_utc();
    let (name, path, today) = (contents.common_name.clone(), path.into(), now.date().to_string());
    if contents.until < now {
        let (until, remedy) = (contents.until.date().to_string(), remedy(&contents));
        return Err(KeysError::Ended { name, path, until, today, remedy });
    }
    if contents.from > now {
        return Err(KeysError::NotBegun { name, path, from: contents.from.date().to_string(), today });
    }
    Ok(())
}

/// The command that makes another.
fn remedy(contents: &Contents) -> String {
    let options =
        |option: &str| contents.hosts.iter().map(|host| format!(" {option} {}", host.as_str())).collect::<String>();
    match contents.common_name.split_once('.') {
        Some(("vehicle", name)) => format!("plumb keys vehicle {name}{} --force", options("--host")),
        Some((role @ ("operator" | "viewer"), name)) => format!("plumb keys {role} {name} --force"),
        _ if contents.common_name == "router" => format!("plumb keys router{} --force", options("--router")),
        _ => "plumb keys init --force".into(),
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use rcgen::{CertificateParams, DnType, KeyPair};
    use time::Duration;

    use super::*;

    /// A file with the certificate of `name`, valid for these hours from now.
    fn file(folder: &Path, name: &str, hosts: &[&str], hours: [i64; 2]) -> PathBuf {
        let mut params = CertificateParams::new(hosts.iter().map(|host| (*host).into()).collect::<Vec<_>>()).unwrap();
        params.distinguished_name.push(DnType::CommonName, name);
        [params.not_before, params.not_after] = hours.map(|hours| OffsetDateTime::now_utc() + Duration::hours(hours));
        let path = folder.join("cert.pem");
        fs::write(&path, params.self_signed(&KeyPair::generate().unwrap()).unwrap().pem()).unwrap();
        path
    }

    #[test]
    fn a_certificate_that_does_not_serve_is_named_with_its_day_and_the_command_for_another() {
        let folder = tempfile::tempdir().unwrap();
        for (name, hosts, command) in [
            ("operator.ann", &[][..], "`plumb keys operator ann --force`"),
            ("vehicle.alpha", &["10.0.0.1"], "`plumb keys vehicle alpha --host 10.0.0.1 --force`"),
            ("router", &["10.0.0.1", "a.example"], "`plumb keys router --router 10.0.0.1 --router a.example --force`"),
            ("plumbline authority", &[], "`plumb keys init --force`"),
        ] {
            let path = file(folder.path(), name, hosts, [-72, -48]);
            let error = check(&path).unwrap_err().to_string();
            let day = (OffsetDateTime::now_utc() - Duration::hours(48)).date().to_string();
            for word in [name, path.to_str().unwrap(), &format!("ended on {day}"), command] {
                assert!(error.contains(word), "{word}: {error}");
            }
        }
        let error = check(&file(folder.path(), "viewer.wall", &[], [48, 72])).unwrap_err().to_string();
        assert!(error.contains("set the clock"), "{error}");
        check(&file(folder.path(), "viewer.wall", &[], [-1, 1])).unwrap();
        assert!(check(&folder.path().join("nothing.pem")).unwrap_err().to_string().contains("nothing.pem"));
    }
}
