//! Protection of the server against requests from foreign web pages.
//!
//! A foreign page open in the same browser can send requests to the loopback interface, even under
//! its own host name if that name resolves to the interface (DNS rebinding). It cannot, however,
//! set the headers `Host`, `Origin` and `Sec-Fetch-Site`. Requests are therefore accepted only if
//! their host is a loopback name and they come either from the cockpit's own page or from no page
//! at all. At [`FOXGLOVE_PATH`] the origins listed in the launch file are accepted as well. With
//! TLS the certificate identifies the server, so any `Host` is accepted.

use std::sync::Arc;

use axum::{
    body::Body,
    extract::{Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header},
    middleware::Next,
    response::{IntoResponse, Response},
};

/// Path of the WebSocket for Foxglove clients.
pub(crate) const FOXGLOVE_PATH: &str = "/foxglove";
/// Host names of the loopback interface.
const LOOPBACK_NAMES: [&str; 3] = ["127.0.0.1", "localhost", "[::1]"];

/// Response headers that restrict the page in the browser. The page may load only its own
/// resources, and may not be shown in a frame.
const SECURITY_HEADERS: [(&str, &str); 8] = [
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'; trusted-types 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-resource-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
    ("permissions-policy", "camera=(), geolocation=(), microphone=(), usb=(), serial=()"),
    ("cache-control", "no-cache"),
];

/// Configuration of the request checks.
#[derive(Debug)]
pub(crate) struct AccessRules {
    /// Additional origins accepted at [`FOXGLOVE_PATH`].
    pub(crate) foxglove_origins: Vec<String>,
    /// `true` if connections use TLS.
    pub(crate) uses_tls: bool,
}

/// Rejects requests that fail the checks and adds [`SECURITY_HEADERS`] to every response.
pub(crate) async fn check_origin(State(rules): State<Arc<AccessRules>>, request: Request, next: Next) -> Response {
    let mut response = match check_request(request.method(), request.uri(), request.headers(), &rules) {
        Ok(()) => next.run(request).await,
        // A rejected client must not occupy one of the limited connections.
        Err((status, message)) => (status, [(header::CONNECTION, "close")], message).into_response(),
    };
    for (name, value) in SECURITY_HEADERS {
        response.headers_mut().insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    }
    response.map(Body::new)
}

type Rejection = (StatusCode, &'static str);
const FOREIGN_ORIGIN: Rejection = (StatusCode::FORBIDDEN, "requests from other origins are rejected\n");

fn check_request(method: &Method, uri: &Uri, headers: &HeaderMap, rules: &AccessRules) -> Result<(), Rejection> {
    if ![Method::GET, Method::HEAD].contains(method) {
        return Err((StatusCode::METHOD_NOT_ALLOWED, "method not allowed; use GET or HEAD\n"));
    }
    let wrong_host = (StatusCode::MISDIRECTED_REQUEST, "invalid Host header; expected 127.0.0.1, localhost or [::1]\n");
    let mut hosts = headers.get_all(header::HOST).iter();
    let (Some(host), None) = (hosts.next().and_then(|host| host.to_str().ok()), hosts.next()) else {
        return Err(wrong_host);
    };
    let hosts = [Some(host), uri.authority().map(|authority| authority.as_str())];
    if !rules.uses_tls && !hosts.into_iter().flatten().all(is_loopback) {
        return Err(wrong_host);
    }
    let scheme: &[u8] = if rules.uses_tls { b"https://" } else { b"http://" };
    let is_own_origin = |origin: &HeaderValue| origin.as_bytes().strip_prefix(scheme) == Some(host.as_bytes());
    let is_listed_origin = |origin: &HeaderValue| {
        uri.path() == FOXGLOVE_PATH
            && rules.foxglove_origins.iter().any(|listed| listed.as_bytes() == origin.as_bytes())
    };
    if !headers.get_all(header::ORIGIN).iter().all(|origin| is_own_origin(origin) || is_listed_origin(origin)) {
        return Err(FOREIGN_ORIGIN);
    }
    // Requests for images and scripts have no `Origin`; for these, browsers set `Sec-Fetch-Site`.
    let has_value = |name: &str, words: &[&str]| {
        headers.get_all(name).iter().any(|value| words.iter().any(|word| value.as_bytes() == word.as_bytes()))
    };
    let is_cross_site = has_value("sec-fetch-site", &["cross-site", "same-site"]);
    let is_page_navigation =
        uri.path() == "/" && has_value("sec-fetch-mode", &["navigate"]) && has_value("sec-fetch-dest", &["document"]);
    if is_cross_site && !is_page_navigation && !headers.get_all(header::ORIGIN).iter().any(is_listed_origin) {
        return Err(FOREIGN_ORIGIN);
    }
    Ok(())
}

/// Returns `true` for a loopback name, with or without a port.
fn is_loopback(host: &str) -> bool {
    let is_port = |port: &str| !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit());
    LOOPBACK_NAMES.iter().any(|name| {
        host.get(..name.len()).is_some_and(|prefix| prefix.eq_ignore_ascii_case(name))
            && match &host[name.len()..] {
                "" => true,
                rest => rest.strip_prefix(':').is_some_and(is_port),
            }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(method: Method, uri: &str, headers: &[(&str, &str)]) -> u16 {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            map.append(HeaderName::try_from(*name).unwrap(), HeaderValue::from_str(value).unwrap());
        }
        let rules = AccessRules { foxglove_origins: vec!["https://app.foxglove.dev".into()], uses_tls: false };
        check_request(&method, &uri.parse().unwrap(), &map, &rules).map_or_else(|(status, _)| status.as_u16(), |()| 200)
    }

    #[test]
    fn only_loopback_host_names_are_accepted() {
        for host in ["127.0.0.1:8088", "localhost:9", "LOCALHOST", "[::1]:8088", "127.0.0.1"] {
            assert_eq!(status(Method::GET, "/", &[("host", host)]), 200, "{host}");
        }
        for host in [
            "attacker.example:8088",
            "127.0.0.1.attacker.example:8088",
            "localhost.attacker.example",
            "127.0.0.1:8088@attacker.example",
            "127.0.0.1:",
            "0.0.0.0:8088",
            "192.168.1.5:8088",
            "",
        ] {
            assert_eq!(status(Method::GET, "/", &[("host", host)]), 421, "{host}");
        }
        assert_eq!(status(Method::GET, "/", &[]), 421);
        assert_eq!(status(Method::GET, "/", &[("host", "localhost"), ("host", "attacker.example")]), 421);
        assert_eq!(status(Method::GET, "http://attacker.example/", &[("host", "localhost")]), 421);
    }

    #[test]
    fn tls_accepts_any_host_but_only_own_origin() {
        let status = |origin: &str| {
            let mut map = HeaderMap::new();
            map.insert("host", HeaderValue::from_static("alpha.example:8088"));
            map.insert("origin", HeaderValue::from_str(origin).unwrap());
            let rules = AccessRules { foxglove_origins: Vec::new(), uses_tls: true };
            check_request(&Method::GET, &Uri::from_static("/socket"), &map, &rules)
                .map_or_else(|(status, _)| status.as_u16(), |()| 200)
        };
        assert_eq!(status("https://alpha.example:8088"), 200);
        for origin in ["http://alpha.example:8088", "https://alpha.example", "https://other.example:8088", "null"] {
            assert_eq!(status(origin), 403, "{origin}");
        }
    }

    #[test]
    fn foreign_origins_and_other_methods_are_rejected() {
        let host = ("host", "localhost:8088");
        assert_eq!(status(Method::GET, "/socket", &[host, ("origin", "http://localhost:8088")]), 200);
        for origin in [
            "http://attacker.example",
            "http://localhost:8089",
            "https://localhost:8088",
            "http://127.0.0.1:8088",
            "null",
            "",
        ] {
            assert_eq!(status(Method::GET, "/socket", &[host, ("origin", origin)]), 403, "{origin}");
        }
        let named = ("origin", "https://app.foxglove.dev");
        assert_eq!(status(Method::GET, "/foxglove", &[host, named]), 200);
        for (path, origin) in [
            ("/", named.1),
            ("/socket", named.1),
            ("/metrics", named.1),
            ("/foxglove/", named.1),
            ("/foxglove", "https://app.foxglove.dev.evil.example"),
            ("/foxglove", "http://app.foxglove.dev"),
            ("/foxglove", "null"),
        ] {
            assert_eq!(status(Method::GET, path, &[host, ("origin", origin)]), 403, "{path}, {origin}");
        }
        assert_eq!(status(Method::GET, "/foxglove", &[host, named, ("origin", "http://attacker.example")]), 403);
        assert_eq!(status(Method::GET, "/foxglove", &[("host", "attacker.example"), named]), 421);
        assert_eq!(status(Method::POST, "/", &[host]), 405);
        assert_eq!(status(Method::OPTIONS, "/", &[host]), 405);
    }

    #[test]
    fn cross_site_requests_are_rejected_except_page_navigation() {
        let host = ("host", "localhost:8088");
        for site in ["cross-site", "same-site"] {
            let status_from_site = |uri: &str, headers: &[(&str, &str)]| {
                status(Method::GET, uri, &[&[host, ("sec-fetch-site", site)], headers].concat())
            };
            let navigation = [("sec-fetch-mode", "navigate"), ("sec-fetch-dest", "document")];
            assert_eq!(
                status_from_site("/metrics?vehicle=x1", &[("sec-fetch-mode", "no-cors"), ("sec-fetch-dest", "image")]),
                403
            );
            assert_eq!(status_from_site("/", &[("sec-fetch-mode", "navigate"), ("sec-fetch-dest", "iframe")]), 403);
            assert_eq!(status_from_site("/metrics", &navigation), 403);
            assert_eq!(status_from_site("/", &navigation), 200);
            assert_eq!(status_from_site("/?vehicle=boat", &navigation), 200);
            let viewer = ("origin", "https://app.foxglove.dev");
            assert_eq!(status_from_site("/foxglove", &[viewer, ("sec-fetch-mode", "websocket")]), 200);
        }
        for site in ["same-origin", "none"] {
            assert_eq!(status(Method::GET, "/metrics", &[host, ("sec-fetch-site", site)]), 200);
        }
    }
}
