//! A trial: a recording or a simulation, moment by moment.
//!
//! Input: a file's name, or `sim:` and a scenario. Output: its rows in their order, each with the fix that arrived with it. Time: the
//! trial's own; nothing of it is kept. Failure: a file that cannot be read, found before the first moment is given out.

use std::path::{Path, PathBuf};

use attitude::{Vector3, gnss::Fix};
use launch::GyroSamples;
use recording::{Reader, RecordingError, Row, gnss, gnss::Fixes, survey};

use crate::ScoreError;

/// What a recording's file ends with, and the file of its fixes instead.
const IMU_ENDS: [&str; 2] = ["_imu.csv.gz", "_imu.csv"];
const GNSS_ENDS: [&str; 2] = ["_gnss.csv", "_gnss.csv.gz"];

/// Where the fixes of a recording are.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Gnss {
    /// In `NAME_gnss.csv` beside `NAME_imu.csv.gz`, if it is there.
    #[default]
    Auto,
    /// Nowhere.
    Off,
    /// In this file.
    File(PathBuf),
}

/// How trials are read.
#[derive(Debug, Clone, Default)]
pub struct Reading {
    /// Where fixes are.
    pub gnss: Gnss,
    /// Leave out the magnetic field.
    pub without_field: bool,
    /// What a rate sample says; where it is not said, a recording's is the mean of its interval.
    pub gyro_samples: Option<GyroSamples>,
}

/// What there is at one moment of a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// The sensor's reading, and the truth where it is known.
    pub row: Row,
    /// The fix that arrived since the moment before.
    pub fix: Option<Fix>,
}

/// A recording.
#[derive(Debug, Clone)]
pub struct Trial {
    /// The file's name without its ending.
    pub name: String,
    /// Samples per second.
    pub rate_hz: f64,
    /// Moments.
    pub rows: u64,
    /// The attitude is known, at least now and then.
    pub has_reference: bool,
    /// What a rate sample says about its interval.
    pub gyro_samples: GyroSamples,
    /// The file.
    pub file: PathBuf,
    fixes: Option<PathBuf>,
    without_field: bool,
}

impl Trial {
    /// Reads the whole once, so that whatever is malformed in it is found now.
    pub fn open(text: &str, reading: &Reading) -> Result<Self, ScoreError> {
        let file = PathBuf::from(text);
        let survey = survey(&file)?;
        let fixes = match &reading.gnss {
            Gnss::Off => None,
            Gnss::File(fixes) => Some(fixes.clone()),
            Gnss::Auto => beside(&file),
        };
        fixes.as_deref().map_or(Ok(()), gnss::check)?;
        Ok(Self {
            name: stem(&file),
            rate_hz: survey.rate_hz,
            rows: survey.rows,
            has_reference: survey.has_reference,
            gyro_samples: reading.gyro_samples.unwrap_or(GyroSamples::Means),
            file,
            fixes,
            without_field: reading.without_field,
        })
    }

    /// The moments from the first to the last.
    pub fn moments(&self) -> Result<Moments, ScoreError> {
        let rows = Reader::open(&self.file)?;
        let fixes = self.fixes.as_deref().map(Fixes::open).transpose()?;
        Ok(Moments { rows, fixes, without_field: self.without_field })
    }
}

/// The moments of a trial; ends after the first error.
pub struct Moments {
    rows: Reader,
    fixes: Option<Fixes>,
    without_field: bool,
}

impl Moments {
    fn moment(&mut self, row: Row) -> Result<Moment, RecordingError> {
        let fix = match &mut self.fixes {
            Some(fixes) => fixes.until(row.t_ns)?.and_then(fix),
            None => None,
        };
        let field_ut = row.field_ut.filter(|_| !self.without_field);
        Ok(Moment { row: Row { field_ut, ..row }, fix })
    }
}

impl Iterator for Moments {
    type Item = Result<Moment, ScoreError>;

    fn next(&mut self) -> Option<Self::Item> {
        let row = self.rows.next()?;
        Some(row.and_then(|row| self.moment(row)).map_err(ScoreError::from))
    }
}

/// The fix of a record; `None` when its velocity is not one.
fn fix(of: gnss::Fix) -> Option<Fix> {
    let velocity_m_s = Vector3::from(of.velocity_m_s);
    let latitude_rad = of.latitude_deg.map(f64::to_radians);
    velocity_m_s.iter().all(|x| x.is_finite()).then_some(Fix { velocity_m_s, sd_m_s: None, age_s: None, latitude_rad })
}

/// The file of fixes that lies beside a recording.
fn beside(file: &Path) -> Option<PathBuf> {
    let name = file.file_name()?.to_str()?;
    let stem = IMU_ENDS.iter().find_map(|end| name.strip_suffix(end))?;
    GNSS_ENDS.iter().map(|end| file.with_file_name(format!("{stem}{end}"))).find(|path| path.exists())
}

/// The file's name without `.csv.gz` or `.csv`.
fn stem(file: &Path) -> String {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let stem = name.strip_suffix(".gz").unwrap_or(&name);
    stem.strip_suffix(".csv").unwrap_or(&name).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn fixes_are_found_beside_their_recording_and_come_with_the_row_they_arrived_by() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let imu = path("flight_imu.csv");
        fs::write(&imu, "t_s,gx,gy,gz,ax,ay,az,mx,my,mz\n0,0,0,0,0,0,9.8,1,2,3\n1,0,0,0,0,0,9.8,1,2,3\n").unwrap();
        let fixes = |reading: Reading| -> Vec<_> {
            let trial = Trial::open(imu.to_str().unwrap(), &reading).unwrap();
            assert_eq!((trial.name.as_str(), trial.rows), ("flight_imu", 2));
            trial.moments().unwrap().map(|moment| moment.unwrap().fix.map(|fix| fix.velocity_m_s.x)).collect()
        };
        let with = |gnss| Reading { gnss, ..Reading::default() };
        assert_eq!(fixes(with(Gnss::Auto)), [None, None]);
        fs::write(path("flight_gnss.csv"), "t_s,ve,vn,vu\n0.5,7,0,0\n1.5,8,0,0\n").unwrap();
        fs::write(path("other.csv"), "t_s,ve,vn,vu\n0,9,0,0\n0.5,nan,0,0\n").unwrap();
        assert_eq!(fixes(with(Gnss::Auto)), [None, Some(7.0)]);
        assert_eq!(fixes(with(Gnss::Off)), [None, None]);
        assert_eq!(fixes(with(Gnss::File(path("other.csv")))), [Some(9.0), None], "a velocity that is none is no fix");
    }

    #[test]
    fn the_field_can_be_left_out() {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(&file, "t_s,gx,gy,gz,ax,ay,az,mx,my,mz\n0,0,0,0,0,0,9.8,1,2,3\n1,0,0,0,0,0,9.8,1,2,3\n").unwrap();
        for (without_field, expected) in [(false, Some([1.0, 2.0, 3.0])), (true, None)] {
            let reading = Reading { without_field, ..Reading::default() };
            let trial = Trial::open(file.path().to_str().unwrap(), &reading).unwrap();
            let fields: Vec<_> = trial.moments().unwrap().map(|moment| moment.unwrap().row.field_ut).collect();
            assert_eq!(fields, [expected; 2]);
        }
    }

    #[test]
    fn a_trial_is_called_as_its_file() {
        for (file, name) in [("a/b.csv.gz", "b"), ("b.csv", "b"), ("x.y_imu.csv.gz", "x.y_imu"), ("b.txt", "b.txt")] {
            assert_eq!(stem(Path::new(file)), name);
        }
    }
}
