//! User-defined stages, run as separate programs: `[stages.NAME]`.

use std::{collections::BTreeMap, ops::Range, path::PathBuf, process::Command};

use crate::{
    Slot,
    description::Key,
    keys::keys,
    kind::{NAME, NoKey, Texts, one_of},
    problem::Problem,
    toml_reader::Section,
};

/// Maximum number of words in a command.
const MAX_WORDS: usize = 64;

keys! {
    /// Program that runs as the stage of a slot and speaks the stage protocol.
    pub struct ExternalStage {
        /// Slot for which the stage is written.
        slot: Slot = Slot::Fuser, one_of(Slot::ALL.map(|slot| (slot.name(), slot))), example r#""fuser""#;
        /// Program and its arguments. A path is relative to the folder of the launch file. A name
        /// without a slash is looked up in PATH.
        command: Vec<String> = Vec::new(), Texts::<{ usize::MAX }>,
            example r#"["python3", "my-fuser/my_fuser.py"]"#;
        /// Working directory: the folder of the launch file.
        folder: PathBuf = PathBuf::new(), NoKey(stage_folder);
    }
}

impl ExternalStage {
    /// Returns the program's file: a path, or a name to look up in PATH.
    pub fn executable(&self) -> PathBuf {
        let word = self.command.first().map_or("", String::as_str);
        if word.contains('/') { self.folder.join(word) } else { word.into() }
    }

    /// Returns the command, ready to spawn.
    pub fn command(&self) -> Command {
        let mut command = Command::new(self.executable());
        command.args(self.command.iter().skip(1)).current_dir(&self.folder);
        command
    }
}

/// Reads every `[stages.NAME]`. Whether programs exist is checked only if the launch file's folder
/// is known.
pub(crate) fn external_stages(section: &mut Section<'_, '_>, key: Key, out: &mut BTreeMap<String, ExternalStage>) {
    section.named_tables(key, "my-fuser", |section, name, span| {
        let mut stage = ExternalStage::default();
        stage.read_keys(section);
        let is_valid = is_free(section, name, &span) & require(section, name, &span, "slot");
        if require(section, name, &span, "command") && section.are_valid(&["command"]) {
            check_command(section, name, section.folder().is_some(), &stage);
        }
        // A stage with an invalid command is kept, so that a slot that uses it causes no second
        // problem.
        if is_valid {
            out.insert(name.into(), stage);
        }
    });
}

/// Returns the folder of the launch file as an absolute path, because it becomes the working
/// directory of the stage.
fn stage_folder(section: &Section<'_, '_>) -> PathBuf {
    let Some(folder) = section.folder() else { return PathBuf::new() };
    let absolute = std::path::absolute(folder.join("stage")).ok();
    absolute.and_then(|path| Some(path.parent()?.to_path_buf())).unwrap_or_else(|| folder.into())
}

fn is_free(section: &mut Section<'_, '_>, name: &str, span: &Range<usize>) -> bool {
    if (NAME.parse)(name).is_none() {
        let title = format!("stages: expected a name of {}, found {name:?}", NAME.expected);
        section.report(Problem::new(span.clone(), title, "invalid stage name"));
        return false;
    }
    let is_taken = Slot::ALL.into_iter().any(|slot| slot.stages().contains(&name));
    if is_taken {
        let title = format!("stages.{name}: the name belongs to a built-in stage");
        section.report(Problem::new(span.clone(), title, "choose another name"));
    }
    !is_taken
}

fn check_command(section: &mut Section<'_, '_>, name: &str, is_folder_known: bool, stage: &ExternalStage) {
    let error = match stage.command.first() {
        None => Some("expected a program and its arguments, found nothing".to_owned()),
        Some(word) if word.is_empty() => Some("expected a program, found \"\"".to_owned()),
        _ if stage.command.len() > MAX_WORDS => Some(format!("expected at most {MAX_WORDS} words")),
        _ if stage.command.iter().any(|word| word.contains('\0')) => Some("a word contains a NUL byte".to_owned()),
        Some(word) if word.contains('/') && is_folder_known && !stage.executable().is_file() => {
            Some(format!("file {} does not exist", foreign::path(&stage.executable())))
        }
        Some(word) if !word.contains('/') && is_folder_known && !is_in_path(word) => {
            Some(format!("{word:?} is not in PATH"))
        }
        _ => None,
    };
    if let Some(error) = &error {
        let span = section.span("command").unwrap_or_default();
        let note =
            Some("a path is relative to the launch file's folder; a name without a slash is searched in PATH".into());
        let title = format!("stages.{name}.command: {error}");
        section.report(Problem { note, ..Problem::new(span, title, "invalid command") });
    }
}

fn is_in_path(name: &str) -> bool {
    std::env::var_os("PATH").is_some_and(|path| std::env::split_paths(&path).any(|folder| folder.join(name).is_file()))
}

/// Returns `true` if the key is present. Otherwise reports it as missing.
fn require(section: &mut Section<'_, '_>, name: &str, span: &Range<usize>, key: &str) -> bool {
    let is_present = section.missing(&[key]).is_none();
    if !is_present {
        let title = format!("stages.{name}: {key} is missing");
        let help = Some(r#"set slot = "fuser" and command = ["python3", "my_fuser.py"]"#.into());
        section.report(Problem { help, ..Problem::new(span.clone(), title, format!("expected {key}")) });
    }
    is_present
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Launch;

    const COMPLETE: &str = "[stages.my-fuser]\nslot = \"fuser\"\ncommand = [\"python3\", \"my_fuser.py\"]\n";

    #[test]
    fn external_stage_accepts_any_parameter() {
        let text = format!("[fuser]\nstage = \"my-fuser\"\nset = {{ gain = 0.5, anything = 3 }}\n{COMPLETE}");
        let launch = Launch::parse("launch.toml", &text).unwrap();
        let stage = launch.external_stage(Slot::Fuser).unwrap();
        assert_eq!((stage.slot, stage.executable()), (Slot::Fuser, "python3".into()));
        assert_eq!(stage.command().get_args().collect::<Vec<_>>(), ["my_fuser.py"]);
        assert_eq!(launch.fuser.set.keys().collect::<Vec<_>>(), ["anything", "gain"]);
        let unused = Launch::parse("launch.toml", COMPLETE).unwrap();
        assert_eq!((unused.stages.len(), unused.external_stage(Slot::Fuser)), (1, None));
    }

    #[test]
    fn each_invalid_entry_is_reported_at_its_location() {
        let cases = [
            (COMPLETE.replace("my-fuser", "wz"), ":1:", "belongs to a built-in stage"),
            (COMPLETE.replace("my-fuser", "\"My fuser\""), ":1:", "expected a name of 1 to 32"),
            (COMPLETE.replace("\"fuser\"", "\"fusr\""), ":2:8\n", "did you mean \"fuser\"?"),
            (
                COMPLETE.replace("\"fuser\"", "\"ingest\""),
                ":2:8\n",
                "allowed: \"gyro\", \"accel\", \"fuser\", \"course\"",
            ),
            (COMPLETE.replace("slot = \"fuser\"", ""), ":1:", "stages.my-fuser: slot is missing"),
            (COMPLETE.replace("command = [\"python3\", \"my_fuser.py\"]", ""), ":1:", "command is missing"),
            (COMPLETE.replace("[\"python3\", \"my_fuser.py\"]", "\"python3\""), ":3:11\n", "an array of strings"),
            (COMPLETE.replace("[\"python3\", \"my_fuser.py\"]", "[]"), ":3:11\n", "found nothing"),
            (COMPLETE.replace("\"python3\"", "\"\""), ":3:11\n", "found \"\""),
            (format!("{COMPLETE}folder = \"x\"\n"), ":4:1\n", "unknown key \"folder\""),
            (format!("[gyro]\nstage = \"my-fuser\"\n{COMPLETE}"), ":2:9\n", "gyro.stage: unknown value \"my-fuser\""),
            (format!("[fuser]\nstage = \"my-fuse\"\n{COMPLETE}"), ":2:9\n", "did you mean \"my-fuser\"?"),
            (format!("[fuser]\nstage = \"my-fuser\"\nset.gain = \"1\"\n{COMPLETE}"), ":3:12\n", "expected a number"),
            ("stages = 3".to_owned(), ":1:10\n", "stages: expected a table"),
            ("stages.mine = 3".to_owned(), ":1:15\n", "stages.mine: expected a table"),
        ];
        for (text, location, expected) in cases {
            let shown = Launch::parse("launch.toml", &text).unwrap_err().to_string();
            assert!(shown.contains(location) && shown.contains(expected), "{location}{expected}:\n{shown}");
            assert!(shown.ends_with("1 problem"), "{expected}:\n{shown}");
        }
    }

    #[test]
    fn relative_program_must_exist_in_launch_file_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("launch.toml");
        std::fs::write(&path, COMPLETE.replace("python3", "./run")).unwrap();
        let shown = Launch::read(&path).unwrap_err().to_string();
        assert!(shown.contains("does not exist") && shown.contains(":3:11"), "{shown}");
        let used = format!("[fuser]\nstage = \"my-fuser\"\n{}", COMPLETE.replace("python3", "no-such-program"));
        std::fs::write(&path, used).unwrap();
        let shown = Launch::read(&path).unwrap_err().to_string();
        assert!(shown.contains("\"no-such-program\" is not in PATH"), "{shown}");
        assert!(shown.ends_with("1 problem"), "the slot has no problem of its own: {shown}");
        std::fs::write(&path, COMPLETE.replace("python3", "./run")).unwrap();
        std::fs::write(folder.path().join("run"), "").unwrap();
        let launch = Launch::read(&path).unwrap();
        assert_eq!(launch.stages["my-fuser"].executable(), folder.path().join("./run"));
        assert_eq!(launch.stages["my-fuser"].folder, folder.path());
    }
}
