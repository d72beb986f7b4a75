//! Timestamps in state files, and the age of a file.
//!
//! Wall-clock time is read only here, and only to determine the weight of an earlier run's bias.

use std::{fs, path::Path};

use runtime::machine::boot_id;
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

/// Maximum difference between the system clock and a hardware clock, s. A larger difference means
/// that the hardware clock does not confirm the system clock.
const MAX_CLOCK_DIFFERENCE_S: f64 = 60.0;
/// Start of the year 2020, s since 1970. An earlier system time means that the clock was not set.
const MIN_PLAUSIBLE_UNIX_S: f64 = 1_577_836_800.0;

/// Point in time, read from each of the clocks that can be compared across runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Timestamp {
    /// Boot ID of the kernel; empty if unknown.
    pub(super) boot: String,
    /// Time since boot, including suspend, on CLOCK_BOOTTIME, s.
    pub(super) since_boot_s: f64,
    /// CLOCK_REALTIME, s since 1970.
    pub(super) unix_s: f64,
    /// Set if the network or a battery-backed real-time clock has confirmed CLOCK_REALTIME.
    pub(super) is_set: bool,
}

/// Age of a timestamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Age {
    /// Age within the same boot, s.
    SameBoot(f64),
    /// Age of a timestamp from an earlier boot, s.
    OtherBoot(f64),
    /// The two timestamps have no common clock.
    Unknown,
}

impl Timestamp {
    pub(super) fn now() -> Self {
        let unix_s = seconds(ClockId::Realtime);
        Self {
            boot: boot_id(),
            since_boot_s: seconds(ClockId::Boottime),
            unix_s,
            is_set: is_set(Path::new("/"), unix_s),
        }
    }

    /// Returns the age of `then`; negative if it is in the future.
    pub(super) fn age_of(&self, then: &Self) -> Age {
        if !self.boot.is_empty() && self.boot == then.boot {
            Age::SameBoot(self.since_boot_s - then.since_boot_s)
        } else if self.is_set && then.is_set {
            Age::OtherBoot(self.unix_s - then.unix_s)
        } else {
            Age::Unknown
        }
    }
}

fn seconds(clock: ClockId) -> f64 {
    let now = clock_gettime(clock);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// Returns `true` if the network or a hardware clock confirms the system clock.
///
/// This matters because a machine whose clock has no battery boots with the time of its last
/// shutdown.
fn is_set(root: &Path, unix_s: f64) -> bool {
    let by_network = || root.join("run/systemd/timesync/synchronized").exists();
    let by_battery = || {
        let clocks = fs::read_dir(root.join("sys/class/rtc")).into_iter().flatten().flatten();
        let mut readings = clocks.filter_map(|clock| fs::read_to_string(clock.path().join("since_epoch")).ok());
        readings.any(|text| {
            text.trim().parse().is_ok_and(|battery_s: f64| (battery_s - unix_s).abs() < MAX_CLOCK_DIFFERENCE_S)
        })
    };
    unix_s > MIN_PLAUSIBLE_UNIX_S && (by_network() || by_battery())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clock_is_set_if_network_or_rtc_confirms_it() {
        let (root, unix_s) = (tempfile::tempdir().unwrap(), 1_700_000_000.0);
        assert!(!is_set(root.path(), unix_s));
        let rtc = root.path().join("sys/class/rtc/rtc0");
        fs::create_dir_all(&rtc).unwrap();
        for (battery_s, agrees) in [("1700000030\n", true), ("1700003600\n", false), ("12\n", false), ("", false)] {
            fs::write(rtc.join("since_epoch"), battery_s).unwrap();
            assert_eq!(is_set(root.path(), unix_s), agrees, "{battery_s:?}");
        }
        fs::create_dir_all(root.path().join("run/systemd/timesync")).unwrap();
        fs::write(root.path().join("run/systemd/timesync/synchronized"), "").unwrap();
        assert!(is_set(root.path(), unix_s));
        assert!(!is_set(root.path(), 12.0), "in the year 1970");
    }

    #[test]
    fn same_boot_age_ignores_wall_clock() {
        let now = Timestamp::now();
        assert!(!now.boot.is_empty() && now.since_boot_s > 0.0);
        let clock_set_back =
            Timestamp { unix_s: now.unix_s - 1e6, since_boot_s: now.since_boot_s + 5.0, ..now.clone() };
        assert_eq!(clock_set_back.age_of(&now), Age::SameBoot(clock_set_back.since_boot_s - now.since_boot_s));
        let other = Timestamp { boot: "another".into(), is_set: true, ..now.clone() };
        assert_eq!(
            Timestamp { is_set: true, unix_s: now.unix_s + 60.0, ..now.clone() }.age_of(&other),
            Age::OtherBoot(60.0)
        );
        assert_eq!(Timestamp { is_set: false, ..now.clone() }.age_of(&other), Age::Unknown);
        let nameless = Timestamp { boot: String::new(), is_set: false, ..now };
        assert_eq!(nameless.age_of(&nameless.clone()), Age::Unknown);
    }
}
