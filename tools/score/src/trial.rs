//! A trial: a recording or a simulation as a sequence of readings.
//!
//! Input: the name of a file, or `sim:` followed by a scenario.
//!
//! Output: the readings in order, each with the fix that arrived with it.
//!
//! Time: timestamps of the readings. The readings are streamed and not kept in memory.
//!
//! Failure: an unreadable file is reported when the trial is opened, before the first reading.

use std::path::{Path, PathBuf};

use attitude::gyro::RateKind;
use foreign::ForeignText;
use launch::GyroSamples;
use readings::source::{Reading, RecordedReadings};
use recording::{RecordingError, References, gnss, survey};
use scenario::Scenario;

use crate::ScoreError;

/// Prefix of the name of a simulation.
const SIM: &str = "sim:";

/// Source of a trial's GNSS fixes.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Gnss {
    /// `NAME_gnss.csv` next to `NAME_imu.csv.gz`, if it exists.
    #[default]
    Auto,
    /// No fixes. This also disables a simulated receiver.
    Off,
    /// Fixes from this file.
    File(PathBuf),
}

/// Meaning of the rate samples in recordings. The default is the mean over the sample interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordedGyroSamples(pub GyroSamples);

impl Default for RecordedGyroSamples {
    fn default() -> Self {
        Self(GyroSamples::Means)
    }
}

/// Options for reading trials.
#[derive(Debug, Clone, Default)]
pub struct TrialOptions {
    /// Source of the fixes.
    pub gnss: Gnss,
    /// `true` to ignore the magnetic field.
    pub without_field: bool,
    /// File with a reference attitude that replaces the one in the recording.
    pub reference: Option<PathBuf>,
    /// Meaning of a rate sample, for recordings and simulations.
    pub gyro_samples: Option<GyroSamples>,
    /// Meaning of a rate sample in recordings if `gyro_samples` is `None`.
    pub recorded_gyro_samples: RecordedGyroSamples,
}

/// A recording or a simulation.
#[derive(Debug, Clone)]
pub struct Trial {
    /// File name without its extension, or the name of the simulation.
    pub name: ForeignText,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Number of readings.
    pub rows: u64,
    /// `true` if the attitude is known for at least some of the samples.
    pub has_reference: bool,
    /// Meaning of a rate sample: mean over the interval, or value at its end.
    pub gyro_samples: GyroSamples,
    source: Source,
    options: TrialOptions,
}

#[derive(Debug, Clone)]
enum Source {
    Recording { file: PathBuf, fixes: Option<PathBuf> },
    Sim(Box<Scenario>),
}

impl Trial {
    /// Opens the trial with this name.
    ///
    /// A recording is read once completely, so that malformed lines are reported here.
    ///
    /// # Errors
    ///
    /// Returns an error if the scenario is unknown, or if a recording, its fixes or its reference
    /// cannot be read.
    pub fn open(text: &str, options: &TrialOptions) -> Result<Self, ScoreError> {
        match text.strip_prefix(SIM) {
            Some(scenario) => Ok(Self::simulated(text, Scenario::parse(scenario)?, options)),
            None => Self::recorded(Path::new(text), options),
        }
    }

    fn recorded(file: &Path, options: &TrialOptions) -> Result<Self, ScoreError> {
        let survey = survey(file)?;
        let fixes = match &options.gnss {
            Gnss::Off => None,
            Gnss::File(fixes) => Some(fixes.clone()),
            Gnss::Auto => gnss::find_for(file),
        };
        fixes.as_deref().map(gnss::survey).transpose()?;
        options.reference.as_deref().map_or(Ok(()), validate_references)?;
        Ok(Self {
            name: trial_name(file).into(),
            rate_hz: survey.rate_hz,
            rows: survey.rows,
            has_reference: survey.has_reference || options.reference.is_some(),
            gyro_samples: options.gyro_samples.unwrap_or(options.recorded_gyro_samples.0),
            source: Source::Recording { file: file.into(), fixes },
            options: options.clone(),
        })
    }

    fn simulated(name: &str, scenario: Scenario, options: &TrialOptions) -> Self {
        let gyro_samples = match scenario.rate_kind {
            RateKind::Mean => GyroSamples::Means,
            RateKind::Instant => GyroSamples::Instants,
        };
        Self {
            name: name.into(),
            rate_hz: scenario.rate_hz,
            rows: (scenario.duration_s * scenario.rate_hz).round() as u64 + 1,
            has_reference: true,
            gyro_samples: options.gyro_samples.unwrap_or(gyro_samples),
            source: Source::Sim(Box::new(scenario)),
            options: options.clone(),
        }
    }

    /// Returns the path of a recording; `None` for a simulation.
    pub fn file(&self) -> Option<&Path> {
        match &self.source {
            Source::Recording { file, .. } => Some(file),
            Source::Sim(_) => None,
        }
    }

    /// Returns the name for output files. Characters with a special meaning in a shell or path are
    /// replaced.
    pub fn file_stem(&self) -> String {
        match &self.source {
            Source::Recording { .. } => self.name.raw().to_owned(),
            Source::Sim(_) => self.name.raw().replace([':', '?', '&', '/', '='], "_"),
        }
    }

    /// Returns the readings in order. The iterator ends after the first error.
    ///
    /// # Errors
    ///
    /// Returns an error if a file cannot be opened.
    pub fn readings(&self) -> Result<Box<dyn Iterator<Item = Result<Reading, ScoreError>>>, ScoreError> {
        let TrialOptions { gnss, without_field, reference, .. } = &self.options;
        Ok(match &self.source {
            Source::Recording { file, fixes } => {
                let readings = RecordedReadings::open(file, fixes.as_deref(), !without_field)?;
                match reference.as_deref().map(References::open).transpose()? {
                    None => Box::new(readings.map(|reading| Ok(reading?))),
                    Some(mut references) => Box::new(readings.map(move |reading| {
                        let reading = reading?;
                        let reference = references.attitude_at(reading.t_ns, reading.rate_rad_s)?;
                        Ok(Reading { reference, ..reading })
                    })),
                }
            }
            Source::Sim(scenario) => Box::new(simulated(scenario, *gnss != Gnss::Off, !without_field).map(Ok)),
        })
    }
}

impl Trial {
    /// Returns the function from time in ns to the true gyro bias of a simulation in rad/s; `None`
    /// for a recording.
    pub(crate) fn gyro_bias_rad_s(&self) -> Option<impl Fn(i64) -> [f64; 3] + use<>> {
        let Source::Sim(scenario) = &self.source else { return None };
        let sensors = scenario.sensors();
        Some(move |t_ns: i64| sensors.gyro_bias_rad_s(t_ns as f64 * 1e-9).into())
    }
}

/// Validates a reference file by reading it completely.
pub(crate) fn validate_references(file: &Path) -> Result<(), RecordingError> {
    References::open(file)?.attitude_at(i64::MAX, [0.0; 3]).map(drop)
}

fn simulated(scenario: &Scenario, with_fixes: bool, with_field: bool) -> impl Iterator<Item = Reading> + use<> {
    let scored_from_s = scenario.scored_from_s;
    scenario.readings().map(move |(t_s, reading)| {
        let reading = Reading::simulated(t_s, reading, t_s >= scored_from_s);
        let (field_ut, fix) = (reading.field_ut.filter(|_| with_field), reading.fix.filter(|_| with_fixes));
        Reading { field_ut, fix, ..reading }
    })
}

/// Returns the file name without `.csv.gz` or `.csv`.
fn trial_name(file: &Path) -> String {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let stem = name.strip_suffix(".gz").unwrap_or(&name);
    stem.strip_suffix(".csv").unwrap_or(&name).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn fix_file_is_found_and_fixes_join_arrival_row() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let imu = path("flight_imu.csv");
        fs::write(&imu, "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n1,0,0,0,0,0,9.8\n").unwrap();
        let fixes = |gnss: Gnss| -> Vec<_> {
            let trial = Trial::open(imu.to_str().unwrap(), &TrialOptions { gnss, ..TrialOptions::default() }).unwrap();
            assert_eq!((trial.name.raw(), trial.rows), ("flight_imu", 2));
            trial.readings().unwrap().map(|reading| reading.unwrap().fix.map(|fix| fix.fix.velocity_m_s.x)).collect()
        };
        assert_eq!(fixes(Gnss::Auto), [None, None]);
        fs::write(path("flight_gnss.csv"), "t_s,ve,vn,vu\n0.5,7,0,0\n1.5,8,0,0\n").unwrap();
        fs::write(path("other.csv"), "t_s,ve,vn,vu\n0,9,0,0\n").unwrap();
        assert_eq!(fixes(Gnss::Auto), [None, Some(7.0)]);
        assert_eq!(fixes(Gnss::Off), [None, None]);
        assert_eq!(fixes(Gnss::File(path("other.csv"))), [Some(9.0), None]);
    }

    #[test]
    fn magnetic_field_can_be_ignored() {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(&file, "t_s,gx,gy,gz,ax,ay,az,mx,my,mz\n0,0,0,0,0,0,9.8,1,2,3\n1,0,0,0,0,0,9.8,1,2,3\n").unwrap();
        for (without_field, expected) in [(false, Some([1.0, 2.0, 3.0])), (true, None)] {
            let options = TrialOptions { without_field, ..TrialOptions::default() };
            let trial = Trial::open(file.path().to_str().unwrap(), &options).unwrap();
            let fields: Vec<_> = trial.readings().unwrap().map(|reading| reading.unwrap().field_ut).collect();
            assert_eq!(fields, [expected; 2]);
        }
    }

    #[test]
    fn simulation_duration_and_scoring_start_match_scenario() {
        let trial = Trial::open("sim:s1?duration_s=8&rate_hz=50", &TrialOptions::default()).unwrap();
        assert_eq!((trial.rows, trial.rate_hz, trial.gyro_samples), (401, 50.0, GyroSamples::Instants));
        let readings: Vec<_> = trial.readings().unwrap().map(Result::unwrap).collect();
        assert_eq!(readings.len(), 401);
        let scored = readings.iter().filter(|reading| reading.reference.is_some_and(|truth| truth.scored)).count();
        assert_eq!(scored, 151, "s1 is scored from 5 s");
        assert_eq!(trial.file_stem(), "sim_s1_duration_s_8_rate_hz_50");
        assert_eq!(Trial::open("sim:s9", &TrialOptions::default()).unwrap_err().exit_code(), 2);
    }

    #[test]
    fn simulated_receiver_can_be_disabled() {
        let fixes = |gnss| {
            let options = TrialOptions { gnss, ..TrialOptions::default() };
            let trial = Trial::open("sim:cruise?duration_s=5", &options).unwrap();
            trial.readings().unwrap().filter(|reading| reading.as_ref().unwrap().fix.is_some()).count()
        };
        assert!(fixes(Gnss::Auto) > 0);
        assert_eq!(fixes(Gnss::Off), 0);
    }

    #[test]
    fn trial_name_is_file_stem() {
        for (file, name) in [("a/b.csv.gz", "b"), ("b.csv", "b"), ("x.y_imu.csv.gz", "x.y_imu"), ("b.txt", "b.txt")] {
            assert_eq!(trial_name(Path::new(file)), name);
        }
    }
}
