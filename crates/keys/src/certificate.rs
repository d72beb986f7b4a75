//! Certificate authority and the certificates it issues.
//!
//! Keys are ECDSA on P-256. A certificate is valid as a server certificate only for the hosts it
//! names. A certificate without hosts is for clients only, so its holder cannot impersonate the
//! router. Validity starts one day before the time of issue, to allow for clocks that are behind.

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};
use x509_parser::{certificate::X509Certificate, extensions::GeneralName, pem::parse_x509_pem};

use crate::{Host, KeysError, Party};

/// Validity of the authority's certificate, days.
pub const AUTHORITY_DAYS: u32 = 3650;
/// Default validity of a certificate, days.
pub const DEFAULT_DAYS: u32 = 365;
/// Time from the start of the validity to the time of issue. It allows for hosts with a slow clock.
const BACKDATING: Duration = Duration::DAY;

/// Certificate and its private key, as PEM.
#[derive(Clone)]
pub struct IssuedCertificate {
    /// Certificate.
    pub certificate: String,
    /// Private key (PKCS #8).
    pub key: String,
}

/// Certificate authority.
pub struct Authority {
    issuer: Issuer<'static, KeyPair>,
    /// Certificate of the authority, as PEM. Every party trusts it.
    certificate: String,
}

impl Authority {
    /// Creates an authority and returns it with its certificate and private key.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::CreateCertificate`] if the library cannot create the certificate.
    pub fn new() -> Result<(Self, IssuedCertificate), KeysError> {
        Self::generate().map_err(|cause| KeysError::CreateCertificate { subject: "the authority".into(), cause })
    }

    fn generate() -> Result<(Self, IssuedCertificate), rcgen::Error> {
        let mut params = params_valid_for("plumbline authority", AUTHORITY_DAYS);
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let pair = KeyPair::generate()?;
        let certificate = params.self_signed(&pair)?.pem();
        let issued = IssuedCertificate { certificate: certificate.clone(), key: pair.serialize_pem() };
        Ok((Self { issuer: Issuer::new(params, pair), certificate }, issued))
    }

    /// Restores an authority from its certificate and private key.
    ///
    /// # Errors
    ///
    /// Returns the library's error if a PEM text is malformed or has the wrong type.
    pub fn from_pem(issued: &IssuedCertificate) -> Result<Self, rcgen::Error> {
        let pair = KeyPair::from_pem(&issued.key)?;
        let issuer = Issuer::from_ca_cert_pem(&issued.certificate, pair)?;
        Ok(Self { issuer, certificate: issued.certificate.clone() })
    }

    /// Returns the authority's certificate as PEM.
    pub fn certificate(&self) -> &str {
        &self.certificate
    }

    /// Issues a client certificate to a party. If `hosts` is not empty, it is also a server
    /// certificate for these hosts.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::InvalidValidity`] if `days` is 0 or longer than the authority is valid.
    pub fn issue_party(&self, party: &Party, hosts: &[Host], days: u32) -> Result<IssuedCertificate, KeysError> {
        self.issue(&party.to_string(), Some(ExtendedKeyUsagePurpose::ClientAuth), hosts, days)
    }

    /// Issues the router's server certificate for `hosts`.
    ///
    /// # Errors
    ///
    /// Returns [`KeysError::InvalidValidity`] if `days` is 0 or longer than the authority is valid.
    pub fn issue_router(&self, hosts: &[Host], days: u32) -> Result<IssuedCertificate, KeysError> {
        self.issue("router", None, hosts, days)
    }

    fn issue(
        &self,
        common_name: &str,
        usage: Option<ExtendedKeyUsagePurpose>,
        hosts: &[Host],
        days: u32,
    ) -> Result<IssuedCertificate, KeysError> {
        if !(1..=AUTHORITY_DAYS).contains(&days) {
            return Err(KeysError::InvalidValidity { days, max: AUTHORITY_DAYS });
        }
        let failed = |cause| KeysError::CreateCertificate { subject: common_name.into(), cause };
        let mut params = params_valid_for(common_name, days);
        let serves = Some(ExtendedKeyUsagePurpose::ServerAuth).filter(|_| !hosts.is_empty());
        params.extended_key_usages = usage.into_iter().chain(serves).collect();
        let names: Vec<String> = hosts.iter().map(|host| host.as_str().into()).collect();
        params.subject_alt_names = CertificateParams::new(names).map_err(failed)?.subject_alt_names;
        self.sign(params).map_err(failed)
    }

    fn sign(&self, mut params: CertificateParams) -> Result<IssuedCertificate, rcgen::Error> {
        params.use_authority_key_identifier_extension = true;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        let pair = KeyPair::generate()?;
        let certificate = params.signed_by(&pair, &self.issuer)?.pem();
        Ok(IssuedCertificate { certificate, key: pair.serialize_pem() })
    }
}

/// Parsed contents of a certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Contents {
    /// Common name of the subject.
    pub common_name: String,
    /// Start of validity.
    pub not_before: OffsetDateTime,
    /// End of validity.
    pub not_after: OffsetDateTime,
    /// Hosts for which the certificate is valid as a server certificate.
    pub hosts: Vec<Host>,
}

impl Contents {
    /// Parses a certificate in PEM.
    ///
    /// # Errors
    ///
    /// Returns the reason if the text is not a certificate, or has no common name or an invalid
    /// host.
    pub fn from_pem(pem: &str) -> Result<Self, String> {
        let (_, pem) = parse_x509_pem(pem.as_bytes()).map_err(|cause| cause.to_string())?;
        let certificate = pem.parse_x509().map_err(|cause| cause.to_string())?;
        let common_name = certificate.subject().iter_common_name().next().and_then(|name| name.as_str().ok());
        Ok(Self {
            common_name: common_name.ok_or("the certificate has no common name")?.into(),
            not_before: certificate.validity().not_before.to_datetime(),
            not_after: certificate.validity().not_after.to_datetime(),
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

fn params_valid_for(common_name: &str, days: u32) -> CertificateParams {
    let mut params = CertificateParams::default();
    let now = OffsetDateTime::now_utc();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, common_name);
    params.not_before = now - BACKDATING;
    params.not_after = now + Duration::days(i64::from(days));
    params
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Role;

    #[test]
    fn certificate_contains_name_validity_and_hosts() {
        let (authority, issued) = Authority::new().unwrap();
        let party = Party::new(Role::Vehicle, "alpha").unwrap();
        let contents = Contents::from_pem(&authority.issue_party(&party, &[], 10).unwrap().certificate).unwrap();
        assert_eq!(contents.common_name, "vehicle.alpha");
        assert_eq!((contents.not_after - OffsetDateTime::now_utc()).whole_hours(), 239);
        assert_eq!(contents.hosts, []);

        let hosts: Vec<Host> = ["127.0.0.1", "10.0.0.1", "router.example.net"].map(|host| host.parse().unwrap()).into();
        let reloaded = Authority::from_pem(&issued).unwrap();
        let contents = Contents::from_pem(&reloaded.issue_router(&hosts, 10).unwrap().certificate).unwrap();
        assert_eq!((contents.common_name.as_str(), contents.hosts), ("router", hosts));
    }

    #[test]
    fn validity_of_zero_or_beyond_authority_is_rejected() {
        let (authority, _) = Authority::new().unwrap();
        let party = Party::new(Role::Viewer, "a").unwrap();
        for days in [0, AUTHORITY_DAYS + 1, u32::MAX] {
            assert!(
                matches!(authority.issue_party(&party, &[], days), Err(KeysError::InvalidValidity { .. })),
                "{days}"
            );
        }
    }

    #[test]
    fn malformed_pem_is_rejected() {
        let (_, issued) = Authority::new().unwrap();
        for text in ["", "no PEM", &issued.key, &issued.certificate[..100]] {
            assert!(Contents::from_pem(text).is_err(), "{text}");
        }
        assert!(Authority::from_pem(&IssuedCertificate { key: issued.certificate.clone(), ..issued }).is_err());
    }
}
