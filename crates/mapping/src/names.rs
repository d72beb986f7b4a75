//! Names that are nearly others.

/// Jaro-Winkler similarity from which a name is another one misspelt.
const NEAR: f64 = 0.8;

/// That of `known` which is nearly `found`.
pub fn nearest<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let plain = |name: &str| name.to_lowercase().replace(['_', ' '], "");
    let found = plain(found);
    known
        .into_iter()
        .map(|known| (strsim::jaro_winkler(&found, &plain(known)), known))
        .filter(|&(similarity, _)| similarity >= NEAR)
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, known)| known)
}
