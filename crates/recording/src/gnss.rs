//! Reads and writes the satellite fixes that belong to a recording.
//!
//! Input: a file with one header line. Columns `t_s,ve,vn,vu` in s and m/s, optionally `lat_deg`,
//! `lon_deg` and `alt_m`.
//!
//! Output: fixes. Each is assigned to the first row of the recording that is not earlier than the
//! fix.
//!
//! Time: the time of arrival of a fix, on the recording's clock.
//!
//! Failure: reading ends at the first malformed line, with its position.

use std::path::{Path, PathBuf};

use crate::{
    atomic_file::{AtomicFile, OWNER_ONLY, decimal},
    columns::group_indices,
    error::RecordingError,
    table::Table,
    time,
};

const REQUIRED: [&str; 4] = ["t_s", "ve", "vn", "vu"];
const POSITION: [&str; 3] = ["lat_deg", "lon_deg", "alt_m"];
const KNOWN: [&str; 7] = ["t_s", "ve", "vn", "vu", POSITION[0], POSITION[1], POSITION[2]];

/// File name suffixes of recordings that can have a fix file.
const IMU_SUFFIXES: [&str; 3] = ["_imu.csv.gz", "_imu.csv.zst", "_imu.csv"];
/// File name suffixes of fix files, in order of preference.
const GNSS_SUFFIXES: [&str; 3] = ["_gnss.csv", "_gnss.csv.gz", "_gnss.csv.zst"];

/// Satellite fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// Time of arrival on the recording's clock, ns.
    pub t_ns: i64,
    /// Velocity over ground, m/s, east, north, up. Recorded NaN and infinite values are kept.
    pub velocity_m_s: [f64; 3],
    /// Geodetic latitude, degrees, north positive. `None` if the column is missing or the value is
    /// NaN.
    pub latitude_deg: Option<f64>,
    /// Longitude, degrees, east positive. `None` under the same conditions as for the latitude.
    pub longitude_deg: Option<f64>,
    /// Altitude as reported by the receiver, m. `None` under the same conditions as for the
    /// latitude.
    pub altitude_m: Option<f64>,
}

/// Columns of a fix, as field indices from 0.
struct Columns {
    time: usize,
    velocity: [usize; 3],
    position: [Option<usize>; 3],
}

/// Reader of a recording's fixes, as an iterator or in step with the rows.
pub struct FixReader {
    table: Table<Columns>,
    next: Option<Fix>,
}

impl FixReader {
    /// Opens a file and reads its first fix.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be opened, or its header or first row is malformed.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut table = Table::open(path, &KNOWN, |names| {
            let [time, east, north, up] = group_indices(names, &REQUIRED)?;
            let position = POSITION.map(|wanted| names.iter().position(|&name| name == wanted));
            Ok(Columns { time, velocity: [east, north, up], position })
        })?;
        let next = read_fix(&mut table)?;
        Ok(Self { table, next })
    }

    /// Returns the newest fix that arrived by `t_ns` and was not returned before.
    ///
    /// # Errors
    ///
    /// Returns an error if the first row after `t_ns`, or a row before it, is malformed.
    pub fn latest_until(&mut self, t_ns: i64) -> Result<Option<Fix>, RecordingError> {
        let mut newest = None;
        while let Some(fix) = self.next.take_if(|fix| fix.t_ns <= t_ns) {
            newest = Some(fix);
            self.next = read_fix(&mut self.table)?;
        }
        Ok(newest)
    }
}

impl Iterator for FixReader {
    type Item = Result<Fix, RecordingError>;

    /// Returns the next fix, or an error if the row after it is malformed.
    fn next(&mut self) -> Option<Self::Item> {
        let fix = self.next.take()?;
        Some(read_fix(&mut self.table).map(|next| {
            self.next = next;
            fix
        }))
    }
}

fn read_fix(table: &mut Table<Columns>) -> Result<Option<Fix>, RecordingError> {
    let fix = table.next(|fields, columns| {
        let mut position = [None; 3];
        for (coordinate, column) in position.iter_mut().zip(columns.position) {
            let number = column.map(|index| fields.numbers([index])).transpose()?;
            *coordinate = number.map(|[number]| number).filter(|number| !number.is_nan());
        }
        let [latitude_deg, longitude_deg, altitude_m] = position;
        let t_ns = fields.time_ns(columns.time)?;
        Ok(Fix { t_ns, velocity_m_s: fields.numbers(columns.velocity)?, latitude_deg, longitude_deg, altitude_m })
    });
    fix.transpose()
}

/// Returns the fix file next to a recording, if it exists: `NAME_gnss.csv` for `NAME_imu.csv.gz`.
pub fn find_for(recording: &Path) -> Option<PathBuf> {
    let name = recording.file_name()?.to_str()?;
    let stem = IMU_SUFFIXES.iter().find_map(|end| name.strip_suffix(end))?;
    GNSS_SUFFIXES.iter().map(|end| recording.with_file_name(format!("{stem}{end}"))).find(|path| path.exists())
}

/// Returns the path that [`find_for`] tries first as the fix file of a recording.
///
/// Returns `None` if the name of the recording does not end in `_imu.csv`, `_imu.csv.gz` or
/// `_imu.csv.zst`.
pub fn path_for(recording: &Path) -> Option<PathBuf> {
    let name = recording.file_name()?.to_str()?;
    let stem = IMU_SUFFIXES.iter().find_map(|end| name.strip_suffix(end))?;
    Some(recording.with_file_name(format!("{stem}{}", GNSS_SUFFIXES[0])))
}

/// Writer of fixes that [`FixReader`] reads back unchanged.
///
/// Only the owner may read the file. The file appears at its path when [`Writer::finish`] succeeds.
pub struct Writer {
    output: AtomicFile,
    rows: u64,
}

impl Writer {
    /// Starts a file, which replaces an existing one when it is finished.
    ///
    /// # Errors
    ///
    /// Returns [`RecordingError::Write`] if the temporary file cannot be created or written.
    pub fn create(path: &Path) -> Result<Self, RecordingError> {
        let mut output = AtomicFile::create(path, OWNER_ONLY)?;
        output.write(&KNOWN.join(","))?;
        output.write("\n")?;
        Ok(Self { output, rows: 0 })
    }

    /// Writes the next fix.
    ///
    /// # Errors
    ///
    /// Returns an error if the time is out of range or the file cannot be written.
    pub fn write(&mut self, fix: &Fix) -> Result<(), RecordingError> {
        self.rows += 1;
        if !time::is_in_range(fix.t_ns) {
            return Err(RecordingError::InvalidRow {
                path: self.output.path().to_owned(),
                row: self.rows,
                found: format!("the time {} ns", fix.t_ns),
                expected: time::EXPECTED,
            });
        }
        let [east, north, up] = fix.velocity_m_s.map(decimal);
        let position = [fix.latitude_deg, fix.longitude_deg, fix.altitude_m];
        let [latitude, longitude, altitude] = position.map(|coordinate| decimal(coordinate.unwrap_or(f64::NAN)));
        let t_s = time::Seconds(fix.t_ns);
        self.output.write(&format!("{t_s},{east},{north},{up},{latitude},{longitude},{altitude}\n"))
    }

    /// Flushes the file and renames it to its final path.
    ///
    /// # Errors
    ///
    /// Returns [`RecordingError::Write`] if the file cannot be flushed or renamed.
    pub fn finish(self) -> Result<(), RecordingError> {
        self.output.finish()
    }
}

/// Summary of a complete file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FixSurvey {
    /// Times of the first and the last fix, ns.
    pub range_ns: [i64; 2],
    /// Number of the last line if it has no line end.
    pub unended_line: Option<u64>,
}

/// Reads the complete file.
///
/// # Errors
///
/// Returns an error if the file cannot be opened or any line is malformed.
pub fn survey(path: &Path) -> Result<FixSurvey, RecordingError> {
    let mut fixes = FixReader::open(path)?;
    let first_ns = fixes.next.map_or(0, |fix| fix.t_ns);
    let mut last_ns = first_ns;
    for fix in &mut fixes {
        last_ns = fix?.t_ns;
    }
    Ok(FixSurvey { range_ns: [first_ns, last_ns], unended_line: fixes.table.unended_line() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        file
    }

    #[test]
    fn latest_until_returns_each_newest_fix_once() {
        let file = file(
            "t_s,ve,vn,vu,lat_deg,lon_deg,alt_m\n0.1,1,2,3,-37.8,145,80\n0.2,4,5,6,nan,145,80\n0.25,7,8,9,0,0,0\n",
        );
        let mut fixes = FixReader::open(file.path()).unwrap();
        let mut latest = |t_ms: i64| fixes.latest_until(t_ms.saturating_mul(1_000_000)).unwrap();
        assert_eq!(latest(99), None);
        let position = |latitude_deg, longitude_deg, altitude_m| Fix {
            t_ns: 0,
            velocity_m_s: [0.0; 3],
            latitude_deg: Some(latitude_deg),
            longitude_deg: Some(longitude_deg),
            altitude_m: Some(altitude_m),
        };
        let first = Fix { t_ns: 100_000_000, velocity_m_s: [1.0, 2.0, 3.0], ..position(-37.8, 145.0, 80.0) };
        assert_eq!(latest(100), Some(first));
        assert_eq!(latest(101), None, "a fix is returned once");
        let third = Fix { t_ns: 250_000_000, velocity_m_s: [7.0, 8.0, 9.0], ..position(0.0, 0.0, 0.0) };
        assert_eq!(latest(400), Some(third), "the newer of two fixes");
        assert_eq!(latest(i64::MAX), None);
    }

    #[test]
    fn malformed_fixes_are_reported_with_position() {
        for (text, expected) in [
            ("t_s,ve,vn\n", "line 1: found no column vu, expected all of t_s, ve, vn, vu"),
            ("t_s,ve,vn,vup\n", "line 1, column 4: found \"vup\", expected a known column; did you mean \"vu\"?"),
            ("t_s,ve,vn,vu\n0,0,0,0\n1,0,x,0\n", "line 3, column 3 (vn): found \"x\", expected a number"),
            ("t_s,ve,vn,vu\n", "line 2: found the end of the file, expected a row"),
        ] {
            let file = file(text);
            let error = survey(file.path()).unwrap_err().to_string();
            assert_eq!(error, format!("reading the recording {}: {expected}", file.path().display()));
        }
    }
}
