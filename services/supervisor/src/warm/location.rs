//! Determines which runs have a state file, and the path of the file.

use std::path::PathBuf;

use launch::{Launch, Service, Source, StateFile};
use runtime::machine::state_folder;

/// Returns the path of the state file, or `None` for a run that must not depend on earlier runs.
///
/// `is_live` is `true` for a run in real time with one process per service.
pub(crate) fn state_file_path(launch: &Launch, is_live: bool) -> Option<PathBuf> {
    // The calibration is known on the host of ingest and the bias on the host of the fuser, so both
    // services must run here.
    let has_both = [Service::Ingest, Service::Fuser].iter().all(|service| launch.services.contains(service));
    // Runs with injected faults are excluded, because such faults are not errors of the sensor.
    if !is_live || !has_both || !launch.ingest.faults.is_empty() {
        return None;
    }
    match (&launch.state_file, launch.ingest.source) {
        (StateFile::Off, _) | (_, Source::Replay | Source::Stdin) | (StateFile::Auto, Source::Sim) => None,
        (StateFile::File(path), _) => Some(path.clone()),
        (StateFile::Auto, Source::Bus | Source::Udp | Source::Tcp | Source::Serial | Source::Mavlink | Source::Iio) => {
            state_folder().map(|folder| folder.join(file_name(launch)))
        }
    }
}

fn file_name(launch: &Launch) -> String {
    format!("{}.state", launch.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn state_file_requires_live_run_and_named_file_for_sim() {
        let launch = |text: &str| Launch::parse("x", text).unwrap();
        let named = "state_file = \"/s/imu\"\n";
        let path_for = |text: &str| state_file_path(&launch(&format!("{named}{text}")), true);
        assert_eq!(path_for(""), Some("/s/imu".into()));
        assert_eq!(path_for("ingest.source = \"bus\""), Some("/s/imu".into()));
        assert_eq!(path_for("ingest = { source = \"replay\", replay.file = \"a.csv\" }"), None);
        let fault = "faults = true\n[[ingest.fault]]\nsensor = \"gyro\"\nkind = \"stuck\"\nfrom_s = 1\nuntil_s = 2";
        assert_eq!(path_for(fault), None);
        assert_eq!(state_file_path(&launch(named), false), None, "not in real time");
        assert_eq!(state_file_path(&launch(""), true), None, "simulation by default");
        assert_eq!(state_file_path(&launch("state_file = \"off\"\ningest.source = \"bus\""), true), None);
        let of_a_sensor = state_file_path(&launch("name = \"wing\"\ningest.source = \"bus\""), true);
        assert_eq!(of_a_sensor, state_folder().map(|folder| folder.join("wing.state")));
    }
}
