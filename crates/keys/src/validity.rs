//! Checks whether a certificate is valid now and names the command that renews it.

use std::{fs, path::Path};

use time::OffsetDateTime;

use crate::{KeysError, certificate::Contents};

/// Checks that the file contains a certificate that is valid now.
///
/// # Errors
///
/// Returns [`KeysError::Io`] or [`KeysError::InvalidFile`] if the file cannot be read, and
/// [`KeysError::Expired`] or [`KeysError::NotYetValid`], each with a remedy, if the certificate is
/// not valid now.
pub fn check(path: &Path) -> Result<(), KeysError> {
    let text = fs::read_to_string(path).map_err(|cause| KeysError::Io { action: "read", path: path.into(), cause })?;
    let contents =
        Contents::from_pem(&text).map_err(|why| KeysError::InvalidFile { path: path.into(), why: why.into() })?;
    let now = OffsetDateTime::now_utc();
    let (name, path, today) = (contents.common_name.clone(), path.into(), now.date().to_string());
    if contents.not_after < now {
        let (until, remedy) = (contents.not_after.date().to_string(), remedy(&contents));
        return Err(KeysError::Expired { name, path, until, today, remedy });
    }
    if contents.not_before > now {
        return Err(KeysError::NotYetValid { name, path, from: contents.not_before.date().to_string(), today });
    }
    Ok(())
}

/// Returns the command that issues a new certificate.
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

    /// Writes a certificate for `name` and returns its path. `hours` contains the start and the end
    /// of validity, in hours from now.
    fn file(folder: &Path, name: &str, hosts: &[&str], hours: [i64; 2]) -> PathBuf {
        let mut params = CertificateParams::new(hosts.iter().map(|host| (*host).into()).collect::<Vec<_>>()).unwrap();
        params.distinguished_name.push(DnType::CommonName, name);
        [params.not_before, params.not_after] = hours.map(|hours| OffsetDateTime::now_utc() + Duration::hours(hours));
        let path = folder.join("cert.pem");
        fs::write(&path, params.self_signed(&KeyPair::generate().unwrap()).unwrap().pem()).unwrap();
        path
    }

    #[test]
    fn expired_certificate_error_names_date_and_command() {
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
            for word in [name, path.to_str().unwrap(), &format!("expired on {day}"), command] {
                assert!(error.contains(word), "{word}: {error}");
            }
        }
        let error = check(&file(folder.path(), "viewer.wall", &[], [48, 72])).unwrap_err().to_string();
        assert!(error.contains("set the clock"), "{error}");
        check(&file(folder.path(), "viewer.wall", &[], [-1, 1])).unwrap();
        assert!(check(&folder.path().join("nothing.pem")).unwrap_err().to_string().contains("nothing.pem"));
    }
}
