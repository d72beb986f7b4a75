//! Self-contained HTML page that shows all papers of a folder, without external resources.
//!
//! Each paper writes its section to `NAME/section.html`. The index page is composed of all sections
//! found in the folder.

use std::{fs, io, path::Path};

use crate::{
    PaperError,
    paper::Paper,
    picture::{Part, Picture},
    table::escape_html,
};

/// File name of the page.
pub const INDEX_FILE: &str = "index.html";
const SECTION_FILE: &str = "section.html";
/// Maximum size of a section, bytes. This crate does not write larger sections, so a larger file is
/// rejected.
const MAX_SECTION_BYTES: u64 = 50_000_000;

const STYLE: &str = "\
body{color:#1a1a1a;background:#fff;font:15px/1.5 system-ui,sans-serif;max-width:1240px;margin:2em auto;padding:0 1em}\
h1{font-size:1.5em}h2{font-size:1.25em;margin-top:2.5em;border-top:1px solid #bbb;padding-top:1em}h3{font-size:1.05em;margin:1.6em 0 .2em}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums}th,td{padding:.2em .8em;text-align:right;border-bottom:1px solid #ddd}\
th:first-child,td:first-child{text-align:left}svg{max-width:100%;height:auto}p{max-width:60em}";

/// Writes the section of one paper.
pub(crate) fn write_section(paper: Paper, folder: &Path, parts: &[Part], svgs: &[String]) -> Result<(), PaperError> {
    let name = paper.name();
    let mut text = format!("<h2 id=\"{name}\">{}</h2>\n", escape_html(paper.title()));
    for (part, svg) in parts.iter().zip(svgs) {
        text += &format!(
            "<h3 id=\"{name}-{}\">{}</h3>\n<p>{}</p>\n",
            part.name,
            escape_html(&part.title),
            escape_html(&part.caption)
        );
        text += &match &part.picture {
            Picture::Drawing(_) | Picture::Figure(_) => svg_element(svg),
            Picture::Table(table) => table.to_html(),
        };
    }
    let path = folder.join(SECTION_FILE);
    fs::write(&path, text).map_err(|cause| PaperError::Write { path, cause })
}

/// Writes the index page from the sections found in `folder`.
pub(crate) fn write_index(folder: &Path) -> Result<(), PaperError> {
    let mut body = String::new();
    for paper in Paper::ALL {
        body += &read_section(&folder.join(paper.name()).join(SECTION_FILE))?;
    }
    let text = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/>\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\"/>\
         <meta name=\"viewport\" content=\"width=device-width\"/><title>Plumbline: the papers</title><style>{STYLE}</style></head>\n\
         <body><h1>Plumbline: the figures and tables of the four papers</h1>\n{body}</body></html>\n"
    );
    let path = folder.join(INDEX_FILE);
    fs::write(&path, text).map_err(|cause| PaperError::Write { path, cause })
}

/// Returns the text of a section; empty if its paper has not been reproduced yet.
fn read_section(path: &Path) -> Result<String, PaperError> {
    let failed = |cause| PaperError::Read { path: path.into(), cause };
    match fs::metadata(path) {
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => Ok(String::new()),
        Err(cause) => Err(failed(cause)),
        Ok(metadata) if metadata.len() > MAX_SECTION_BYTES => {
            let len = metadata.len();
            Err(failed(io::Error::other(format!("size {len} bytes exceeds the limit of {MAX_SECTION_BYTES} bytes"))))
        }
        Ok(_) => fs::read_to_string(path).map_err(failed),
    }
}

/// Returns the `svg` element of an SVG file, without the XML declaration that precedes it.
fn svg_element(svg: &str) -> String {
    let start = svg.find("<svg").unwrap_or(0);
    format!("{}\n", svg[start..].trim_end())
}
