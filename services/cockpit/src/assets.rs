//! Files of the page, built into the executable.
//!
//! Input: the path and the headers of a request.
//! Output: the file without comments, with its entity tag, compressed if the client accepts gzip.
//! Failure: an unknown path is answered with 404.

use std::{collections::HashMap, io::Write as _};

use axum::{
    body::{Body, Bytes},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::Response,
};
use flate2::{Compression, write::GzEncoder};
use launch::{Launch, Slot};
use messages::Flags;
use serde_json::{Map, Value, json};

macro_rules! page_files {
    ($($name:literal)*) => { &[$(($name, include_str!(concat!("../page/", $name)))),*] };
}

/// Names and contents of the page's files, sorted by name.
const FILES: &[(&str, &str)] = page_files! {
    "attitude.js" "bodies.js" "calibration.js" "data.js" "fleet.js" "fly.js" "icon.svg" "index.html" "load.js" "main.js" "method.js" "mounting.js" "parameters.js"
    "scene.js" "sensors.js" "strips.js" "style.css" "system.js" "timeline.js" "ui.js" "wire.js"
};

/// Files of the page by name.
#[derive(Debug)]
pub(crate) struct PageFiles(HashMap<&'static str, Asset>);

#[derive(Debug)]
struct Asset {
    kind: &'static str,
    tag: HeaderValue,
    plain: Bytes,
    gzip: Option<Bytes>,
}

impl PageFiles {
    /// Loads every file and adds `schema.json`, the protobuf schema for the page's decoder.
    pub(crate) fn new() -> Self {
        let files = FILES.iter().map(|(name, text)| (*name, without_comments(name, text).into()));
        let schema = ("schema.json", Bytes::from(schema().to_string()));
        Self(files.chain([schema]).map(|(name, bytes)| (name, Asset::new(name, bytes))).collect())
    }

    /// Returns the response to a request for `path`: the file, 304 if the client has it, or 404.
    pub(crate) fn respond(&self, path: &str, headers: &HeaderMap) -> Response {
        let name = path.trim_start_matches('/');
        let Some(asset) = self.0.get(if name.is_empty() { "index.html" } else { name }) else {
            return response(StatusCode::NOT_FOUND, Body::from("file not found\n"));
        };
        let header_contains = |name, text: &str| {
            headers.get_all(name).iter().any(|value| value.to_str().is_ok_and(|value| value.contains(text)))
        };
        let is_cached = asset.tag.to_str().is_ok_and(|tag| header_contains(header::IF_NONE_MATCH, tag));
        let compressed = asset.gzip.clone().filter(|_| header_contains(header::ACCEPT_ENCODING, "gzip"));
        let mut reply = match &compressed {
            _ if is_cached => response(StatusCode::NOT_MODIFIED, Body::empty()),
            Some(gzip) => response(StatusCode::OK, Body::from(gzip.clone())),
            None => response(StatusCode::OK, Body::from(asset.plain.clone())),
        };
        let fields = reply.headers_mut();
        fields.insert(header::ETAG, asset.tag.clone());
        fields.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
        fields.insert(header::CONTENT_TYPE, HeaderValue::from_static(asset.kind));
        if compressed.is_some() && !is_cached {
            fields.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        }
        reply
    }
}

impl Asset {
    fn new(name: &str, bytes: Bytes) -> Self {
        let kind = match name.rsplit_once('.').map(|(_, extension)| extension) {
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
        Self { kind, tag: etag(&bytes), plain: bytes, gzip }
    }
}

/// Returns a script or a style sheet without its `/* */` comments and its lines of `//` comments.
/// Other files are returned unchanged. The page's files have no other comments and contain `/*` and
/// `*/` only in comments. Line breaks are kept, so that error messages have the line numbers of the
/// source.
fn without_comments(name: &str, text: &str) -> String {
    if !name.ends_with(".js") && !name.ends_with(".css") {
        return text.into();
    }
    let mut parts = text.split("/*");
    let mut code = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (comment, after) = part.split_once("*/").unwrap_or((part, ""));
        code.extend(comment.matches('\n'));
        code.push_str(after);
    }
    let lines = code.lines().map(str::trim_end);
    lines.map(|line| if line.trim_start().starts_with("//") { "" } else { line }).collect::<Vec<_>>().join("\n") + "\n"
}

/// Returns the entity tag of a file, its 64-bit FNV-1a hash. The hash need not be cryptographic,
/// because the files are part of the executable.
fn etag(bytes: &[u8]) -> HeaderValue {
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

/// Returns the schema for the page's decoder: the fields of each message by number, the value names
/// of each enum by number, the flags, and the parameters of the built-in stages by slot and stage.
fn schema() -> Value {
    let (fields, names) = wire::schema::fields_and_enum_values();
    let (mut messages, mut enums) = (Map::new(), Map::new());
    for field in fields {
        let message = messages.entry(field.message).or_insert_with(|| json!({}));
        let rule = json!([field.name, field.kind, field.is_repeated, field.has_presence]);
        message[field.number.to_string()] = rule;
    }
    for (enum_name, name, number) in names {
        enums.entry(enum_name).or_insert_with(|| json!({}))[number.to_string()] = name.into();
    }
    let flags: Vec<_> =
        Flags::NAMES.iter().map(|(flag, name)| json!([name, Flags::INFORMATIONAL.any(*flag)])).collect();
    let built_in = Launch::default();
    let parameters = |slot: Slot| {
        let stages = built_in.stage_names(slot).into_iter();
        stages.map(|stage| (stage.to_owned(), stage_parameters(slot, stage))).collect::<Map<_, _>>()
    };
    let parameters: Map<_, _> =
        Slot::ALL.into_iter().map(|slot| (slot.name().to_owned(), parameters(slot).into())).collect();
    json!({ "messages": messages, "enums": enums, "flags": flags, "parameters": parameters })
}

/// Returns name, unit, default, minimum, maximum and meaning of each parameter of a stage.
fn stage_parameters(slot: Slot, stage: &str) -> Value {
    let parameters = slot.parameters(stage).unwrap_or_default().iter();
    parameters.map(|it| json!([it.name, it.unit, it.default, it.min, it.max, it.description])).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn get(page: &PageFiles, path: &str, headers: &[(header::HeaderName, &'static str)]) -> Response {
        let headers = headers.iter().map(|(name, value)| (name.clone(), HeaderValue::from_static(value)));
        page.respond(path, &headers.collect())
    }

    #[test]
    fn cached_file_is_not_sent_again_and_others_are_compressed() {
        let page = PageFiles::new();
        for path in ["/", "/style.css", "/main.js", "/schema.json"] {
            let response = get(&page, path, &[(header::ACCEPT_ENCODING, "gzip, br")]);
            assert_eq!(response.status(), StatusCode::OK);
            assert_eq!(response.headers()["content-encoding"], "gzip", "{path}");
            let mut headers = HeaderMap::new();
            headers.insert(header::IF_NONE_MATCH, response.headers()[header::ETAG].clone());
            assert_eq!(page.respond(path, &headers).status(), StatusCode::NOT_MODIFIED);
            assert!(!get(&page, path, &[]).headers().contains_key("content-encoding"));
        }
        for path in ["/../Cargo.toml", "/nothing.js", "//etc/passwd"] {
            assert_eq!(get(&page, path, &[]).status(), StatusCode::NOT_FOUND, "{path}");
        }
    }

    #[test]
    fn comments_are_not_sent_and_code_is() {
        let script = "// Head.\n/** @type {string} */ const a = \"https://host\";\n/** Sum.\n * @param b */\n  // c\nf(a) / 2;\n";
        assert_eq!(without_comments("a.js", script), "\n const a = \"https://host\";\n\n\n\nf(a) / 2;\n");
        assert_eq!(without_comments("a.css", "/* Grey. */\na { top: 0; }\n"), "\na { top: 0; }\n");
        assert_eq!(without_comments("a.html", "<p>/* text */</p>\n"), "<p>/* text */</p>\n");
    }

    #[test]
    fn page_is_small_and_loads_nothing_external() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/page");
        let mut present: Vec<_> =
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        present.sort();
        assert_eq!(present, FILES.iter().map(|(name, _)| *name).collect::<Vec<_>>(), "FILES lists the whole folder");
        let mut total = 0;
        for (path, source) in FILES {
            let text = without_comments(path, source);
            total += text.len();
            assert_eq!(text.lines().count(), source.lines().count(), "{path}");
            let forbidden =
                ["http://", "https://", "//cdn", "innerHTML", "eval(", "document.write", "<script>", "style=\""];
            let found: Vec<_> = forbidden.iter().filter(|word| text.contains(**word)).collect();
            let is_namespace =
                path.ends_with(".svg") || text.matches("http://").count() == text.matches("http://www.w3.org/").count();
            assert!(found.is_empty() || found == [&"http://"] && is_namespace, "{path}: {found:?}");
        }
        assert!(total < 150_000, "{total} bytes");
        let sent = |asset: &Asset| asset.gzip.as_ref().unwrap_or(&asset.plain).len();
        let compressed: usize = PageFiles::new().0.values().map(sent).sum();
        println!("{total} bytes without the schema, {compressed} bytes compressed with it");
        assert!(compressed < 70_000, "{compressed} bytes");
    }
}
