//! State folder of the user, and boot ID of the machine.

use std::{env, ffi::OsString, fs, path::PathBuf};

/// Returns the boot ID of the kernel, or an empty text if it is unknown.
pub fn boot_id() -> String {
    fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default().trim().to_owned()
}

/// Returns the folder for files that outlast a run, or `None` if the environment names none.
pub fn state_folder() -> Option<PathBuf> {
    state_folder_from(|name| env::var_os(name))
}

/// Returns the folder for state files: the one given by systemd, else that of the XDG base
/// directory specification.
fn state_folder_from(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let absolute = |name| variable(name).map(PathBuf::from).filter(|path| path.is_absolute());
    // systemd separates multiple folders by colons. The first one is used.
    let systemd = variable("STATE_DIRECTORY").and_then(|all| env::split_paths(&all).next());
    let user = || absolute("XDG_STATE_HOME").or_else(|| absolute("HOME").map(|home| home.join(".local/state")));
    systemd.filter(|path| path.is_absolute()).or_else(|| user().map(|folder| folder.join("plumbline")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn state_folder_prefers_systemd_then_user() {
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
            assert_eq!(state_folder_from(variable), expected.map(PathBuf::from), "{variables:?}");
        }
    }
}
