//! A working stage with a test, to be changed into one's own.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use launch::Service;

use crate::python;

/// The languages there are templates for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Language {
    /// A crate that implements the stage's trait.
    Rust,
    /// A class, and the package `plumbline` beside it.
    Python,
}

/// A stage to be written.
#[derive(Debug, Clone)]
pub struct Template {
    /// In which language.
    pub language: Language,
    /// For which slot.
    pub slot: Service,
    /// Its name, as in a launch file.
    pub name: String,
    /// Where Plumbline's crates are, for a stage in Rust: a folder, or the URL of a git repository.
    pub source: String,
}

/// Why no stage was written.
#[derive(Debug, thiserror::Error)]
pub enum TemplateError {
    /// The name cannot be one of a stage and of a module.
    #[error("naming a stage: {0:?} is no name; begin with a letter and use a-z, 0-9 and -, 32 at most")]
    Name(String),
    /// That is no slot.
    #[error("writing a stage: `{0}` is no slot; these are gyro, accel, fuser and course")]
    Slot(Service),
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
        let Self { name, .. } = self;
        let legal = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-');
        if name.len() > 32 || !name.bytes().all(legal) || !name.starts_with(|c: char| c.is_ascii_lowercase()) {
            return Err(TemplateError::Name(name.clone()));
        }
        let module = name.replace('-', "_");
        let files = match self.language {
            Language::Python => {
                let package = python::package().into_iter().map(|(file, text)| (format!("plumbline/{file}"), text));
                let own = vec![
                    (format!("{module}.py"), self.filled(self.stage()?)),
                    (format!("test_{module}.py"), self.filled(include_str!("../templates/python/test.py"))),
                    ("requirements.txt".into(), include_str!("../templates/python/requirements.txt").into()),
                    ("launch.toml".into(), self.filled(include_str!("../templates/python/launch.toml"))),
                    ("README.md".into(), self.filled(include_str!("../templates/python/README.md"))),
                ];
                package.chain(own).collect()
            }
            Language::Rust => vec![
                ("Cargo.toml".into(), self.filled(include_str!("../templates/rust/Cargo.toml.in"))),
                ("src/lib.rs".into(), self.filled(self.stage()?)),
                ("src/main.rs".into(), self.filled(include_str!("../templates/rust/main.rs"))),
                ("tests/conformance.rs".into(), self.filled(include_str!("../templates/rust/conformance.rs"))),
                ("launch.toml".into(), self.filled(include_str!("../templates/rust/launch.toml"))),
                ("README.md".into(), self.filled(include_str!("../templates/rust/README.md"))),
            ],
        };
        Ok(files)
    }

    fn stage(&self) -> Result<&'static str, TemplateError> {
        Ok(match (self.language, self.slot) {
            (Language::Python, Service::Gyro) => include_str!("../templates/python/gyro.py"),
            (Language::Python, Service::Accel) => include_str!("../templates/python/accel.py"),
            (Language::Python, Service::Fuser) => include_str!("../templates/python/fuser.py"),
            (Language::Python, Service::Course) => include_str!("../templates/python/course.py"),
            (Language::Rust, Service::Gyro) => include_str!("../templates/rust/gyro.rs"),
            (Language::Rust, Service::Accel) => include_str!("../templates/rust/accel.rs"),
            (Language::Rust, Service::Fuser) => include_str!("../templates/rust/fuser.rs"),
            (Language::Rust, Service::Course) => include_str!("../templates/rust/course.rs"),
            (_, slot) => return Err(TemplateError::Slot(slot)),
        })
    }

    /// A template's text with this stage's names in it.
    fn filled(&self, text: &str) -> String {
        let Self { name, slot, source, .. } = self;
        let class: String = name
            .split('-')
            .map(|word| {
                word.chars().take(1).map(|c| c.to_ascii_uppercase()).chain(word.chars().skip(1)).collect::<String>()
            })
            .collect();
        let remote = source.contains("://");
        let dependency = |crate_path: &str| {
            let package = crate_path.rsplit('/').next().unwrap_or(crate_path);
            let place =
                if remote { format!("git = \"{source}\"") } else { format!("path = \"{source}/{crate_path}\"") };
            format!("{package} = {{ {place} }}")
        };
        text.replace("@name@", name)
            .replace("@module@", &name.replace('-', "_"))
            .replace("@Class@", &class)
            .replace("@slot@", slot.name())
            .replace("@attitude@", &dependency("crates/attitude"))
            .replace("@conformance@", &dependency("crates/conformance"))
            .replace("@service@", &dependency(&format!("services/{slot}")))
    }
}
