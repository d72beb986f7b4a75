//! Sets of recordings with reference attitudes.

use std::{
    path::{Path, PathBuf},
    sync::LazyLock,
};

use recording::{Reader, Row};

/// A set of recordings: the files of a folder that have a common name prefix.
pub(super) struct Set {
    pub(super) name: &'static str,
    folder: &'static str,
    prefix: &'static str,
    /// Largest accepted mean RMSE of total attitude, heading and inclination, degrees, for the
    /// default fuser.
    pub(super) limits_deg: [f64; 3],
}

/// Sets of recordings to be scored.
pub(super) const SETS: [Set; 5] = [
    Set { name: "BROAD", folder: "broad", prefix: "", limits_deg: [1.78, 1.63, 0.56] },
    Set { name: "TUM VI", folder: "tumvi", prefix: "", limits_deg: [0.0, 0.0, 0.81] },
    Set { name: "Nexus 5 calm", folder: "phones", prefix: "nexus5_calm", limits_deg: [2.75, 2.60, 0.93] },
    Set { name: "Nexus 5 magnets", folder: "phones", prefix: "nexus5_magnets", limits_deg: [4.5, 4.4, 0.95] },
    Set { name: "iPhone 5", folder: "phones", prefix: "iphone5_calm", limits_deg: [9.2, 8.7, 2.75] },
];

/// Recording that belongs to a set.
pub(super) struct Recording {
    /// Index of the set in [`SETS`].
    pub(super) set: usize,
    pub(super) name: String,
    pub(super) rows: Vec<Row>,
}

/// Returns all recordings, which are read once. Prints a message and returns `None` if a folder is
/// missing.
pub(super) fn recordings() -> Option<&'static [Recording]> {
    static RECORDINGS: LazyLock<Option<Vec<Recording>>> = LazyLock::new(read);
    RECORDINGS.as_deref()
}

fn read() -> Option<Vec<Recording>> {
    let data = std::env::var_os("PLUMBLINE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    let mut recordings = Vec::new();
    for (set, Set { folder, prefix, .. }) in SETS.iter().enumerate() {
        let Ok(entries) = std::fs::read_dir(data.join(folder)) else {
            println!("skipped: no folder {folder} in {}", data.display());
            return None;
        };
        let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        for path in paths {
            let name = path.file_name().unwrap().to_str().unwrap();
            let Some(name) = name.strip_suffix(".csv.gz").filter(|name| name.starts_with(prefix)) else { continue };
            let rows = Reader::open(&path).unwrap().map(Result::unwrap).collect();
            recordings.push(Recording { set, name: name.to_owned(), rows });
        }
    }
    Some(recordings)
}
