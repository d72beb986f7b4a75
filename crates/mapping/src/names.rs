//! Suggests known names for misspelt ones.

/// Minimum Jaro-Winkler similarity of a suggestion.
const MIN_SIMILARITY: f64 = 0.8;

/// Returns the name in `known` most similar to `found`, or `None` if none is similar enough.
///
/// Case, underscores and spaces are ignored.
pub fn nearest<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let normalized = |name: &str| name.to_lowercase().replace(['_', ' '], "");
    let found = normalized(found);
    known
        .into_iter()
        .map(|known| (strsim::jaro_winkler(&found, &normalized(known)), known))
        .filter(|&(similarity, _)| similarity >= MIN_SIMILARITY)
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, known)| known)
}
