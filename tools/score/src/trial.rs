//! A trial: a recording or a simulation, reading by reading.
//!
//! Input: a file's name, or `sim:` and a scenario. Output: its readings in their order, each with the fix that arrived with it. Time:
//! the trial's own; nothing of it is kept. Failure: a file that cannot be read, found before the first reading is given out.

use std::path::{Path, PathBuf};

use attitude::gyro::RateKind;
use ingest::source::{Reading, Recorded, Truth};
use launch::GyroSamples;
use recording::{RecordingError, References, gnss, survey};
use scenario::Scenario;

use crate::ScoreError;

/// What a simulation's name begins with.
const SIM: &str = "sim:";

/// Where the fixes of a recording are.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Gnss {
    /// In `NAME_gnss.csv` beside `NAME_imu.csv.gz`, if it is there.
    #[default]
    Auto,
    /// Nowhere; a simulated receiver is off, too.
    Off,
    /// In this file.
    File(PathBuf),
}

/// What a rate sample of a recording says: the mean of its interval where nobody knows better.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordedSamples(pub GyroSamples);

impl Default for RecordedSamples {
    fn default() -> Self {
        Self(GyroSamples::Means)
    }
}

/// How trials are read.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Where fixes are.
    pub gnss: Gnss,
    /// Leave out the magnetic field.
    pub without_field: bool,
    /// The true attitude of a recording, in a file of its own, in place of what the recording says.
    pub reference: Option<PathBuf>,
    /// What a rate sample says, of recordings and simulations.
    pub gyro_samples: Option<GyroSamples>,
    /// What a recording's says where that is not said.
    pub recorded_samples: RecordedSamples,
}

/// A recording or a simulation.
#[derive(Debug, Clone)]
pub struct Trial {
    /// The file's name without its ending, or the simulation's.
    pub name: String,
    /// Samples per second.
    pub rate_hz: f64,
    /// Readings.
    pub rows: u64,
    /// The attitude is known, at least now and then.
    pub has_reference: bool,
    /// What a rate sample says about its interval.
    pub gyro_samples: GyroSamples,
    source: Source,
    options: Options,
}

#[derive(Debug, Clone)]
enum Source {
    Recording { file: PathBuf, fixes: Option<PathBuf> },
    Sim(Box<Scenario>),
}

impl Trial {
    /// The trial of that name. A recording is read once as a whole, so that whatever is malformed in it is found now.
    pub fn open(text: &str, options: &Options) -> Result<Self, ScoreError> {
        match text.strip_prefix(SIM) {
            Some(scenario) => Ok(Self::simulated(text, Scenario::named(scenario)?, options)),
            None => Self::recorded(Path::new(text), options),
        }
    }

    fn recorded(file: &Path, options: &Options) -> Result<Self, ScoreError> {
        let survey = survey(file)?;
        let fixes = match &options.gnss {
            Gnss::Off => None,
            Gnss::File(fixes) => Some(fixes.clone()),
            Gnss::Auto => gnss::find_for(file),
        };
        fixes.as_deref().map_or(Ok(()), gnss::validate)?;
        options.reference.as_deref().map_or(Ok(()), check)?;
        Ok(Self {
            name: stem(file),
            rate_hz: survey.rate_hz,
            rows: survey.rows,
            has_reference: survey.has_reference || options.reference.is_some(),
            gyro_samples: options.gyro_samples.unwrap_or(options.recorded_samples.0),
            source: Source::Recording { file: file.into(), fixes },
            options: options.clone(),
        })
    }

    fn simulated(name: &str, scenario: Scenario, options: &Options) -> Self {
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

    /// The recording's file.
    pub fn file(&self) -> Option<&Path> {
        match &self.source {
            Source::Recording { file, .. } => Some(file),
            Source::Sim(_) => None,
        }
    }

    /// The name as a file's: what a shell would take for something else is replaced.
    pub fn file_stem(&self) -> String {
        match &self.source {
            Source::Recording { .. } => self.name.clone(),
            Source::Sim(_) => self.name.replace([':', '?', '&', '/', '='], "_"),
        }
    }

    /// The readings from the first to the last; ends after the first error.
    pub fn readings(&self) -> Result<Box<dyn Iterator<Item = Result<Reading, ScoreError>>>, ScoreError> {
        let Options { gnss, without_field, reference, .. } = &self.options;
        Ok(match &self.source {
            Source::Recording { file, fixes } => {
                let readings = Recorded::open(file, fixes.as_deref(), !without_field)?;
                match reference.as_deref().map(References::open).transpose()? {
                    None => Box::new(readings.map(|reading| Ok(reading?))),
                    Some(mut references) => Box::new(readings.map(move |reading| {
                        let reading = reading?;
                        let reference = references.interpolate(reading.t_ns)?;
                        Ok(Reading { reference, ..reading })
                    })),
                }
            }
            Source::Sim(scenario) => Box::new(simulated(scenario, *gnss != Gnss::Off, !without_field).map(Ok)),
        })
    }
}

impl Trial {
    /// What the gyro of a simulation reads too much at a time, ns; not known of a recording.
    pub(crate) fn gyro_bias_rad_s(&self) -> Option<impl Fn(i64) -> [f64; 3] + use<>> {
        let Source::Sim(scenario) = &self.source else { return None };
        let sensors = scenario.sensors();
        Some(move |t_ns: i64| sensors.gyro_bias_rad_s(t_ns as f64 * 1e-9).into())
    }
}

/// Reads a file of references to its end.
fn check(file: &Path) -> Result<(), RecordingError> {
    References::open(file)?.interpolate(i64::MAX).map(drop)
}

fn simulated(scenario: &Scenario, with_fixes: bool, with_field: bool) -> impl Iterator<Item = Reading> + use<> {
    let scored_from_s = scenario.scored_from_s;
    scenario.readings().map(move |(t_s, reading)| {
        let q = reading.truth.attitude.quaternion();
        Reading {
            t_ns: (t_s * 1e9).round() as i64,
            rate_rad_s: reading.rate_rad_s.into(),
            force_m_s2: reading.force_m_s2.into(),
            field_ut: reading.field_ut.filter(|_| with_field).map(Into::into),
            fix: reading.fix.filter(|_| with_fixes).map(Into::into),
            reference: Some(Truth { quaternion: [q.w, q.i, q.j, q.k], scored: t_s >= scored_from_s }),
        }
    })
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
        fs::write(&imu, "t_s,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n1,0,0,0,0,0,9.8\n").unwrap();
        let fixes = |gnss: Gnss| -> Vec<_> {
            let trial = Trial::open(imu.to_str().unwrap(), &Options { gnss, ..Options::default() }).unwrap();
            assert_eq!((trial.name.as_str(), trial.rows), ("flight_imu", 2));
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
    fn the_field_can_be_left_out() {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(&file, "t_s,gx,gy,gz,ax,ay,az,mx,my,mz\n0,0,0,0,0,0,9.8,1,2,3\n1,0,0,0,0,0,9.8,1,2,3\n").unwrap();
        for (without_field, expected) in [(false, Some([1.0, 2.0, 3.0])), (true, None)] {
            let options = Options { without_field, ..Options::default() };
            let trial = Trial::open(file.path().to_str().unwrap(), &options).unwrap();
            let fields: Vec<_> = trial.readings().unwrap().map(|reading| reading.unwrap().field_ut).collect();
            assert_eq!(fields, [expected; 2]);
        }
    }

    #[test]
    fn a_simulation_counts_from_where_its_scenario_says_and_ends_where_it_says() {
        let trial = Trial::open("sim:s1?duration_s=8&rate_hz=50", &Options::default()).unwrap();
        assert_eq!((trial.rows, trial.rate_hz, trial.gyro_samples), (401, 50.0, GyroSamples::Instants));
        let readings: Vec<_> = trial.readings().unwrap().map(Result::unwrap).collect();
        assert_eq!(readings.len(), 401);
        let scored = readings.iter().filter(|reading| reading.reference.is_some_and(|truth| truth.scored)).count();
        assert_eq!(scored, 151, "s1 is scored from 5 s");
        assert_eq!(trial.file_stem(), "sim_s1_duration_s_8_rate_hz_50");
        assert_eq!(Trial::open("sim:s9", &Options::default()).unwrap_err().exit_code(), 2);
    }

    #[test]
    fn a_simulated_receiver_can_be_switched_off() {
        let fixes = |gnss| {
            let options = Options { gnss, ..Options::default() };
            let trial = Trial::open("sim:cruise?duration_s=5", &options).unwrap();
            trial.readings().unwrap().filter(|reading| reading.as_ref().unwrap().fix.is_some()).count()
        };
        assert!(fixes(Gnss::Auto) > 0);
        assert_eq!(fixes(Gnss::Off), 0);
    }

    #[test]
    fn a_trial_is_called_as_its_file() {
        for (file, name) in [("a/b.csv.gz", "b"), ("b.csv", "b"), ("x.y_imu.csv.gz", "x.y_imu"), ("b.txt", "b.txt")] {
            assert_eq!(stem(Path::new(file)), name);
        }
    }
}
