//! Description of all sections and keys, for documentation.

/// Name and documentation of a key.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Key {
    pub(crate) name: &'static str,
    /// Meaning of the key, in complete sentences.
    pub(crate) doc: &'static str,
    /// Unit, empty for a dimensionless value.
    pub(crate) unit: &'static str,
    /// Example in TOML for a key that is not set by default, or an empty string.
    pub(crate) example: &'static str,
}

/// Description of a section of the launch file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SectionDescription {
    /// Path of the section, such as `ingest.sim`; empty for the top level.
    pub path: String,
    /// `true` for an array of tables.
    pub is_array: bool,
    /// `true` if a missing section stays unset instead of taking the defaults of its keys.
    pub is_optional: bool,
    /// Meaning of the section, in complete sentences.
    pub doc: String,
    /// Keys in the order of their declaration.
    pub keys: Vec<KeyDescription>,
}

/// Description of a key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeyDescription {
    /// Name of the key. The name ends with the unit, if there is one.
    pub name: String,
    /// Default in TOML. `None` if the key is not set by default.
    pub default: Option<String>,
    /// Description of the allowed values.
    pub allowed: String,
    /// Unit, empty for a dimensionless value.
    pub unit: &'static str,
    /// Meaning of the key, in complete sentences.
    pub doc: String,
    /// Allowed names with their meanings, for a key with a fixed set of names. A meaning may be
    /// empty.
    pub values: Vec<(String, String)>,
    /// Example in TOML, or an empty string.
    pub example: &'static str,
    /// `true` if the section is invalid without the key.
    pub is_required: bool,
    /// Settings of another key with which this key is allowed, such as `kind = "slow"`. Empty if
    /// the key is always allowed.
    pub conditions: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DEFAULT_IIO_RATE_HZ, DEFAULT_RATE_HZ, Launch, MAX_FAULTS, MIN_TOPIC_MESSAGES, describe};

    /// Returns the text of a section: its header, `condition` and `lines`.
    fn section(section: &SectionDescription, condition: &str, lines: &str) -> String {
        let SectionDescription { path, is_array, .. } = section;
        let header = match (path.as_str(), is_array) {
            ("", _) => String::new(),
            (path, true) => format!("[[{path}]]\n"),
            (path, false) => format!("[{path}]\n"),
        };
        format!("{header}{condition}\n{lines}\n")
    }

    #[test]
    fn file_of_all_defaults_equals_default() {
        let mut text = String::new();
        for described in describe().iter().filter(|section| !section.is_optional) {
            let keys = described.keys.iter().filter(|key| key.conditions.is_empty());
            let lines = keys.filter_map(|key| Some(format!("{} = {}\n", key.name, key.default.as_ref()?)));
            let lines: String = lines.collect();
            text += &section(described, "", &lines);
        }
        assert!(text.contains("silence_s = 0.5") && text.contains("listen = \"127.0.0.1:8088\""), "{text}");
        let launch = Launch::parse("launch.toml", &text).unwrap_or_else(|problems| panic!("{problems}"));
        assert_eq!(launch, Launch::default());
    }

    #[test]
    fn default_and_example_of_each_key_are_valid() {
        for described in &describe() {
            for key in &described.keys {
                let condition = key.conditions.first().map_or("", String::as_str);
                let is_example_shown = key.default.is_none() || described.is_optional;
                let example = Some(key.example).filter(|example| is_example_shown && !example.is_empty());
                let values = key.default.as_deref().into_iter().chain(example);
                for value in values {
                    let text = section(described, condition, &format!("{} = {value}", key.name));
                    let shown = Launch::parse("x", &text).err().map_or(String::new(), |problems| problems.to_string());
                    let is_rejected = ["expected", "unknown"]
                        .iter()
                        .any(|problem| shown.contains(&format!("{}: {problem}", key.name)))
                        || shown.contains("unknown key");
                    assert!(!is_rejected, "{text}:\n{shown}");
                }
            }
        }
    }

    #[test]
    fn documented_numbers_are_those_used() {
        let sections = describe();
        let keys = sections.iter().flat_map(|section| &section.keys).map(|key| &key.doc);
        let docs: Vec<_> = sections.iter().map(|section| &section.doc).chain(keys).collect();
        for (words, number) in [
            ("buffers are made for", format!("{DEFAULT_RATE_HZ} Hz")),
            ("is measured", format!("{DEFAULT_IIO_RATE_HZ} Hz with `iio`")),
            ("opens the topic with a buffer", format!("at least {MIN_TOPIC_MESSAGES}.")),
            ("Injected fault", format!("At most {MAX_FAULTS} are")),
        ] {
            let wrong: Vec<_> = docs.iter().filter(|doc| doc.contains(words) && !doc.contains(&number)).collect();
            assert!(wrong.is_empty() && docs.iter().any(|doc| doc.contains(words)), "{number}: {wrong:?}");
        }
    }

    #[test]
    fn each_key_is_documented() {
        for section in describe() {
            for key in section.keys.iter().filter(|_| section.path != "gateway.rates") {
                assert!(!key.doc.is_empty(), "{}.{} has no meaning", section.path, key.name);
                assert!(!key.allowed.is_empty() || !key.values.is_empty(), "{}.{}", section.path, key.name);
            }
            assert!(section.path.is_empty() || !section.doc.is_empty(), "{} has no meaning", section.path);
        }
    }
}
