//! Suggests known names for misspelt ones.

use std::fmt;

/// A name that is not known, with the most similar known name and all known names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownName {
    /// Kind of the name, such as `topic`.
    kind: &'static str,
    found: String,
    nearest: Option<String>,
    known: Vec<String>,
}

impl UnknownName {
    /// Creates the error for the name `found`, which is not in `known`. `kind` is the kind of thing
    /// that the names denote, such as `topic`.
    pub fn new<'a>(kind: &'static str, found: &str, known: impl IntoIterator<Item = &'a str>) -> Self {
        let known: Vec<&str> = known.into_iter().collect();
        Self {
            kind,
            found: found.into(),
            nearest: nearest(found, known.iter().copied()).map(str::to_owned),
            known: known.into_iter().map(str::to_owned).collect(),
        }
    }
}

impl fmt::Display for UnknownName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, found, nearest, known } = self;
        write!(f, "unknown {kind} `{found}`;")?;
        nearest.as_ref().map_or(Ok(()), |nearest| write!(f, " did you mean `{nearest}`?"))?;
        write!(f, " expected one of {}", known.join(", "))
    }
}

impl std::error::Error for UnknownName {}

/// Minimum Jaro-Winkler similarity for a name to count as similar if more than a third of its
/// letters differ.
const MIN_SIMILARITY: f64 = 0.85;

/// Returns the name in `known` most similar to `found`, or `None` if none is similar enough.
///
/// A name is similar if it differs in at most a third of its letters, or if most letters are in the
/// same order. A name that begins with `found` is also similar, because a unit suffix is easily
/// forgotten. Case, underscores and spaces are ignored.
pub fn nearest<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let normalized = |name: &str| name.to_lowercase().replace(['_', ' '], "");
    let found = normalized(found);
    let edits_to = |known: &'a str| {
        let name = normalized(known);
        let edits = strsim::damerau_levenshtein(&found, &name);
        let is_similar =
            edits <= name.len().max(found.len()).max(3) / 3 || strsim::jaro_winkler(&found, &name) >= MIN_SIMILARITY;
        (is_similar || (!found.is_empty() && name.starts_with(&found))).then_some((edits, known))
    };
    known.into_iter().filter_map(edits_to).min_by_key(|(edits, _)| *edits).map(|(_, known)| known)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn similar_name_is_suggested_with_all_names() {
        let stages = ["multiple-model", "wz", "vqf", "madgwick", "madgwick-improved"];
        for (found, expected) in [
            ("vfq", Some("vqf")),
            ("madgwik", Some("madgwick")),
            ("multiple_model", Some("multiple-model")),
            ("multiple", Some("multiple-model")),
            ("kalman", None),
            ("", None),
        ] {
            assert_eq!(nearest(found, stages), expected, "{found}");
        }
        assert_eq!(nearest("dgr/s", ["rad/s", "deg/s", "m/s2"]), Some("deg/s"));
        assert_eq!(nearest("declination", ["rate_hz", "declination_deg"]), Some("declination_deg"));
        let message = UnknownName::new("fuser", "vfq", ["wz", "vqf"]).to_string();
        assert_eq!(message, "unknown fuser `vfq`; did you mean `vqf`? expected one of wz, vqf");
        let message = UnknownName::new("fuser", "kalman", ["wz", "vqf"]).to_string();
        assert_eq!(message, "unknown fuser `kalman`; expected one of wz, vqf");
    }
}
