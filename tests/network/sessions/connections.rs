//! Who is refused a connection, and by what. Each refusal stands beside the same attempt with the right certificate.
use std::{fs, path::Path};

use super::site::Site;
use keys::certificate::IssuedCertificate;
use rcgen::{CertificateParams, DnType, ExtendedKeyUsagePurpose, Issuer, KeyPair};
use time::{Duration, OffsetDateTime};
use zenoh::Wait;

#[test]
fn nobody_connects_without_a_certificate() {
    let site = Site::new(&["viewer.wall"]);
    let _router = site.router();
    let bare = site.copy_of("viewer.wall");
    let path = bare.path().join("ground.json5");
    let text = fs::read_to_string(&path).unwrap();
    let kept = |line: &&str| !line.contains("connect_certificate") && !line.contains("connect_private_key");
    let without: Vec<&str> = text.lines().filter(kept).collect();
    fs::write(&path, without.join("\n").replace("enable_mtls: true", "enable_mtls: false")).unwrap();
    assert!(site.open(bare.path()).is_err());
    fs::write(&path, text).unwrap();
    assert!(site.open(bare.path()).is_ok());
}

#[test]
fn nobody_connects_without_tls() {
    let site = Site::new(&["viewer.wall"]);
    let _router = site.router();
    let plain = site.copy_of("viewer.wall");
    let path = plain.path().join("ground.json5");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("\"quic/", "\"tcp/")).unwrap();
    assert!(site.open(plain.path()).is_err());
    fs::write(&path, text).unwrap();
    assert!(site.open(plain.path()).is_ok());
}

#[test]
fn a_certificate_of_another_authority_is_refused_whatever_name_it_bears() {
    let (site, other) = (Site::new(&["operator.ann"]), Site::new(&["operator.ann"]));
    let _router = site.router();
    let foreign = site.copy_of("operator.ann");
    for file in ["cert.pem", "key.pem"] {
        fs::copy(other.path("operator.ann").join(file), foreign.path().join(file)).unwrap();
    }
    assert!(site.open(foreign.path()).is_err());
    assert!(site.open(&site.path("operator.ann")).is_ok());
}

#[test]
fn a_router_of_another_authority_is_refused() {
    let (site, other) = (Site::new(&["vehicle.alpha"]), Site::new(&[]));
    let trusting = site.copy_of("vehicle.alpha");
    fs::copy(other.path("authority.pem"), trusting.path().join("ca.pem")).unwrap();
    let _router = site.router();
    assert!(site.open(trusting.path()).is_err());
    fs::copy(site.path("authority.pem"), trusting.path().join("ca.pem")).unwrap();
    assert!(site.open(trusting.path()).is_ok());
}

#[test]
fn a_certificate_that_has_ended_or_not_begun_is_refused() {
    let site = Site::new(&["vehicle.alpha"]);
    let _router = site.router();
    let alpha = site.copy_of("vehicle.alpha");
    let now = OffsetDateTime::now_utc();
    for (from, until, welcome) in [(-2, -1, false), (1, 2, false), (-1, 1, true)] {
        let [from, until] = [from, until].map(|days| now + Duration::days(days));
        let issued = party_certificate(&site.path(""), "vehicle.alpha", from, until);
        put(alpha.path(), &issued);
        assert_eq!(site.open(alpha.path()).is_ok(), welcome, "valid from {from} until {until}");
    }
}

#[test]
fn who_has_a_certificate_cannot_pose_as_the_router() {
    let site = Site::new(&["vehicle.alpha", "operator.ann"]);
    let posing = site.copy_of("router");
    for file in ["cert.pem", "key.pem"] {
        fs::copy(site.path("vehicle.alpha").join(file), posing.path().join(file)).unwrap();
    }
    let router = zenoh::open(site.configuration(posing.path())).wait().unwrap();
    assert!(site.open(&site.path("operator.ann")).is_err());
    router.close().wait().unwrap();
    let _router = site.router();
    assert!(site.open(&site.path("operator.ann")).is_ok());
}

#[test]
fn the_router_is_believed_only_at_the_hosts_of_its_certificate() {
    let site = Site::new(&["operator.ann"]);
    let of = |host: &str| {
        site.keys.router(&[host.parse().unwrap()], 30, true).unwrap();
        let router = site.router();
        let opened = site.open(&site.path("operator.ann")).is_ok();
        router.close().wait().unwrap();
        opened
    };
    assert!(!of("192.0.2.1"));
    assert!(of("127.0.0.1"));
}

#[test]
fn a_router_without_a_list_lets_nobody_do_anything() {
    let site = Site::new(&[]);
    let _router = site.router();
    // Signed by the authority, unknown to the list.
    let now = OffsetDateTime::now_utc();
    let issued = party_certificate(&site.path(""), "operator.ann", now - Duration::DAY, now + Duration::DAY);
    let folder = tempfile::tempdir().unwrap();
    let other = Site::new(&["operator.ann"]);
    for file in fs::read_dir(other.path("operator.ann")).unwrap().flatten() {
        fs::copy(file.path(), folder.path().join(file.file_name())).unwrap();
    }
    put(folder.path(), &issued);
    fs::copy(site.path("authority.pem"), folder.path().join("ca.pem")).unwrap();
    let session = site.open(folder.path()).unwrap();
    let heard = super::site::Heard::of(&session, "plumbline/v1/**");
    assert_eq!(super::site::ask_alive(&session, "plumbline/v1/*/@live/**"), Vec::<String>::new());
    assert_eq!(super::site::ask(&session, "plumbline/v1/alpha/attitude"), Vec::<String>::new());
    assert_eq!(heard.all(), Vec::<String>::new());
}

/// A certificate of the site's authority with any validity.
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

fn put(folder: &Path, issued: &IssuedCertificate) {
    fs::write(folder.join("cert.pem"), &issued.certificate).unwrap();
    fs::write(folder.join("key.pem"), &issued.key).unwrap();
}
