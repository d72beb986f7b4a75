//! Connections that are rejected because of their certificate. Each test also makes the same
//! attempt with a valid certificate.
use std::{fs, path::Path};

use super::site::Site;
use keys::certificate::IssuedCertificate;
use rcgen::{CertificateParams, DnType, ExtendedKeyUsagePurpose, Issuer, KeyPair};
use time::{Duration, OffsetDateTime};
use zenoh::Wait;

#[test]
fn client_without_certificate_is_rejected() {
    let site = Site::new(&["viewer.wall"]);
    let _router = site.router();
    let uncertified = site.copy_folder("viewer.wall");
    let path = uncertified.path().join("ground.json5");
    let text = fs::read_to_string(&path).unwrap();
    let is_kept = |line: &&str| !line.contains("connect_certificate") && !line.contains("connect_private_key");
    let without: Vec<&str> = text.lines().filter(is_kept).collect();
    fs::write(&path, without.join("\n").replace("enable_mtls: true", "enable_mtls: false")).unwrap();
    assert!(site.open(uncertified.path()).is_err());
    fs::write(&path, text).unwrap();
    assert!(site.open(uncertified.path()).is_ok());
}

#[test]
fn client_without_tls_is_rejected() {
    let site = Site::new(&["viewer.wall"]);
    let _router = site.router();
    let without_tls = site.copy_folder("viewer.wall");
    let path = without_tls.path().join("ground.json5");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("\"quic/", "\"tcp/")).unwrap();
    assert!(site.open(without_tls.path()).is_err());
    fs::write(&path, text).unwrap();
    assert!(site.open(without_tls.path()).is_ok());
}

#[test]
fn certificate_of_other_authority_is_rejected() {
    let (site, other) = (Site::new(&["operator.ann"]), Site::new(&["operator.ann"]));
    let _router = site.router();
    let foreign = site.copy_folder("operator.ann");
    for file in ["cert.pem", "key.pem"] {
        fs::copy(other.path("operator.ann").join(file), foreign.path().join(file)).unwrap();
    }
    assert!(site.open(foreign.path()).is_err());
    assert!(site.open(&site.path("operator.ann")).is_ok());
}

#[test]
fn router_of_other_authority_is_rejected() {
    let (site, other) = (Site::new(&["vehicle.alpha"]), Site::new(&[]));
    let trusting = site.copy_folder("vehicle.alpha");
    fs::copy(other.path("authority.pem"), trusting.path().join("ca.pem")).unwrap();
    let _router = site.router();
    assert!(site.open(trusting.path()).is_err());
    fs::copy(site.path("authority.pem"), trusting.path().join("ca.pem")).unwrap();
    assert!(site.open(trusting.path()).is_ok());
}

#[test]
fn expired_or_future_certificate_is_rejected() {
    let site = Site::new(&["vehicle.alpha"]);
    let _router = site.router();
    let alpha = site.copy_folder("vehicle.alpha");
    let now = OffsetDateTime::now_utc();
    for (from, until, is_valid) in [(-2, -1, false), (1, 2, false), (-1, 1, true)] {
        let [from, until] = [from, until].map(|days| now + Duration::days(days));
        let issued = party_certificate(&site.path(""), "vehicle.alpha", from, until);
        install(alpha.path(), &issued);
        assert_eq!(site.open(alpha.path()).is_ok(), is_valid, "valid from {from} until {until}");
    }
}

#[test]
fn vehicle_certificate_cannot_serve_as_router() {
    let site = Site::new(&["vehicle.alpha", "operator.ann"]);
    let impostor = site.copy_folder("router");
    for file in ["cert.pem", "key.pem"] {
        fs::copy(site.path("vehicle.alpha").join(file), impostor.path().join(file)).unwrap();
    }
    let router = zenoh::open(site.configuration(impostor.path())).wait().unwrap();
    assert!(site.open(&site.path("operator.ann")).is_err());
    router.close().wait().unwrap();
    let _router = site.router();
    assert!(site.open(&site.path("operator.ann")).is_ok());
}

#[test]
fn router_is_accepted_only_at_certified_hosts() {
    let site = Site::new(&["operator.ann"]);
    let connects_with_certificate_for = |host: &str| {
        site.keys.router(&[host.parse().unwrap()], 30, true).unwrap();
        let router = site.router();
        let is_connected = site.open(&site.path("operator.ann")).is_ok();
        router.close().wait().unwrap();
        is_connected
    };
    assert!(!connects_with_certificate_for("192.0.2.1"));
    assert!(connects_with_certificate_for("127.0.0.1"));
}

#[test]
fn router_with_empty_access_list_denies_everything() {
    let site = Site::new(&[]);
    let _router = site.router();
    // The certificate is signed by the authority but missing from the access list.
    let now = OffsetDateTime::now_utc();
    let issued = party_certificate(&site.path(""), "operator.ann", now - Duration::DAY, now + Duration::DAY);
    let folder = tempfile::tempdir().unwrap();
    let other = Site::new(&["operator.ann"]);
    for file in fs::read_dir(other.path("operator.ann")).unwrap().flatten() {
        fs::copy(file.path(), folder.path().join(file.file_name())).unwrap();
    }
    install(folder.path(), &issued);
    fs::copy(site.path("authority.pem"), folder.path().join("ca.pem")).unwrap();
    let session = site.open(folder.path()).unwrap();
    let received = super::site::Received::subscribe(&session, "plumbline/v1/**");
    assert_eq!(super::site::query_live_tokens(&session, "plumbline/v1/*/@live/**"), Vec::<String>::new());
    assert_eq!(super::site::query_keys(&session, "plumbline/v1/alpha/attitude"), Vec::<String>::new());
    assert_eq!(received.keys(), Vec::<String>::new());
}

/// Issues a certificate of the site's authority with the given validity period.
fn party_certificate(folder: &Path, name: &str, from: OffsetDateTime, until: OffsetDateTime) -> IssuedCertificate {
    let read = |file: &str| fs::read_to_string(folder.join(file)).unwrap();
    let authority = KeyPair::from_pem(&read("authority.key")).unwrap();
    let issuer = Issuer::from_ca_cert_pem(&read("authority.pem"), authority).unwrap();
    let mut params = CertificateParams::default();
    params.distinguished_name.push(DnType::CommonName, name);
    (params.not_before, params.not_after) = (from, until);
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    let pair = KeyPair::generate().unwrap();
    IssuedCertificate { certificate: params.signed_by(&pair, &issuer).unwrap().pem(), key: pair.serialize_pem() }
}

fn install(folder: &Path, issued: &IssuedCertificate) {
    fs::write(folder.join("cert.pem"), &issued.certificate).unwrap();
    fs::write(folder.join("key.pem"), &issued.key).unwrap();
}
