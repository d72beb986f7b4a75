//! Linux industrial I/O: records from a buffer's character device, as documented in the kernel's
//! sysfs ABI.
//!
//! [`sysfs`] reads the layout of a device's records and enables its buffer. [`Iio`] decodes the
//! records. The layout comes from the device's folder: position and format of each value
//! (`scan_elements/*_index`, `_type`), scale and offset, the mounting matrix, and the clock of the
//! timestamps.
//!
//! Units: `in_anglvel` in rad/s, `in_accel` in m/s², `in_magn` in gauss, after (raw + offset) ×
//! scale.
//!
//! Axes: those of the sensor, rotated by the quantity's own mounting matrix or, if there is none,
//! by `in_mount_matrix`.
//!
//! Time: `in_timestamp` on the clock given by `current_timestamp_clock`: UNIX time for `realtime`
//! and `tai`, otherwise time since boot.
//!
//! Many chips appear as two devices, one for each quantity (`lsm6dsm_gyro` and `lsm6dsm_accel`),
//! with separate record files. [`DevicePair`] combines them.
//!
//! Limits: records have no start marker, so a stream that starts in the middle of a record is not
//! detected.

mod pair;
mod records;
pub mod sysfs;

pub use pair::{DevicePair, MAX_GAP_NS, MAX_WAIT_NS};
pub use records::{Channel, Clock, Iio, Layout, Vector};

/// Error while configuring a device through its folder.
#[derive(Debug, thiserror::Error)]
pub enum IioError {
    /// A file cannot be read.
    #[error(
        "reading {}: {cause}; check that the device is present and that this user may read it",
        foreign::path(path)
    )]
    Read {
        /// Path of the file.
        path: std::path::PathBuf,
        /// Operating system error.
        cause: std::io::Error,
    },
    /// A file cannot be written.
    #[error("writing {value:?} to {}: {cause}; grant this user write access with a udev rule", foreign::path(path))]
    Write {
        /// Path of the file.
        path: std::path::PathBuf,
        /// Value to be written.
        value: String,
        /// Operating system error.
        cause: std::io::Error,
    },
    /// A file has unexpected content.
    #[error("reading {}: found {found:?}, expected {expected}", foreign::path(path))]
    Malformed {
        /// Path of the file.
        path: std::path::PathBuf,
        /// First characters of the content.
        found: String,
        /// Expected content.
        expected: &'static str,
    },
    /// No device has this name.
    #[error("no IIO device {name:?} in {}; available: {}", foreign::path(root), names(available))]
    NoDevice {
        /// Folder that contains the device folders.
        root: std::path::PathBuf,
        /// Requested name.
        name: String,
        /// Names of the existing devices.
        available: Vec<String>,
    },
    /// Required channels do not exist or are not enabled.
    #[error(
        "the IIO device has no {missing} channels; for a chip with separate gyro and accelerometer devices set both device and accel_device"
    )]
    MissingChannels {
        /// Names of the missing channels.
        missing: &'static str,
    },
    /// The timestamps of two devices use different clocks.
    #[error(
        "the gyro's timestamps use the clock {gyro:?}, the accelerometer's {accel:?}; set both devices to one clock"
    )]
    ClockMismatch {
        /// Clock of the gyro.
        gyro: Clock,
        /// Clock of the accelerometer.
        accel: Clock,
    },
}

fn names(available: &[String]) -> String {
    if available.is_empty() {
        return "no devices".into();
    }
    foreign::list(&available.iter().map(|name| foreign::ForeignText::from(name.as_str())).collect::<Vec<_>>())
}
