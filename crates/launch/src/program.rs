//! Stages of the user's own: `[stages.NAME]`, a program for a slot.

use std::{
    ops::Range,
    path::{Path, PathBuf},
    process::Command,
};

use attitude::{accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro};
use serde::{Deserialize, Serialize};

use crate::{Launch, Service, problem::Problem, walk::Section};

/// Words of a command at most.
const WORDS_MAX: usize = 64;

/// A program that fills a slot: any that answers the slot's service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Program {
    /// The slot.
    pub slot: Service,
    /// What is started, and its arguments. A name without a slash is looked for in PATH, one with it from `folder`.
    pub command: Vec<String>,
    /// Where it is started: the launch file's folder.
    pub folder: PathBuf,
}

impl Program {
    /// The file to start: a path with its folder, or a name for PATH.
    pub fn file(&self) -> PathBuf {
        let word = self.command.first().map_or("", String::as_str);
        if word.contains('/') { self.folder.join(word) } else { word.into() }
    }

    /// The command, to be started.
    pub fn command(&self) -> Command {
        let mut command = Command::new(self.file());
        command.args(self.command.iter().skip(1)).current_dir(&self.folder);
        command
    }
}

impl Launch {
    /// The program that fills a slot, where it is no stage of Plumbline's.
    pub fn program(&self, slot: Service) -> Option<&Program> {
        self.stages.get(&self.slot(slot)?.stage).filter(|program| program.slot == slot)
    }
}

/// Every `[stages.NAME]`; paths are looked for only where the file's `folder` is known.
pub(crate) fn programs(section: &mut Section<'_, '_>, folder: Option<&Path>, launch: &mut Launch) {
    section.named_tables("stages", |section, name, place| {
        let mut program =
            Program { slot: Service::Ingest, command: Vec::new(), folder: folder.unwrap_or(Path::new("")).into() };
        let fills = is_free(section, name, &place) & slot(section, name, &place, &mut program);
        command(section, name, &place, folder, &mut program);
        // One whose command is wrong is a stage all the same: a slot that names it has no problem of its own.
        if fills {
            launch.stages.insert(name.into(), program);
        }
    });
}

fn is_free(section: &mut Section<'_, '_>, name: &str, place: &Range<usize>) -> bool {
    let legal = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-');
    if !((1..=32).contains(&name.len()) && name.bytes().all(legal)) {
        let title = format!("stages: expected a name of 1 to 32 of a-z, 0-9, \"_\" and \"-\", found {name:?}");
        section.report(Problem::new(place.clone(), title, "no name of a stage"));
        return false;
    }
    let mut own = [&Gyro::NAMES[..], &Accelerometer::NAMES, &Fuser::NAMES, &Course::NAMES].into_iter().flatten();
    let taken = own.any(|own| *own == name);
    if taken {
        let title = format!("stages.{name}: that is the name of one of Plumbline's own stages");
        section.report(Problem::new(place.clone(), title, "choose another name"));
    }
    !taken
}

fn slot(section: &mut Section<'_, '_>, name: &str, place: &Range<usize>, program: &mut Program) -> bool {
    let allowed: Vec<_> = Service::SLOTS.iter().map(|slot| (slot.name(), *slot)).collect();
    needs(section, name, place, "slot") && section.choice("slot", allowed, &mut program.slot)
}

fn command(
    section: &mut Section<'_, '_>,
    name: &str,
    place: &Range<usize>,
    folder: Option<&Path>,
    program: &mut Program,
) {
    if !(needs(section, name, place, "command") && section.strings("command", &mut program.command)) {
        return;
    }
    let wrong = match program.command.first() {
        None => Some("expected a program and its arguments, found nothing".to_owned()),
        Some(word) if word.is_empty() => Some("expected a program, found \"\"".to_owned()),
        _ if program.command.len() > WORDS_MAX => Some(format!("expected at most {WORDS_MAX} words")),
        _ if program.command.iter().any(|word| word.contains('\0')) => Some("a word holds a zero".to_owned()),
        Some(word) if word.contains('/') && folder.is_some() && !program.file().is_file() => {
            Some(format!("there is no file {}", program.file().display()))
        }
        Some(word) if !word.contains('/') && folder.is_some() && !is_in_path(word) => {
            Some(format!("no folder of PATH has a file {word:?}"))
        }
        _ => None,
    };
    if let Some(wrong) = &wrong {
        let span = section.span("command").unwrap_or_default();
        let note = Some("a path is taken from the launch file's folder, a name without a slash from PATH".into());
        let title = format!("stages.{name}.command: {wrong}");
        section.report(Problem { note, ..Problem::new(span, title, "no command") });
    }
}

fn is_in_path(name: &str) -> bool {
    std::env::var_os("PATH").is_some_and(|path| std::env::split_paths(&path).any(|folder| folder.join(name).is_file()))
}

/// Reports a key that is not there.
fn needs(section: &mut Section<'_, '_>, name: &str, place: &Range<usize>, key: &str) -> bool {
    let there = section.has(key);
    if !there {
        let title = format!("stages.{name}: {key} is missing");
        let help = Some(r#"write slot = "fuser" and command = ["python3", "my_fuser.py"]"#.into());
        section.report(Problem { help, ..Problem::new(place.clone(), title, format!("expected {key}")) });
    }
    there
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: &str = "[stages.my-fuser]\nslot = \"fuser\"\ncommand = [\"python3\", \"my_fuser.py\"]\n";

    #[test]
    fn a_stage_of_ones_own_fills_its_slot_with_any_number_set() {
        let text = format!("[fuser]\nstage = \"my-fuser\"\nset = {{ gain = 0.5, anything = 3 }}\n{WHOLE}");
        let launch = Launch::parse("launch.toml", &text).unwrap();
        let program = launch.program(Service::Fuser).unwrap();
        assert_eq!((program.slot, program.file()), (Service::Fuser, "python3".into()));
        assert_eq!(program.command().get_args().collect::<Vec<_>>(), ["my_fuser.py"]);
        assert_eq!(launch.fuser.set.keys().collect::<Vec<_>>(), ["anything", "gain"]);
        let unused = Launch::parse("launch.toml", WHOLE).unwrap();
        assert_eq!((unused.stages.len(), unused.program(Service::Fuser)), (1, None));
    }

    #[test]
    fn each_problem_of_a_stage_of_ones_own_points_at_its_place() {
        let cases = [
            (WHOLE.replace("my-fuser", "wz"), ":1:", "the name of one of Plumbline's own"),
            (WHOLE.replace("my-fuser", "\"My fuser\""), ":1:", "expected a name of 1 to 32"),
            (WHOLE.replace("\"fuser\"", "\"fusr\""), ":2:8\n", "did you mean \"fuser\"?"),
            (WHOLE.replace("\"fuser\"", "\"ingest\""), ":2:8\n", "allowed: \"gyro\", \"accel\", \"fuser\", \"course\""),
            (WHOLE.replace("slot = \"fuser\"", ""), ":1:", "stages.my-fuser: slot is missing"),
            (WHOLE.replace("command = [\"python3\", \"my_fuser.py\"]", ""), ":1:", "command is missing"),
            (WHOLE.replace("[\"python3\", \"my_fuser.py\"]", "\"python3\""), ":3:11\n", "an array of strings"),
            (WHOLE.replace("[\"python3\", \"my_fuser.py\"]", "[]"), ":3:11\n", "found nothing"),
            (WHOLE.replace("\"python3\"", "\"\""), ":3:11\n", "found \"\""),
            (format!("{WHOLE}folder = \"x\"\n"), ":4:1\n", "unknown key \"folder\""),
            (format!("[gyro]\nstage = \"my-fuser\"\n{WHOLE}"), ":2:9\n", "gyro.stage: unknown value \"my-fuser\""),
            (format!("[fuser]\nstage = \"my-fuse\"\n{WHOLE}"), ":2:9\n", "did you mean \"my-fuser\"?"),
            (format!("[fuser]\nstage = \"my-fuser\"\nset.gain = \"1\"\n{WHOLE}"), ":3:12\n", "expected a number"),
            ("stages = 3".to_owned(), ":1:10\n", "stages: expected a table"),
            ("stages.mine = 3".to_owned(), ":1:15\n", "stages.mine: expected a table"),
        ];
        for (text, place, said) in cases {
            let shown = Launch::parse("launch.toml", &text).unwrap_err().to_string();
            assert!(shown.contains(place) && shown.contains(said), "{place}{said}:\n{shown}");
            assert!(shown.ends_with("1 problem"), "{said}:\n{shown}");
        }
    }

    #[test]
    fn a_path_is_taken_from_the_launch_files_folder_and_must_be_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("launch.toml");
        std::fs::write(&path, WHOLE.replace("python3", "./run")).unwrap();
        let shown = Launch::read(&path).unwrap_err().to_string();
        assert!(shown.contains("there is no file") && shown.contains(":3:11"), "{shown}");
        let used = format!("[fuser]\nstage = \"my-fuser\"\n{}", WHOLE.replace("python3", "no-such-program"));
        std::fs::write(&path, used).unwrap();
        let shown = Launch::read(&path).unwrap_err().to_string();
        assert!(shown.contains("no folder of PATH has a file \"no-such-program\""), "{shown}");
        assert!(shown.ends_with("1 problem"), "the slot has none of its own: {shown}");
        std::fs::write(&path, WHOLE.replace("python3", "./run")).unwrap();
        std::fs::write(folder.path().join("run"), "").unwrap();
        let launch = Launch::read(&path).unwrap();
        assert_eq!(launch.stages["my-fuser"].file(), folder.path().join("./run"));
        assert_eq!(launch.stages["my-fuser"].folder, folder.path());
    }
}
