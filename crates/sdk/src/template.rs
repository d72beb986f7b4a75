//! A working stage with a test, to be changed into one's own.

use std::{
    fmt, fs, io,
    path::{Path, PathBuf},
};

use attitude::{accel::Accelerometer, course::Course, fuser::Fuser, gyro::Gyro};

/// The Python package beside a stage in Python: each file's name and text.
const PACKAGE: [(&str, &str); 7] = [
    ("__init__.py", include_str!("../python/plumbline/__init__.py")),
    ("attitude.py", include_str!("../python/plumbline/attitude.py")),
    ("program.py", include_str!("../python/plumbline/program.py")),
    ("sensor.py", include_str!("../python/plumbline/sensor.py")),
    ("stage.py", include_str!("../python/plumbline/stage.py")),
    ("trial.py", include_str!("../python/plumbline/trial.py")),
    ("values.py", include_str!("../python/plumbline/values.py")),
];

/// The header for stages in C and C++.
pub const HEADER: &str = include_str!("../c/plumbline.h");

/// Names that are none for a module or a crate.
const RESERVED: [&str; 81] = [
    "abstract",
    "and",
    "as",
    "assert",
    "async",
    "await",
    "become",
    "box",
    "break",
    "class",
    "cmath",
    "const",
    "continue",
    "core",
    "crate",
    "ctypes",
    "def",
    "del",
    "do",
    "dyn",
    "elif",
    "else",
    "enum",
    "except",
    "extern",
    "final",
    "finally",
    "fn",
    "for",
    "from",
    "functools",
    "gen",
    "global",
    "if",
    "impl",
    "import",
    "in",
    "is",
    "lambda",
    "let",
    "loop",
    "macro",
    "main",
    "match",
    "math",
    "mod",
    "move",
    "mut",
    "nonlocal",
    "not",
    "or",
    "override",
    "pass",
    "plumbline",
    "priv",
    "pub",
    "raise",
    "ref",
    "return",
    "sdk",
    "self",
    "signal",
    "socket",
    "static",
    "std",
    "struct",
    "super",
    "sys",
    "test",
    "trait",
    "traceback",
    "try",
    "type",
    "typing",
    "unittest",
    "unsafe",
    "use",
    "virtual",
    "where",
    "while",
    "with",
];

/// A slot that a stage of one's own can fill.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Slot {
    /// The motion of each tick.
    Gyro,
    /// Where up seems to be.
    Accel,
    /// The attitude.
    Fuser,
    /// What people read.
    Course,
}

impl Slot {
    /// The slot of that name.
    pub fn named(name: &str) -> Option<Self> {
        [Self::Gyro, Self::Accel, Self::Fuser, Self::Course].into_iter().find(|slot| slot.name() == name)
    }

    /// Its name, as in a launch file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gyro => "gyro",
            Self::Accel => "accel",
            Self::Fuser => "fuser",
            Self::Course => "course",
        }
    }
}

impl fmt::Display for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The languages there are templates for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Language {
    /// A crate that implements the stage's trait. Plumbline's crates are in this folder, or in the git repository of this URL.
    Rust {
        /// Where.
        source: String,
    },
    /// A class, and the package `plumbline` beside it.
    Python,
    /// A file, and the header `plumbline.h` beside it; also C++.
    C,
}

/// A stage to be written.
#[derive(Debug, Clone)]
pub struct Template {
    /// In which language.
    pub language: Language,
    /// For which slot.
    pub slot: Slot,
    /// Its name, as in a launch file.
    pub name: String,
}

/// Why no stage was written.
#[derive(Debug, thiserror::Error)]
pub enum TemplateError {
    /// The name cannot be one of a stage and of a module.
    #[error("naming a stage: {0:?} is no name; begin with a letter and use a-z, 0-9 and -, 32 at most")]
    Name(String),
    /// The name means something else already.
    #[error("naming a stage: {name:?} is {what}; choose another, such as \"my-{name}\"")]
    Taken {
        /// The name.
        name: String,
        /// What has it.
        what: &'static str,
    },
    /// Something is there.
    #[error("writing a stage to {0}: it is there already; name another place with --dir, or remove it")]
    Occupied(PathBuf),
    /// A file could not be written.
    #[error("writing {path}: {cause}")]
    Unwritable {
        /// Which one.
        path: PathBuf,
        /// What the system answered.
        cause: io::Error,
    },
}

macro_rules! of_slot {
    ($slot:expr, $language:literal, $ending:literal) => {
        match $slot {
            Slot::Gyro => include_str!(concat!("../templates/", $language, "/gyro.", $ending)),
            Slot::Accel => include_str!(concat!("../templates/", $language, "/accel.", $ending)),
            Slot::Fuser => include_str!(concat!("../templates/", $language, "/fuser.", $ending)),
            Slot::Course => include_str!(concat!("../templates/", $language, "/course.", $ending)),
        }
    };
}

impl Template {
    /// Writes the stage into a new folder.
    pub fn write(&self, folder: &Path) -> Result<(), TemplateError> {
        let files = self.files()?;
        if folder.exists() {
            return Err(TemplateError::Occupied(folder.into()));
        }
        for (name, text) in files {
            let path = folder.join(name);
            let failed = |cause| TemplateError::Unwritable { path: path.clone(), cause };
            path.parent().map_or(Ok(()), fs::create_dir_all).map_err(failed)?;
            fs::write(&path, text).map_err(failed)?;
        }
        Ok(())
    }

    /// Every file with its place in the folder.
    fn files(&self) -> Result<Vec<(String, String)>, TemplateError> {
        let Self { name, slot, language } = self;
        let legal = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-');
        if name.len() > 32 || !name.bytes().all(legal) || !name.starts_with(|c: char| c.is_ascii_lowercase()) {
            return Err(TemplateError::Name(name.clone()));
        }
        let taken = |what| Err(TemplateError::Taken { name: name.clone(), what });
        let mut own = [&Gyro::NAMES[..], &Accelerometer::NAMES, &Fuser::NAMES, &Course::NAMES].into_iter().flatten();
        if own.any(|own| own == name) {
            return taken("the name of one of Plumbline's own stages");
        }
        if RESERVED.contains(&name.as_str()) {
            return taken("a word of Python or Rust, or a module that the template needs");
        }
        let module = name.replace('-', "_");
        let mut files: Vec<(String, &str)> = match language {
            Language::Python => vec![
                (format!("{module}.py"), of_slot!(slot, "python", "py")),
                (format!("test_{module}.py"), include_str!("../templates/python/test.py")),
                ("README.md".into(), include_str!("../templates/python/README.md")),
            ],
            Language::C => vec![
                (format!("{module}.c"), of_slot!(slot, "c", "c")),
                ("README.md".into(), include_str!("../templates/c/README.md")),
            ],
            Language::Rust { .. } => vec![
                ("Cargo.toml".into(), include_str!("../templates/rust/Cargo.toml.in")),
                ("src/lib.rs".into(), of_slot!(slot, "rust", "rs")),
                ("src/main.rs".into(), include_str!("../templates/rust/main.rs")),
                ("tests/conformance.rs".into(), include_str!("../templates/rust/conformance.rs")),
                ("README.md".into(), include_str!("../templates/rust/README.md")),
            ],
        };
        files.push(("launch.toml".into(), include_str!("../templates/launch.toml")));
        let mut files: Vec<_> = files.into_iter().map(|(file, text)| (file, self.filled(text))).collect();
        match language {
            Language::Python => files.extend(PACKAGE.map(|(file, text)| (format!("plumbline/{file}"), text.into()))),
            Language::C => files.push(("plumbline.h".into(), HEADER.into())),
            Language::Rust { .. } => {}
        }
        Ok(files)
    }

    /// A template's text with this stage's names in it.
    fn filled(&self, text: &str) -> String {
        let Self { name, slot, language } = self;
        let module = name.replace('-', "_");
        let class: String = name
            .split('-')
            .map(|word| {
                word.chars().take(1).map(|c| c.to_ascii_uppercase()).chain(word.chars().skip(1)).collect::<String>()
            })
            .collect();
        let command = match language {
            Language::Rust { .. } => format!("\"./target/release/{name}\""),
            Language::Python => format!("\"python3\", \"{module}.py\""),
            Language::C => format!("\"./{name}\""),
        };
        let source = if let Language::Rust { source } = language { source.as_str() } else { "" };
        let dependency = |folder: &str, package: &str| match source.contains("://") {
            true => format!("{package} = {{ git = \"{source}\" }}"),
            false => format!("{package} = {{ path = \"{source}/{folder}/{package}\" }}"),
        };
        text.replace("@name@", name)
            .replace("@module@", &module)
            .replace("@Class@", &class)
            .replace("@slot@", slot.name())
            .replace("@command@", &command)
            .replace("@attitude@", &dependency("crates", "attitude"))
            .replace("@sdk@", &dependency("crates", "sdk"))
            .replace("@conformance@", &dependency("tools", "conformance"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_the_package_is_written() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/python/plumbline");
        let there = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut there: Vec<_> = there.filter(|name| name.ends_with(".py")).collect();
        there.sort();
        assert_eq!(there, PACKAGE.map(|(name, _)| name));
    }

    #[test]
    fn a_name_that_means_something_else_is_refused() {
        for (name, why) in [
            ("wz", "one of Plumbline's own stages"),
            ("class", "a word of Python or Rust"),
            ("struct", "a module that the template needs"),
            ("1st", "no name"),
            ("My", "no name"),
        ] {
            let template = Template { language: Language::Python, slot: Slot::Fuser, name: name.into() };
            let said = template.files().unwrap_err().to_string();
            assert!(said.contains(why), "{name}: {said}");
        }
    }

    #[test]
    fn no_template_keeps_a_place_for_a_name() {
        let languages = [Language::Python, Language::C, Language::Rust { source: "/here".into() }];
        for language in languages {
            for slot in [Slot::Gyro, Slot::Accel, Slot::Fuser, Slot::Course] {
                let template = Template { language: language.clone(), slot, name: "my-stage".into() };
                for (file, text) in template.files().unwrap() {
                    assert!(
                        !text.is_empty() && !text.contains("@name@") && !text.contains("@Class@"),
                        "{file}: {text}"
                    );
                    // The package decorates functions; nothing else has such a sign.
                    assert!(file.starts_with("plumbline") || !text.contains('@'), "{file}: {text}");
                }
            }
        }
    }
}
