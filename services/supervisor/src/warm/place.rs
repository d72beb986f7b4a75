//! Where the state file is, and for which runs there is one.

use std::{env, ffi::OsString, path::PathBuf};

use launch::{Launch, Service, Source, StateFile};

/// The state file of a run; none for one that must not depend on the runs before it. `live`: in real time, as processes.
pub(crate) fn place(launch: &Launch, live: bool) -> Option<PathBuf> {
    // What calibrates the sensors and what finds the bias are known to one host only where both are on it.
    let whole = [Service::Ingest, Service::Fuser].iter().all(|service| launch.services.contains(service));
    // A fault that somebody scripted is none of the sensor's.
    if !live || !whole || !launch.ingest.faults.is_empty() {
        return None;
    }
    match (&launch.state_file, launch.ingest.source) {
        (StateFile::Off, _) | (_, Source::Replay | Source::Stdin) | (StateFile::Auto, Source::Sim) => None,
        (StateFile::File(path), _) => Some(path.clone()),
        (StateFile::Auto, Source::Bus | Source::Udp | Source::Tcp | Source::Serial | Source::Mavlink | Source::Iio) => {
            folder(|name| env::var_os(name)).map(|folder| folder.join(file(launch)))
        }
    }
}

fn file(launch: &Launch) -> String {
    format!("{}.state", launch.name)
}

/// The folder for such files: systemd's, else that of the XDG base directory specification.
fn folder(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let absolute = |name| variable(name).map(PathBuf::from).filter(|path| path.is_absolute());
    // systemd separates several by colons.
    let systemd = variable("STATE_DIRECTORY").and_then(|all| env::split_paths(&all).next());
    let user = || absolute("XDG_STATE_HOME").or_else(|| absolute("HOME").map(|home| home.join(".local/state")));
    systemd.filter(|path| path.is_absolute()).or_else(|| user().map(|folder| folder.join("plumbline")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_is_that_of_the_service_or_of_the_user() {
        type Case<'a> = (&'a [(&'a str, &'a str)], Option<&'a str>);
        let cases: &[Case<'_>] = &[
            (&[("STATE_DIRECTORY", "/var/lib/plumbline"), ("HOME", "/home/a")], Some("/var/lib/plumbline")),
            (&[("STATE_DIRECTORY", "/var/lib/a:/var/lib/b")], Some("/var/lib/a")),
            (&[("XDG_STATE_HOME", "/s"), ("HOME", "/home/a")], Some("/s/plumbline")),
            (&[("XDG_STATE_HOME", "relative"), ("HOME", "/home/a")], Some("/home/a/.local/state/plumbline")),
            (&[], None),
        ];
        for (variables, expected) in cases {
            let variable = |name: &str| variables.iter().find(|(key, _)| *key == name).map(|(_, value)| value.into());
            assert_eq!(folder(variable), expected.map(PathBuf::from), "{variables:?}");
        }
    }

    #[test]
    fn only_a_run_in_real_time_has_one_and_a_simulation_only_where_it_is_named() {
        let launch = |text: &str| Launch::parse("x", text).unwrap();
        let named = "state_file = \"/s/imu\"\n";
        let kept = |text: &str| place(&launch(&format!("{named}{text}")), true);
        assert_eq!(kept(""), Some("/s/imu".into()));
        assert_eq!(kept("ingest.source = \"bus\""), Some("/s/imu".into()));
        assert_eq!(kept("ingest = { source = \"replay\", replay.file = \"a.csv\" }"), None);
        let fault = "faults = true\n[[ingest.fault]]\nsensor = \"gyro\"\nkind = \"stuck\"\nfrom_s = 1\nuntil_s = 2";
        assert_eq!(kept(fault), None);
        assert_eq!(place(&launch(named), false), None, "a run that is not in real time");
        assert_eq!(place(&launch(""), true), None, "a simulation by default");
        assert_eq!(place(&launch("state_file = \"off\"\ningest.source = \"bus\""), true), None);
        let of_a_sensor = place(&launch("name = \"wing\"\ningest.source = \"bus\""), true);
        assert_eq!(of_a_sensor, folder(|name| env::var_os(name)).map(|folder| folder.join("wing.state")));
    }
}
