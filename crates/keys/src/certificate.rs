//! The authority, and what it signs.
//!
//! Keys are ECDSA on P-256. A certificate serves at the hosts it names and nowhere else; one that names none is for connecting only, so
//! nobody who holds one can pose as the router. Certificates begin a day early, for clocks that are behind.

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};
use x509_parser::{certificate::X509Certificate, extensions::GeneralName, pem::parse_x509_pem};

use crate::{Host, KeysError, Party};

/// How long the authority lives, days.
pub const AUTHORITY_DAYS: u32 = 3650;
/// How long a certificate lives unless told otherwise, days.
pub const DAYS: u32 = 365;
/// How far a clock may be behind.
const CLOCK_BEHIND: Duration = Duration::DAY;

/// A certificate and its private key, as PEM.
#[derive(Clone)]
pub struct Issued {
    /// The certificate.
    pub certificate: String,
    /// The private key (PKCS #8).
    pub key: String,
}

/// Who signs.
pub struct Authority {
    issuer: Issuer<'static, KeyPair>,
    /// Its certificate, as PEM: what everybody trusts.
    certificate: String,
}

impl Authority {
    /// A new authority, and what to keep of it.
    pub fn new() -> Result<(Self, Issued), KeysError> {
        Self::make().map_err(|cause| KeysError::Certificate { subject: "the authority".into(), cause })
    }

    fn make() -> Result<(Self, Issued), rcgen::Error> {
        let mut params = valid_for("plumbline authority", AUTHORITY_DAYS);
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let pair = KeyPair::generate()?;
        let certificate = params.self_signed(&pair)?.pem();
        let issued = Issued { certificate: certificate.clone(), key: pair.serialize_pem() };
        Ok((Self { issuer: Issuer::new(params, pair), certificate }, issued))
    }

    /// The authority that was kept.
    pub fn from_pem(kept: &Issued) -> Result<Self, rcgen::Error> {
        let pair = KeyPair::from_pem(&kept.key)?;
        let issuer = Issuer::from_ca_cert_pem(&kept.certificate, pair)?;
        Ok(Self { issuer, certificate: kept.certificate.clone() })
    }

    /// Its certificate, as PEM.
    pub fn certificate(&self) -> &str {
        &self.certificate
    }

    /// A certificate with which a party connects, and listens at `hosts` if there are any.
    pub fn party(&self, party: &Party, hosts: &[Host], days: u32) -> Result<Issued, KeysError> {
        self.issue(&party.to_string(), Some(ExtendedKeyUsagePurpose::ClientAuth), hosts, days)
    }

    /// The certificate with which the router is found at `hosts`.
    pub fn router(&self, hosts: &[Host], days: u32) -> Result<Issued, KeysError> {
        self.issue("router", None, hosts, days)
    }

    fn issue(
        &self,
        common_name: &str,
        usage: Option<ExtendedKeyUsagePurpose>,
        hosts: &[Host],
        days: u32,
    ) -> Result<Issued, KeysError> {
        if !(1..=AUTHORITY_DAYS).contains(&days) {
            return Err(KeysError::Validity { days, max: AUTHORITY_DAYS });
        }
        let failed = |cause| KeysError::Certificate { subject: common_name.into(), cause };
        let mut params = valid_for(common_name, days);
        let serves = Some(ExtendedKeyUsagePurpose::ServerAuth).filter(|_| !hosts.is_empty());
        params.extended_key_usages = usage.into_iter().chain(serves).collect();
        let names: Vec<String> = hosts.iter().map(|host| host.as_str().into()).collect();
        params.subject_alt_names = CertificateParams::new(names).map_err(failed)?.subject_alt_names;
        self.sign(params).map_err(failed)
    }

    fn sign(&self, mut params: CertificateParams) -> Result<Issued, rcgen::Error> {
        params.use_authority_key_identifier_extension = true;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        let pair = KeyPair::generate()?;
        let certificate = params.signed_by(&pair, &self.issuer)?.pem();
        Ok(Issued { certificate, key: pair.serialize_pem() })
    }
}

/// What a certificate says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Contents {
    /// Whose it is.
    pub common_name: String,
    /// The begin of its validity.
    pub from: OffsetDateTime,
    /// The end of its validity.
    pub until: OffsetDateTime,
    /// Where it may serve.
    pub hosts: Vec<Host>,
}

impl Contents {
    /// Reads a certificate in PEM; what is wrong with it otherwise.
    pub fn read(pem: &str) -> Result<Self, String> {
        let (_, pem) = parse_x509_pem(pem.as_bytes()).map_err(|cause| cause.to_string())?;
        let certificate = pem.parse_x509().map_err(|cause| cause.to_string())?;
        let common_name = certificate.subject().iter_common_name().next().and_then(|name| name.as_str().ok());
        Ok(Self {
            common_name: common_name.ok_or("it names nobody")?.into(),
            from: certificate.validity().not_before.to_datetime(),
            until: certificate.validity().not_after.to_datetime(),
            hosts: hosts(&certificate)?,
        })
    }
}

fn hosts(certificate: &X509Certificate<'_>) -> Result<Vec<Host>, String> {
    let names = certificate.subject_alternative_name().map_err(|cause| cause.to_string())?;
    let names = names.map_or(&[][..], |names| &names.value.general_names);
    let host = |name: &GeneralName<'_>| match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(octets) => {
            <[u8; 4]>::try_from(*octets).ok().map(|octets| std::net::Ipv4Addr::from(octets).to_string())
        }
        _ => None,
    };
    names.iter().filter_map(host).map(|name| name.parse().map_err(|cause: KeysError| cause.to_string())).collect()
}

fn valid_for(common_name: &str, days: u32) -> CertificateParams {
    let mut params = CertificateParams::default();
    let now = OffsetDateTime::now_utc();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, common_name);
    params.not_before = now - CLOCK_BEHIND;
    params.not_after = now + Duration::days(i64::from(days));
    params
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Role;

    #[test]
    fn a_certificate_tells_whose_it_is_how_long_and_where() {
        let (authority, kept) = Authority::new().unwrap();
        let party = Party::new(Role::Vehicle, "alpha").unwrap();
        let contents = Contents::read(&authority.party(&party, &[], 10).unwrap().certificate).unwrap();
        assert_eq!(contents.common_name, "vehicle.alpha");
        assert_eq!((contents.until - OffsetDateTime::now_utc()).whole_hours(), 239);
        assert_eq!(contents.hosts, []);

        let hosts: Vec<Host> = ["127.0.0.1", "10.0.0.1", "router.example.net"].map(|host| host.parse().unwrap()).into();
        let again = Authority::from_pem(&kept).unwrap();
        let contents = Contents::read(&again.router(&hosts, 10).unwrap().certificate).unwrap();
        assert_eq!((contents.common_name.as_str(), contents.hosts), ("router", hosts));
    }

    #[test]
    fn a_certificate_that_ends_at_once_or_outlives_its_authority_is_refused() {
        let (authority, _) = Authority::new().unwrap();
        let party = Party::new(Role::Viewer, "a").unwrap();
        for days in [0, AUTHORITY_DAYS + 1, u32::MAX] {
            assert!(matches!(authority.party(&party, &[], days), Err(KeysError::Validity { .. })), "{days}");
        }
    }

    #[test]
    fn what_is_no_certificate_is_refused() {
        let (_, kept) = Authority::new().unwrap();
        for text in ["", "no PEM", &kept.key, &kept.certificate[..100]] {
            assert!(Contents::read(text).is_err(), "{text}");
        }
        assert!(Authority::from_pem(&Issued { key: kept.certificate.clone(), ..kept }).is_err());
    }
}
