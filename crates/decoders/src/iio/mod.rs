//! Linux industrial I/O: the records of a buffer's character device, as the kernel's documentation of its sysfs has them.
//!
//! [`sysfs`] reads how a device's records are made and switches its buffer on; [`Iio`] decodes the records. What is known of a value
//! comes from the device's folder: its place and format (`scan_elements/*_index`, `_type`), its scale and offset, the matrix by which
//! the sensor is mounted, and the clock of the time stamps.
//!
//! Units: `in_anglvel` in rad/s, `in_accel` in m/s², `in_magn` in gauss, after (raw + offset) × scale. Axes: the sensor's, turned by
//! `in_mount_matrix`, or that of each quantity. Time: `in_timestamp`, by the clock of `current_timestamp_clock`: from 1970 of
//! `realtime` and `tai`, else since the start.
//!
//! Many chips are two devices, one for each quantity (`lsm6dsm_gyro` and `lsm6dsm_accel`), with two files of records: [`Pair`] takes both.
//!
//! Limits: records carry no mark, so what begins inside of one cannot be seen.

mod pair;
mod records;
pub mod sysfs;

pub use pair::{GAP_MAX_NS, Pair, WAIT_MAX_NS};
pub use records::{Channel, Clock, Iio, Layout, Vector};

/// What is wrong with a device's folder.
#[derive(Debug, thiserror::Error)]
pub enum IioError {
    /// A file that cannot be read.
    #[error("reading {}: {cause}; check that the device is there and that this user may read it", path.display())]
    Read {
        /// The file.
        path: std::path::PathBuf,
        /// What the system said.
        cause: std::io::Error,
    },
    /// A file that cannot be written.
    #[error("writing {found:?} to {}: {cause}; let this user write it by a udev rule", path.display())]
    Write {
        /// The file.
        path: std::path::PathBuf,
        /// What was to be written.
        found: String,
        /// What the system said.
        cause: std::io::Error,
    },
    /// A file with something else in it.
    #[error("reading {}: found {found:?}, expected {expected}", path.display())]
    Malformed {
        /// The file.
        path: std::path::PathBuf,
        /// What is there, shortened.
        found: String,
        /// What was expected.
        expected: &'static str,
    },
    /// No device of that name.
    #[error("looking for the device {name:?} in {}: there is none; there are {}", root.display(), names(known))]
    NoDevice {
        /// The folder of devices.
        root: std::path::PathBuf,
        /// The name.
        name: String,
        /// Those that are there.
        known: Vec<String>,
    },
    /// Channels that must be there, and switched on.
    #[error("reading the channels of a device: found none of {missing}; of a chip that is two devices, name both")]
    Missing {
        /// What is not there.
        missing: &'static str,
    },
    /// Two devices whose time stamps cannot be compared.
    #[error("pairing two devices: the time stamps are by {gyro:?} and {accel:?}, expected one clock")]
    Clocks {
        /// Of the gyro.
        gyro: Clock,
        /// Of the accelerometer.
        accel: Clock,
    },
}

fn names(known: &[String]) -> String {
    if known.is_empty() { "no devices".into() } else { known.join(", ") }
}
