//! The page: its files as they are, each with a tag by which a browser knows that it has it, and compressed.

use std::{collections::HashMap, io::Write as _};

use axum::{
    body::{Body, Bytes},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::Response,
};
use flate2::{Compression, write::GzEncoder};
use messages::Flags;
use serde_json::{Map, Value, json};

macro_rules! of_the_page {
    ($($name:literal)*) => { &[$(($name, include_bytes!(concat!("../page/", $name)))),*] };
}

/// By name.
const FILES: &[(&str, &[u8])] = of_the_page! {
    "attitude.js" "calibration.js" "data.js" "fleet.js" "fly.js" "icon.svg" "index.html" "look.js" "main.js" "method.js" "mounting.js" "scene.js"
    "sensors.js" "strips.js" "style.css" "system.js" "timeline.js" "wire.js"
};

/// The page.
#[derive(Debug)]
pub(crate) struct Page(HashMap<&'static str, Asset>);

#[derive(Debug)]
struct Asset {
    kind: &'static str,
    tag: HeaderValue,
    plain: Bytes,
    gzip: Option<Bytes>,
}

impl Page {
    /// Every file, and the schema that its reader of protobuf goes by.
    pub(crate) fn new() -> Self {
        let files = FILES.iter().map(|(name, bytes)| (*name, Bytes::from_static(bytes)));
        let schema = ("schema.json", Bytes::from(schema().to_string()));
        Self(files.chain([schema]).map(|(name, bytes)| (name, Asset::new(name, bytes))).collect())
    }

    /// A file, by its path in the address.
    pub(crate) fn answer(&self, path: &str, headers: &HeaderMap) -> Response {
        let name = path.trim_start_matches('/');
        let Some(asset) = self.0.get(if name.is_empty() { "index.html" } else { name }) else {
            return response(StatusCode::NOT_FOUND, Body::from("there is no such file\n"));
        };
        let is_said =
            |name, what: &str| headers.get_all(name).iter().any(|it| it.to_str().is_ok_and(|it| it.contains(what)));
        let has_it = asset.tag.to_str().is_ok_and(|tag| is_said(header::IF_NONE_MATCH, tag));
        let zipped = asset.gzip.clone().filter(|_| is_said(header::ACCEPT_ENCODING, "gzip"));
        let mut answer = match &zipped {
            _ if has_it => response(StatusCode::NOT_MODIFIED, Body::empty()),
            Some(gzip) => response(StatusCode::OK, Body::from(gzip.clone())),
            None => response(StatusCode::OK, Body::from(asset.plain.clone())),
        };
        let fields = answer.headers_mut();
        fields.insert(header::ETAG, asset.tag.clone());
        fields.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
        fields.insert(header::CONTENT_TYPE, HeaderValue::from_static(asset.kind));
        if zipped.is_some() && !has_it {
            fields.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        }
        answer
    }
}

impl Asset {
    fn new(name: &str, bytes: Bytes) -> Self {
        let kind = match name.rsplit_once('.').map(|(_, end)| end) {
            Some("html") => "text/html; charset=utf-8",
            Some("js") => "text/javascript; charset=utf-8",
            Some("css") => "text/css; charset=utf-8",
            Some("svg") => "image/svg+xml",
            Some("json") => "application/json",
            _ => "application/octet-stream",
        };
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        let gzip = encoder.write_all(&bytes).and_then(|()| encoder.finish()).ok();
        let gzip = gzip.filter(|gzip| gzip.len() < bytes.len()).map(Bytes::from);
        Self { kind, tag: tag(&bytes), plain: bytes, gzip }
    }
}

/// A tag of the bytes: FNV-1a, 64 bits. It tells files of ours apart, and nothing is trusted by it.
fn tag(bytes: &[u8]) -> HeaderValue {
    let hash = bytes
        .iter()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3));
    HeaderValue::from_str(&format!("\"{hash:016x}\"")).unwrap_or(HeaderValue::from_static("\"0\""))
}

fn response(status: StatusCode, body: Body) -> Response {
    let mut response = Response::new(body);
    *response.status_mut() = status;
    response
}

/// The schema as the page's reader goes by it: of each message the fields by their numbers, of each enum and of the flags the names.
fn schema() -> Value {
    let (fields, names) = wire::schema::rules();
    let (mut messages, mut enums) = (Map::new(), Map::new());
    for field in fields {
        let message = messages.entry(field.message).or_insert_with(|| json!({}));
        let rule = json!([field.name, field.kind, field.is_repeated, field.has_presence]);
        message[field.number.to_string()] = rule;
    }
    for (of, name, number) in names {
        enums.entry(of).or_insert_with(|| json!({}))[number.to_string()] = name.into();
    }
    let flags: Vec<_> = Flags::NAMES.iter().map(|(flag, name)| json!([name, Flags::USUAL.any(*flag)])).collect();
    json!({ "messages": messages, "enums": enums, "flags": flags })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn get(page: &Page, path: &str, headers: &[(header::HeaderName, &'static str)]) -> Response {
        let headers = headers.iter().map(|(name, value)| (name.clone(), HeaderValue::from_static(value)));
        page.answer(path, &headers.collect())
    }

    #[test]
    fn a_file_that_the_browser_has_is_not_sent_again_and_others_go_compressed() {
        let page = Page::new();
        for path in ["/", "/style.css", "/main.js", "/schema.json"] {
            let answer = get(&page, path, &[(header::ACCEPT_ENCODING, "gzip, br")]);
            assert_eq!(answer.status(), StatusCode::OK);
            assert_eq!(answer.headers()["content-encoding"], "gzip", "{path}");
            let mut headers = HeaderMap::new();
            headers.insert(header::IF_NONE_MATCH, answer.headers()[header::ETAG].clone());
            assert_eq!(page.answer(path, &headers).status(), StatusCode::NOT_MODIFIED);
            assert!(!get(&page, path, &[]).headers().contains_key("content-encoding"));
        }
        for path in ["/../Cargo.toml", "/nothing.js", "//etc/passwd"] {
            assert_eq!(get(&page, path, &[]).status(), StatusCode::NOT_FOUND, "{path}");
        }
    }

    #[test]
    fn the_page_is_small_and_its_own() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/page");
        let mut there: Vec<_> =
            fs::read_dir(folder).unwrap().map(|it| it.unwrap().file_name().into_string().unwrap()).collect();
        there.sort();
        assert_eq!(there, FILES.iter().map(|(name, _)| *name).collect::<Vec<_>>(), "every file is there");
        let mut total = 0;
        for (path, bytes) in FILES {
            total += bytes.len();
            let text = String::from_utf8_lossy(bytes);
            let outside =
                ["http://", "https://", "//cdn", "innerHTML", "eval(", "document.write", "<script>", "style=\""];
            let found: Vec<_> = outside.iter().filter(|it| text.contains(**it)).collect();
            let is_namespace =
                path.ends_with(".svg") || text.matches("http://").count() == text.matches("http://www.w3.org/").count();
            assert!(found.is_empty() || found == [&"http://"] && is_namespace, "{path}: {found:?}");
        }
        assert!(total < 150_000, "{total} bytes");
    }
}
