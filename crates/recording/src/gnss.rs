//! What a satellite receiver said, beside a recording.
//!
//! Input: a file with one header line; columns `t_s,ve,vn,vu` in s and m/s, optionally `lat_deg`, `lon_deg` and
//! `alt_m`. Output: the fixes, each for the first row of the recording that is not before it. Time: that of a fix is when it
//! arrived, on the recording's clock. Failure: the first malformed line ends the reading, with its place.

use std::path::{Path, PathBuf};

use crate::{
    columns::indices,
    error::RecordingError,
    output::{Output, number},
    table::Table,
    time,
};

const REQUIRED: [&str; 4] = ["t_s", "ve", "vn", "vu"];
const POSITION: [&str; 3] = ["lat_deg", "lon_deg", "alt_m"];
const KNOWN: [&str; 7] = ["t_s", "ve", "vn", "vu", POSITION[0], POSITION[1], POSITION[2]];

/// What the file of a recording ends with, and that of its fixes instead.
const IMU_ENDS: [&str; 2] = ["_imu.csv.gz", "_imu.csv"];
const GNSS_ENDS: [&str; 2] = ["_gnss.csv", "_gnss.csv.gz"];

/// One fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// When it arrived, on the recording's clock, ns.
    pub t_ns: i64,
    /// Velocity over ground, m/s, east, north, up; as recorded, so it may be nan or infinite.
    pub velocity_m_s: [f64; 3],
    /// Geodetic latitude, degrees, north positive; `None` where the file has none or it is nan.
    pub latitude_deg: Option<f64>,
    /// Longitude, degrees, east positive; `None` as for the latitude.
    pub longitude_deg: Option<f64>,
    /// Altitude as the receiver gave it, m; `None` as for the latitude.
    pub altitude_m: Option<f64>,
}

/// Where the columns of a fix are.
struct Columns {
    time: usize,
    velocity: [usize; 3],
    position: [Option<usize>; 3],
}

/// The fixes of a recording, to be taken as its rows go on.
pub struct Fixes {
    table: Table<Columns>,
    next: Option<Fix>,
}

impl Fixes {
    /// Opens a file and reads its first fix.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut table = Table::open(path, &KNOWN, |names| {
            let [time, east, north, up] = indices(names, &REQUIRED)?;
            let position = POSITION.map(|wanted| names.iter().position(|&name| name == wanted));
            Ok(Columns { time, velocity: [east, north, up], position })
        })?;
        let next = read(&mut table)?;
        Ok(Self { table, next })
    }

    /// The newest fix that has arrived by `t_ns` and was not taken before.
    pub fn until(&mut self, t_ns: i64) -> Result<Option<Fix>, RecordingError> {
        let mut newest = None;
        while let Some(fix) = self.next.take_if(|fix| fix.t_ns <= t_ns) {
            newest = Some(fix);
            self.next = read(&mut self.table)?;
        }
        Ok(newest)
    }
}

fn read(table: &mut Table<Columns>) -> Result<Option<Fix>, RecordingError> {
    let fix = table.next(|fields, columns| {
        let mut position = [None; 3];
        for (told, column) in position.iter_mut().zip(columns.position) {
            let number = column.map(|index| fields.numbers([index])).transpose()?;
            *told = number.map(|[number]| number).filter(|number| !number.is_nan());
        }
        let [latitude_deg, longitude_deg, altitude_m] = position;
        let t_ns = fields.parsed(columns.time, time::EXPECTED, time::parse_ns)?;
        Ok(Fix { t_ns, velocity_m_s: fields.numbers(columns.velocity)?, latitude_deg, longitude_deg, altitude_m })
    });
    fix.transpose()
}

/// The file of fixes that lies beside a recording: `NAME_gnss.csv` for `NAME_imu.csv.gz`.
pub fn beside(recording: &Path) -> Option<PathBuf> {
    let name = recording.file_name()?.to_str()?;
    let stem = IMU_ENDS.iter().find_map(|end| name.strip_suffix(end))?;
    GNSS_ENDS.iter().map(|end| recording.with_file_name(format!("{stem}{end}"))).find(|path| path.exists())
}

/// Where the fixes of a recording are to be written so that [`beside`] finds them; `None` for a recording whose name does not end in
/// `_imu.csv` or `_imu.csv.gz`.
pub fn place(recording: &Path) -> Option<PathBuf> {
    let name = recording.file_name()?.to_str()?;
    let stem = IMU_ENDS.iter().find_map(|end| name.strip_suffix(end))?;
    Some(recording.with_file_name(format!("{stem}{}", GNSS_ENDS[0])))
}

/// Writes fixes that [`Fixes`] gives back one for one: for this user's eyes only, in place once they are whole. Without
/// [`Writer::finish`] there is no file.
pub struct Writer {
    output: Output,
    rows: u64,
}

impl Writer {
    /// Begins a file in place of the one that may be there.
    pub fn create(path: &Path) -> Result<Self, RecordingError> {
        let mut output = Output::create(path)?;
        output.write(&KNOWN.join(","))?;
        output.write("\n")?;
        Ok(Self { output, rows: 0 })
    }

    /// Writes the next fix.
    pub fn write(&mut self, fix: &Fix) -> Result<(), RecordingError> {
        self.rows += 1;
        if !time::is_readable(fix.t_ns) {
            return Err(RecordingError::Unwritable {
                path: self.output.path().to_owned(),
                row: self.rows,
                found: format!("the time {} ns", fix.t_ns),
                expected: time::EXPECTED,
            });
        }
        let [east, north, up] = fix.velocity_m_s.map(number);
        let place = [fix.latitude_deg, fix.longitude_deg, fix.altitude_m];
        let [latitude, longitude, altitude] = place.map(|told| number(told.unwrap_or(f64::NAN)));
        let t_s = time::Seconds(fix.t_ns);
        self.output.write(&format!("{t_s},{east},{north},{up},{latitude},{longitude},{altitude}\n"))
    }

    /// Puts the file in its place.
    pub fn finish(self) -> Result<(), RecordingError> {
        self.output.finish()
    }
}

/// Reads a file from end to end, so that whatever is malformed in it is found now.
pub fn check(path: &Path) -> Result<(), RecordingError> {
    let mut fixes = Fixes::open(path)?;
    while fixes.next.is_some() {
        fixes.next = read(&mut fixes.table)?;
    }
    Ok(())
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
    fn a_fix_belongs_to_the_first_row_that_is_not_before_it() {
        let file = file(
            "t_s,ve,vn,vu,lat_deg,lon_deg,alt_m\n0.1,1,2,3,-37.8,145,80\n0.2,4,5,6,nan,145,80\n0.25,7,8,9,0,0,0\n",
        );
        let mut fixes = Fixes::open(file.path()).unwrap();
        let mut until = |t_ms: i64| fixes.until(t_ms.saturating_mul(1_000_000)).unwrap();
        assert_eq!(until(99), None);
        let place = |latitude_deg, longitude_deg, altitude_m| Fix {
            t_ns: 0,
            velocity_m_s: [0.0; 3],
            latitude_deg: Some(latitude_deg),
            longitude_deg: Some(longitude_deg),
            altitude_m: Some(altitude_m),
        };
        let first = Fix { t_ns: 100_000_000, velocity_m_s: [1.0, 2.0, 3.0], ..place(-37.8, 145.0, 80.0) };
        assert_eq!(until(100), Some(first));
        assert_eq!(until(101), None, "a fix is taken once");
        let third = Fix { t_ns: 250_000_000, velocity_m_s: [7.0, 8.0, 9.0], ..place(0.0, 0.0, 0.0) };
        assert_eq!(until(400), Some(third), "of two the newer one");
        assert_eq!(until(i64::MAX), None);
    }

    #[test]
    fn what_is_malformed_is_shown_with_its_place() {
        for (text, said) in [
            ("t_s,ve,vn\n", "line 1: found no column vu, expected all of t_s, ve, vn, vu"),
            ("t_s,ve,vn,vup\n", "line 1, column 4: found \"vup\", expected a known column; did you mean \"vu\"?"),
            ("t_s,ve,vn,vu\n0,0,0,0\n1,0,x,0\n", "line 3, column 3 (vn): found \"x\", expected a number"),
            ("t_s,ve,vn,vu\n", "line 2: found the end of the file, expected a row"),
        ] {
            let file = file(text);
            let error = check(file.path()).unwrap_err().to_string();
            assert_eq!(error, format!("reading the recording {}: {said}", file.path().display()));
        }
    }
}
