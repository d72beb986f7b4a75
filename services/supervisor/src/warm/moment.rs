//! When a state was kept, and how long ago that is.
//!
//! The clock on the wall is read here and nowhere else, and decides nothing but how much a bias of an earlier run is worth.

use std::{fs, path::Path};

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

/// By how much a clock with a battery and the system's may differ, s.
const AGREES_S: f64 = 60.0;
/// The year 2020, s since 1970: a clock that says less was never set.
const FIRST_S: f64 = 1_577_836_800.0;

/// A point in time, by every clock that may be told from another run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Moment {
    /// The kernel's name of this boot; empty where it is not told.
    pub(super) boot: String,
    /// CLOCK_BOOTTIME, s: since the machine was started, asleep or not.
    pub(super) since_boot_s: f64,
    /// CLOCK_REALTIME, s since 1970.
    pub(super) unix_s: f64,
    /// That clock was set by the network or by a clock with a battery.
    pub(super) is_set: bool,
}

/// How long ago a moment was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Since {
    /// In the same boot, s.
    SameBoot(f64),
    /// Before the machine was started, s.
    OtherBoot(f64),
    /// No clock tells.
    Unknown,
}

impl Moment {
    pub(super) fn now() -> Self {
        let unix_s = seconds(ClockId::Realtime);
        let boot = fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        Self {
            boot: boot.trim().into(),
            since_boot_s: seconds(ClockId::Boottime),
            unix_s,
            is_set: is_set(Path::new("/"), unix_s),
        }
    }

    /// How long ago `then` was; below zero where it is yet to come.
    pub(super) fn since(&self, then: &Self) -> Since {
        if !self.boot.is_empty() && self.boot == then.boot {
            Since::SameBoot(self.since_boot_s - then.since_boot_s)
        } else if self.is_set && then.is_set {
            Since::OtherBoot(self.unix_s - then.unix_s)
        } else {
            Since::Unknown
        }
    }
}

fn seconds(clock: ClockId) -> f64 {
    let now = clock_gettime(clock);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// Whether the clock on the wall is right: a machine without a battery starts with the time of its last shutdown.
fn is_set(root: &Path, unix_s: f64) -> bool {
    let by_network = || root.join("run/systemd/timesync/synchronized").exists();
    let by_battery = || {
        let clocks = fs::read_dir(root.join("sys/class/rtc")).into_iter().flatten().flatten();
        let mut told = clocks.filter_map(|clock| fs::read_to_string(clock.path().join("since_epoch")).ok());
        told.any(|text| text.trim().parse().is_ok_and(|battery_s: f64| (battery_s - unix_s).abs() < AGREES_S))
    };
    unix_s > FIRST_S && (by_network() || by_battery())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_on_the_wall_is_believed_where_network_or_battery_confirm_it() {
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
    fn within_a_boot_only_the_time_since_it_counts() {
        let now = Moment::now();
        assert!(!now.boot.is_empty() && now.since_boot_s > 0.0);
        let clock_set_back = Moment { unix_s: now.unix_s - 1e6, since_boot_s: now.since_boot_s + 5.0, ..now.clone() };
        assert_eq!(clock_set_back.since(&now), Since::SameBoot(clock_set_back.since_boot_s - now.since_boot_s));
        let other = Moment { boot: "another".into(), is_set: true, ..now.clone() };
        assert_eq!(
            Moment { is_set: true, unix_s: now.unix_s + 60.0, ..now.clone() }.since(&other),
            Since::OtherBoot(60.0)
        );
        assert_eq!(Moment { is_set: false, ..now.clone() }.since(&other), Since::Unknown);
        let nameless = Moment { boot: String::new(), is_set: false, ..now };
        assert_eq!(nameless.since(&nameless.clone()), Since::Unknown);
    }
}
