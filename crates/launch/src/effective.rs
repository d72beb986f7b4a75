//! The effective launch file: every key with its value, whether given or default.

use toml_edit::{DocumentMut, Item, TableLike, TomlError, Value};

use crate::{Ingest, SectionDescription, Source, describe, keys::Named as _};

/// Section with one table for each user-defined stage.
const STAGES: &str = "stages";
/// Section of the receiver, which exists only if the file contains it.
const RECEIVER: &str = "ingest.receiver";
/// Comment on values that the file does not set.
const DEFAULT: &str = "# default";

/// Returns the launch file `text` with the default of every key that it does not set.
///
/// The result has the same meaning as `text`, which must be valid. Sections of sources that are not
/// used are left out, unless `text` contains them. Relative paths remain relative.
///
/// # Errors
///
/// Returns an error if `text` is not TOML.
pub fn effective_text(text: &str) -> Result<String, TomlError> {
    let document: DocumentMut = text.parse()?;
    let root: &dyn TableLike = document.as_table();
    let source = source(root);
    let is_unused = |path: &str| {
        if path == RECEIVER {
            return true;
        }
        let name = path.strip_prefix("ingest.").and_then(|rest| rest.split('.').next());
        name.is_some_and(|name| name != source && Source::NAMES.iter().any(|(other, _)| *other == name))
    };
    let mut blocks = Vec::new();
    for section in describe() {
        let item = section
            .path
            .split('.')
            .filter(|name| !name.is_empty())
            .try_fold(None::<&Item>, |at, name| at.map_or(Some(root), Item::as_table_like)?.get(name).map(Some));
        let header = format!("[{}]", section.path);
        if section.is_array {
            let tables = tables(item.flatten());
            blocks.extend(tables.into_iter().map(|table| block(&format!("[{header}]"), lines(&section, Some(table)))));
        } else if section.path.split_once('.').is_some_and(|(parent, _)| parent == STAGES) {
            let stages = root.get(STAGES).and_then(Item::as_table_like);
            let stages = stages.into_iter().flat_map(TableLike::iter);
            blocks.extend(
                stages
                    .map(|(name, stage)| block(&format!("[{STAGES}.{name}]"), lines(&section, stage.as_table_like()))),
            );
        } else if section.path.is_empty() {
            blocks.push(lines(&section, Some(root)).join("\n"));
        } else {
            let table = item.flatten().and_then(Item::as_table_like);
            if table.is_some() || !(section.is_optional || is_unused(&section.path)) {
                blocks.push(block(&header, lines(&section, table)));
            }
        }
    }
    blocks.retain(|block| !block.is_empty());
    Ok(blocks.join("\n\n"))
}

/// Returns the name of the source that the file selects.
fn source(root: &dyn TableLike) -> String {
    let ingest = root.get("ingest").and_then(Item::as_table_like);
    let given = ingest.and_then(|ingest| ingest.get("source")?.as_str());
    given.map_or_else(|| Ingest::default().source.name().into(), str::to_owned)
}

/// Returns the tables of an array, which is written as sections or inline.
fn tables(item: Option<&Item>) -> Vec<&dyn TableLike> {
    match item {
        Some(Item::ArrayOfTables(tables)) => tables.iter().map(|table| table as &dyn TableLike).collect(),
        Some(Item::Value(Value::Array(array))) => {
            array.iter().filter_map(|value| Some(value.as_inline_table()? as &dyn TableLike)).collect()
        }
        _ => Vec::new(),
    }
}

/// Returns the text of a section, or an empty string if the section has no keys.
fn block(header: &str, lines: Vec<String>) -> String {
    if lines.is_empty() { String::new() } else { format!("{header}\n{}", lines.join("\n")) }
}

/// Returns a line for each key of a section that has a value.
fn lines(section: &SectionDescription, table: Option<&dyn TableLike>) -> Vec<String> {
    let mut values: Vec<(String, String)> = Vec::new();
    let mut lines = Vec::new();
    for key in &section.keys {
        let is_allowed = key.conditions.is_empty()
            || key
                .conditions
                .iter()
                .any(|condition| values.iter().any(|(name, value)| *condition == format!("{name} = {value}")));
        // Several settings may allow the same key, each with its own description. The key gets only
        // one line.
        if values.iter().any(|(name, _)| *name == key.name) {
            continue;
        }
        let given = table.and_then(|table| table.get(&key.name)).and_then(value);
        let (value, comment) = match (given, &key.default) {
            (Some(given), _) => (given, String::new()),
            (None, Some(default)) if is_allowed => (default.clone(), format!("  {DEFAULT}")),
            _ => continue,
        };
        lines.push(format!("{} = {value}{comment}", key.name));
        values.push((key.name.clone(), value));
    }
    lines
}

/// Returns the value of a key on one line, or `None` for a section.
fn value(item: &Item) -> Option<String> {
    let mut value = item.clone().into_value().ok()?;
    if let Some(text) = value.as_str() {
        return Some(format!("{text:?}"));
    }
    value.decor_mut().clear();
    if let Value::Array(array) = &mut value {
        array.fmt();
    }
    Some(value.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

    const FILES: [&str; 6] = [
        "",
        "name = 'boat'\nbuffer_s = 3\n[ingest]\nsource = \"serial\"\n[ingest.serial]\nport = \"/dev/ttyUSB0\"\nformat = \"witmotion\"\nrate_hz = 200\n",
        "ingest = { source = \"sim\", sim.scenario = \"tumble\", sim.seed = 7 }\n[fuser]\nstage = \"wz-closed\"\nset = { time_constant_s = 2.0 } # mine\n",
        "faults = true\n[[ingest.fault]]\nkind = \"slow\"\nsensor = \"mag\"\nevery = 7\nfrom_s = 1\nuntil_s = 2\n",
        "[stages.mine]\nslot = \"fuser\"\ncommand = [\n  \"python3\", # here\n  \"mine.py\",\n]\n[fuser]\nstage = \"mine\"\n[fuser.set]\ngain = 2\n",
        "[[watch]]\nstage = \"aided\"\npromote_below_deg = 0.5\nrollback_above_deg = 2\n[gateway]\nvehicle = \"alpha\"\n[course]\nnorth = \"magnetic\"\n",
    ];

    #[test]
    fn effective_file_has_the_same_meaning() {
        for text in FILES {
            let launch = Launch::parse("x", text).unwrap_or_else(|problems| panic!("{problems}"));
            let effective = effective_text(text).unwrap();
            let parsed = Launch::parse("x", &effective).unwrap_or_else(|problems| panic!("{effective}\n{problems}"));
            assert_eq!(parsed, launch, "{effective}");
            let again = effective_text(&effective).unwrap();
            assert_eq!(Launch::parse("x", &again), Ok(launch));
        }
    }

    #[test]
    fn defaults_are_marked_and_unused_sources_left_out() {
        let effective = effective_text(FILES[2]).unwrap();
        for line in ["buffer_s = 2  # default", "scenario = \"tumble\"", "seed = 7", "stage = \"wz-closed\""] {
            assert!(effective.lines().any(|found| found == line), "{line}:\n{effective}");
        }
        assert!(!effective.contains("[ingest.receiver]"), "{effective}");
        let receiver = effective_text("ingest.receiver.endpoint = \"tcp:localhost:9\"\n").unwrap();
        assert!(receiver.contains("[ingest.receiver]\nendpoint = \"tcp:localhost:9\""), "{receiver}");
        assert!(!effective.contains("[ingest.serial]") && effective.contains("[ingest.sim]"), "{effective}");
        let serial = effective_text(FILES[1]).unwrap();
        assert!(serial.contains("[ingest.serial]") && !serial.contains("[ingest.sim]"), "{serial}");
        assert!(serial.contains("rate_hz = 200\n") && serial.starts_with("name = \"boat\"\n"), "{serial}");
    }
}
