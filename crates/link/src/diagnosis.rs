//! Finds out why an endpoint is unreachable, by trying again and explaining the error.

use std::net::TcpStream;

use foreign::ForeignText;
use zenoh::Wait;

use crate::{Endpoints, admission::MAX_SESSIONS, endpoints::is_secured};

/// Timeout of a connection attempt, ms.
const ATTEMPT_TIMEOUT_MS: &str = "3000";

/// Tries to connect to each endpoint and describes the results, one per line.
pub(crate) fn diagnose(endpoints: &Endpoints) -> String {
    let found = endpoints.connect.iter().map(|endpoint| format!("{endpoint}: {}", attempt(endpoints, endpoint)));
    found.collect::<Vec<_>>().join("\n")
}

/// Returns `true` if an unencrypted endpoint accepts TCP connections, even if it opens no session.
pub(crate) fn is_port_open(endpoints: &Endpoints) -> bool {
    let addresses = endpoints.connect.iter().filter_map(|endpoint| endpoint.strip_prefix("tcp/"));
    addresses.into_iter().any(|address| TcpStream::connect(address).is_ok())
}

fn attempt(endpoints: &Endpoints, endpoint: &str) -> String {
    // The attempt uses a peer session, because a client session reports that it failed but not why.
    let endpoints = Endpoints { connect: vec![endpoint.into()], client: false, ..endpoints.connect_only() };
    let settings = [
        ("connect/timeout_ms", "0"),
        ("connect/exit_on_failure", "true"),
        ("transport/unicast/open_timeout", ATTEMPT_TIMEOUT_MS),
    ];
    let config = endpoints.config().and_then(|mut config| {
        let set = |(what, value)| config.insert_json5(what, value);
        match settings.into_iter().try_for_each(set) {
            Ok(()) => Ok(config),
            Err(cause) => {
                Err(crate::error::LinkError::Config { what: "the connection attempt", cause: cause.to_string().into() })
            }
        }
    });
    match config.map(|config| zenoh::open(config).wait()) {
        Ok(Ok(session)) => {
            // A session that cannot be closed ends with the process.
            let _ = session.close().wait();
            "it is reachable now; try again".into()
        }
        Ok(Err(cause)) => explain(endpoint, &cause.to_string()),
        Err(error) => error.to_string(),
    }
}

/// Explains an error of Zenoh or of its TLS library.
fn explain(endpoint: &str, cause: &str) -> String {
    let known = [
        ("Connection refused", "no process listens there; `plumb ps` on board shows where the gateway listens"),
        ("UnknownIssuer", "its certificate was issued by another authority than these keys"),
        // This error occurs if the certificate was issued by another authority with the same name
        // as this program's authority.
        ("BadSignature", "its certificate was issued by another authority than these keys"),
        (
            "NotValidForName",
            "its certificate is not valid for this address; create one with `plumb keys vehicle NAME --host HOST --force`",
        ),
        ("Expired", "its certificate has expired; `plumb keys check` on the authority's machine shows which"),
        ("CertificateExpired", "it reports that the certificate of these keys has expired; check its clock"),
        ("UnknownCA", "it does not know the authority of these keys"),
        ("CertificateRequired", "it requires a certificate; specify the folder with --keys"),
        ("failed to lookup address", "the host name is unknown"),
        ("unreachable", "there is no route to this address"),
    ];
    if let Some((_, meaning)) = known.into_iter().find(|(word, _)| cause.contains(word)) {
        return meaning.into();
    }
    if cause.contains("close message") {
        return format!("it accepts at most {MAX_SESSIONS} sessions and all are in use; try again later");
    }
    if !is_secured(endpoint) {
        return "the port accepts connections but does not respond: either too many connections are waiting (idle ones are closed after 3 s; try again), or it is not a gateway".into();
    }
    // Zenoh appends its source location to the message.
    let cause = cause.split(" at /").next().unwrap_or_default();
    format!(
        "no response; check that a gateway or router listens there, that the firewall lets UDP through and that its keys come from the same authority ({})",
        ForeignText::from(cause)
    )
}
