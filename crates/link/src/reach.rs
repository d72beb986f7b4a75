//! Why somebody could not be reached: one more attempt, whose error is put into words with what to do.

use std::net::TcpStream;

use zenoh::Wait;

use crate::{Endpoints, endpoints::is_secured, guard::SESSIONS_MAX};

/// How long the attempt may take, ms.
const ATTEMPT_LIMIT_MS: &str = "3000";

/// What is found at each endpoint, for people.
pub(crate) fn why(endpoints: &Endpoints) -> String {
    let found = endpoints.connect.iter().map(|endpoint| format!("{endpoint}: {}", attempt(endpoints, endpoint)));
    found.collect::<Vec<_>>().join("\n")
}

/// Somebody takes a connection at one of the plain endpoints, though there may be no session yet.
pub(crate) fn is_somebody_there(endpoints: &Endpoints) -> bool {
    let addresses = endpoints.connect.iter().filter_map(|endpoint| endpoint.strip_prefix("tcp/"));
    addresses.into_iter().any(|address| TcpStream::connect(address).is_ok())
}

fn attempt(endpoints: &Endpoints, endpoint: &str) -> String {
    // A peer is told why, a client only that it was not let in.
    let endpoints = Endpoints { connect: vec![endpoint.into()], client: false, ..endpoints.calling() };
    let settings = [
        ("connect/timeout_ms", "0"),
        ("connect/exit_on_failure", "true"),
        ("transport/unicast/open_timeout", ATTEMPT_LIMIT_MS),
    ];
    let config = endpoints.config().and_then(|mut config| {
        let set = |(what, value)| config.insert_json5(what, value);
        match settings.into_iter().try_for_each(set) {
            Ok(()) => Ok(config),
            Err(cause) => Err(crate::LinkError::Config { what: "an attempt", cause: cause.to_string() }),
        }
    });
    match config.map(|config| zenoh::open(config).wait()) {
        Ok(Ok(session)) => {
            // It ends with the process if it cannot be closed.
            let _ = session.close().wait();
            "it answers now; ask again".into()
        }
        Ok(Err(cause)) => words(endpoint, &cause.to_string()),
        Err(error) => error.to_string(),
    }
}

/// What Zenoh and the TLS below it say, and what it means here.
fn words(endpoint: &str, cause: &str) -> String {
    let known = [
        ("Connection refused", "nobody listens there; `plumb ps` on board says where its gateway listens"),
        ("UnknownIssuer", "its certificate is of another authority than that of these keys"),
        // The other authority has the same name.
        ("BadSignature", "its certificate is of another authority than that of these keys"),
        (
            "NotValidForName",
            "its certificate is not for this address; `plumb keys vehicle NAME --host HOST --force` makes one that is",
        ),
        ("Expired", "its certificate has ended; `plumb keys check` where the authority is tells which"),
        ("CertificateExpired", "it says that the certificate of these keys has ended: is its clock right?"),
        ("UnknownCA", "it does not know the authority of these keys"),
        ("CertificateRequired", "it wants a certificate; --keys names the folder"),
        ("failed to lookup address", "no such host is known here"),
        ("unreachable", "there is no way to this address from here"),
    ];
    if let Some((_, meaning)) = known.into_iter().find(|(word, _)| cause.contains(word)) {
        return meaning.into();
    }
    if cause.contains("close message") {
        return format!("it lets in {SESSIONS_MAX} at once and has them; ask again when somebody has left");
    }
    if !is_secured(endpoint) {
        return "somebody takes the connection there and does not answer: either more connections wait there than it lets in at once, and those that are idle go after 3 s (ask again), or it is no gateway".into();
    }
    // After the words comes the place in Zenoh's source.
    let cause = cause.split(" at /").next().unwrap_or_default();
    format!(
        "no answer; does a gateway or a router listen there, does a firewall let UDP through to it, and do its keys come from the same authority? ({cause})"
    )
}
