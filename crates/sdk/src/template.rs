//! Templates for user-defined stages. Each is a working stage with a test, to start from.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use graph::Slot;

/// Name and text of each file of the Python package `plumbline`. The package is placed next to a
/// Python stage.
const PYTHON_PACKAGE: [(&str, &str); 7] = [
    ("__init__.py", include_str!("../python/plumbline/__init__.py")),
    ("attitude.py", include_str!("../python/plumbline/attitude.py")),
    ("program.py", include_str!("../python/plumbline/program.py")),
    ("sensor.py", include_str!("../python/plumbline/sensor.py")),
    ("stage.py", include_str!("../python/plumbline/stage.py")),
    ("stage_tests.py", include_str!("../python/plumbline/stage_tests.py")),
    ("values.py", include_str!("../python/plumbline/values.py")),
];

/// Text of the header file `plumbline.h`, for stages in C and C++.
pub const C_HEADER: &str = include_str!("../c/plumbline.h");

/// Names that a stage must not have: keywords of Python and Rust, and names of modules that the
/// templates use.
const RESERVED_NAMES: [&str; 81] = [
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

/// Programming language of a template.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Language {
    /// Rust crate that implements the `Stage` trait.
    Rust {
        /// Folder of Plumbline's source, or the URL of its git repository.
        source: String,
    },
    /// Python class, with the package `plumbline` next to it.
    Python,
    /// C or C++ file, with the header `plumbline.h` next to it.
    C,
}

/// Stage to be generated from a template.
#[derive(Debug, Clone)]
pub struct Template {
    /// Programming language of the stage.
    pub language: Language,
    /// Slot that the stage fills.
    pub slot: Slot,
    /// Name of the stage in a launch file.
    pub name: String,
}

/// Error while writing a stage.
#[derive(Debug, thiserror::Error)]
pub enum TemplateError {
    /// The name is not a valid stage name.
    #[error("invalid stage name {0:?}; use at most 32 of a-z, 0-9 and -, starting with a letter")]
    InvalidName(String),
    /// The name is reserved.
    #[error("stage name {name:?} is {meaning}; choose another, such as \"my-{name}\"")]
    NameTaken {
        /// Rejected name.
        name: String,
        /// Existing meaning of the name.
        meaning: &'static str,
    },
    /// The target folder already exists.
    #[error("cannot write a stage to {0:?}: it already exists; choose another folder with --dir or remove it")]
    FolderExists(PathBuf),
    /// A file could not be written.
    #[error("cannot write {path:?}: {cause}")]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
}

macro_rules! slot_template {
    ($slot:expr, $language:literal, $extension:literal) => {
        match $slot {
            Slot::Gyro => include_str!(concat!("../templates/", $language, "/gyro.", $extension)),
            Slot::Accel => include_str!(concat!("../templates/", $language, "/accel.", $extension)),
            Slot::Fuser => include_str!(concat!("../templates/", $language, "/fuser.", $extension)),
            Slot::Course => include_str!(concat!("../templates/", $language, "/course.", $extension)),
        }
    };
}

impl Template {
    /// Writes the stage into a new folder.
    ///
    /// # Errors
    ///
    /// Returns a [`TemplateError`] if the name is invalid or reserved, the folder exists or a file
    /// cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), TemplateError> {
        let files = self.files()?;
        if folder.exists() {
            return Err(TemplateError::FolderExists(folder.into()));
        }
        for (name, text) in files {
            let path = folder.join(name);
            let failed = |cause| TemplateError::Write { path: path.clone(), cause };
            path.parent().map_or(Ok(()), fs::create_dir_all).map_err(failed)?;
            fs::write(&path, text).map_err(failed)?;
        }
        Ok(())
    }

    /// Returns the path within the stage's folder and the text of each file.
    fn files(&self) -> Result<Vec<(String, String)>, TemplateError> {
        let Self { name, slot, language } = self;
        let is_allowed = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-');
        if name.len() > 32 || !name.bytes().all(is_allowed) || !name.starts_with(|c: char| c.is_ascii_lowercase()) {
            return Err(TemplateError::InvalidName(name.clone()));
        }
        let name_taken = |meaning| Err(TemplateError::NameTaken { name: name.clone(), meaning });
        if Slot::ALL.into_iter().flat_map(Slot::stages).any(|built_in| built_in == name) {
            return name_taken("the name of a built-in stage");
        }
        if RESERVED_NAMES.contains(&name.as_str()) {
            return name_taken("a keyword of Python or Rust or a module used by the template");
        }
        let module = name.replace('-', "_");
        let mut files: Vec<(String, &str)> = match language {
            Language::Python => vec![
                (format!("{module}.py"), slot_template!(slot, "python", "py")),
                (format!("test_{module}.py"), include_str!("../templates/python/test.py")),
                ("README.md".into(), include_str!("../templates/python/README.md")),
            ],
            Language::C => vec![
                (format!("{module}.c"), slot_template!(slot, "c", "c")),
                ("README.md".into(), include_str!("../templates/c/README.md")),
            ],
            Language::Rust { .. } => vec![
                ("Cargo.toml".into(), include_str!("../templates/rust/Cargo.toml.in")),
                ("src/lib.rs".into(), slot_template!(slot, "rust", "rs")),
                ("src/main.rs".into(), include_str!("../templates/rust/main.rs")),
                ("tests/conformance.rs".into(), include_str!("../templates/rust/conformance.rs")),
                ("README.md".into(), include_str!("../templates/rust/README.md")),
            ],
        };
        files.push(("launch.toml".into(), include_str!("../templates/launch.toml")));
        let mut files: Vec<_> = files.into_iter().map(|(file, text)| (file, self.fill_placeholders(text))).collect();
        match language {
            Language::Python => {
                files.extend(PYTHON_PACKAGE.map(|(file, text)| (format!("plumbline/{file}"), text.into())))
            }
            Language::C => files.push(("plumbline.h".into(), C_HEADER.into())),
            Language::Rust { .. } => {}
        }
        Ok(files)
    }

    /// Replaces the placeholders in a template with the names of this stage.
    fn fill_placeholders(&self, text: &str) -> String {
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
        let dependency = |path: &str, package: &str| {
            let name = path.rsplit('/').next().unwrap_or(path);
            let package = if package == name { String::new() } else { format!("package = \"{package}\", ") };
            match source.contains("://") {
                true => format!("{name} = {{ {package}git = \"{source}\" }}"),
                false => format!("{name} = {{ {package}path = \"{source}/{path}\" }}"),
            }
        };
        text.replace("@name@", name)
            .replace("@module@", &module)
            .replace("@Class@", &class)
            .replace("@slot@", slot.name())
            .replace("@command@", &command)
            .replace("@attitude@", &dependency("crates/attitude", "plumbline-attitude"))
            .replace("@sdk@", &dependency("crates/sdk", "plumbline-sdk"))
            .replace("@conformance@", &dependency("tools/conformance", "conformance"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn python_package_lists_every_file() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/python/plumbline");
        let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut files: Vec<_> = files.filter(|name| name.ends_with(".py")).collect();
        files.sort();
        assert_eq!(files, PYTHON_PACKAGE.map(|(name, _)| name));
    }

    #[test]
    fn reserved_and_invalid_names_are_rejected() {
        for (name, expected) in [
            ("wz", "built-in stage"),
            ("class", "keyword of Python or Rust"),
            ("struct", "module used by the template"),
            ("1st", "invalid stage name"),
            ("My", "invalid stage name"),
        ] {
            let template = Template { language: Language::Python, slot: Slot::Fuser, name: name.into() };
            let error = template.files().unwrap_err().to_string();
            assert!(error.contains(expected), "{name}: {error}");
        }
    }

    #[test]
    fn templates_have_no_unfilled_placeholders() {
        let languages = [Language::Python, Language::C, Language::Rust { source: "/here".into() }];
        for language in languages {
            for slot in Slot::ALL {
                let template = Template { language: language.clone(), slot, name: "my-stage".into() };
                for (file, text) in template.files().unwrap() {
                    assert!(
                        !text.is_empty() && !text.contains("@name@") && !text.contains("@Class@"),
                        "{file}: {text}"
                    );
                    // Only the Python package may contain an @, for decorators.
                    assert!(file.starts_with("plumbline") || !text.contains('@'), "{file}: {text}");
                }
            }
        }
    }
}
