//! Helpers that generate logs, import them and read the results.

use std::{
    fs,
    path::{Path, PathBuf},
};

use import::{ImportError, Mapping, Options, Summary, convert};
use recording::{
    Reader, Row,
    gnss::{self, Fix, FixReader},
};
use tempfile::TempDir;

/// Result of an import, with the rows and fixes read from its output files.
#[derive(Debug)]
pub(crate) struct Imported {
    pub(crate) summary: Summary,
    pub(crate) rows: Vec<Row>,
    pub(crate) fixes: Vec<Fix>,
}

/// Temporary folder.
pub(crate) struct Folder(TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn file(&self, name: &str, contents: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, contents).unwrap();
        path
    }

    pub(crate) fn names(&self) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(self.0.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// Returns an error message with the folder path removed.
    pub(crate) fn message(&self, error: &ImportError) -> String {
        error.to_string().replace(&format!("{}/", self.0.path().display()), "")
    }

    pub(crate) fn import(&self, paths: &[PathBuf], mapping: Option<Mapping>) -> Result<Imported, ImportError> {
        self.import_with(paths, &Options { mapping, ..Options::default() })
    }

    pub(crate) fn import_with(&self, paths: &[PathBuf], options: &Options) -> Result<Imported, ImportError> {
        let out = self.path("out_imu.csv");
        let _ = fs::remove_file(self.path("out_gnss.csv"));
        let summary = convert(paths, options, &out, &mut |_| {})?;
        Ok(Imported { summary, rows: rows(&out), fixes: fixes(&out) })
    }
}

pub(crate) fn rows(path: &Path) -> Vec<Row> {
    Reader::open(path).unwrap().map(Result::unwrap).collect()
}

fn fixes(recording: &Path) -> Vec<Fix> {
    let Some(path) = gnss::find_for(recording) else { return vec![] };
    let text = fs::read_to_string(&path).unwrap();
    let mut fixes = FixReader::open(&path).unwrap();
    let times = text.lines().skip(1).map(|line| {
        let (whole_s, fraction) =
            line.split(',').next().unwrap().split_once('.').unwrap_or((line.split(',').next().unwrap(), ""));
        format!("{whole_s}{fraction:0<9}").parse::<i64>().unwrap()
    });
    times.map(|t_ns| fixes.latest_until(t_ns).unwrap().unwrap()).collect()
}

/// Returns the path of a recorded log. If the test data is missing, prints a note to stderr and
/// returns `None`.
pub(crate) fn log(name: &str) -> Option<PathBuf> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = std::env::var_os("PLUMBLINE_DATA").map_or_else(|| here.join("../../../shared/data"), PathBuf::from);
    if folder.is_dir() {
        return Some(folder.join("logs").join(name));
    }
    assert!(std::env::var_os("PLUMBLINE_DATA").is_none(), "no recordings at {}", folder.display());
    eprintln!("skipped: no recordings at {} (set PLUMBLINE_DATA to their folder)", folder.display());
    None
}

pub(crate) const COMBINED: &str = "sensor_combined:uint64_t timestamp;float[3] gyro_rad;float gyro_integral_dt;\
    int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;";
pub(crate) const OLD_COMBINED: &str = "sensor_combined:uint64_t timestamp;float[3] gyro_rad;\
    int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;\
    int32_t magnetometer_timestamp_relative;float[3] magnetometer_ga;";
pub(crate) const MAGNETOMETER: &str =
    "vehicle_magnetometer:uint64_t timestamp;uint64_t timestamp_sample;float[3] magnetometer_ga;uint8_t[4] _padding0;";
pub(crate) const ATTITUDE: &str = "vehicle_attitude:uint64_t timestamp;float[4] q;uint8_t quat_reset_counter;";
pub(crate) const RECEIVER: &str = "vehicle_gps_position:uint64_t timestamp;int32_t lat;int32_t lon;int32_t alt;\
    float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;bool vel_ned_valid;";
pub(crate) const RECEIVER_DEGREES: &str = "sensor_gps:uint64_t timestamp;double latitude_deg;double longitude_deg;\
    double altitude_msl_m;float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;bool vel_ned_valid;";

/// Writer of a ULog.
#[derive(Clone)]
pub(crate) struct Log(pub(crate) Vec<u8>);

impl Log {
    /// Writes the header and the formats of `topics`, which get the ids 0, 1 and so on.
    pub(crate) fn new(topics: &[&str]) -> Self {
        let mut log = Self([&b"ULog\x01\x12\x35\x01"[..], &[0; 8]].concat());
        log.message(b'B', &[0; 40]);
        topics.iter().for_each(|format| log.message(b'F', format.as_bytes()));
        for (id, format) in (0..).zip(topics) {
            log.subscribe(id, 0, format.split(':').next().unwrap());
        }
        log
    }

    pub(crate) fn message(&mut self, kind: u8, content: &[u8]) {
        self.0.extend_from_slice(&u16::try_from(content.len()).unwrap().to_le_bytes());
        self.0.push(kind);
        self.0.extend_from_slice(content);
    }

    /// Writes the subscription of a topic instance.
    pub(crate) fn subscribe(&mut self, id: u16, instance: u8, topic: &str) {
        self.message(b'A', &[&[instance][..], &id.to_le_bytes(), topic.as_bytes()].concat());
    }

    /// Writes a sample with its topic id, its time in µs and its other fields.
    pub(crate) fn sample(&mut self, id: u16, t_us: u64, fields: &[&dyn Bytes]) {
        let mut content = [&id.to_le_bytes()[..], &t_us.to_le_bytes()].concat();
        fields.iter().for_each(|field| content.extend(field.bytes()));
        self.message(b'D', &content);
    }

    /// Writes a [`COMBINED`] sample. `relative_us` is the force time relative to the rate time.
    pub(crate) fn combined(&mut self, t_us: u64, gyro: [f32; 3], relative_us: i32, accel: [f32; 3]) {
        self.sample(0, t_us, &[&gyro, &0.004f32, &relative_us, &accel]);
    }
}

/// Value in little-endian binary form.
pub(crate) trait Bytes {
    fn bytes(&self) -> Vec<u8>;
}

macro_rules! bytes {
    ($($type:ty)*) => { $(
        impl Bytes for $type {
            fn bytes(&self) -> Vec<u8> {
                self.to_le_bytes().into()
            }
        }
    )* };
}
bytes!(f32 f64 i32 u8 u32 u64);

impl<T: Bytes, const N: usize> Bytes for [T; N] {
    fn bytes(&self) -> Vec<u8> {
        self.iter().flat_map(Bytes::bytes).collect()
    }
}
