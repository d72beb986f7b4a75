//! Replaces sections of a launch file and keeps its comments.

use std::{
    fs, io,
    io::Write as _,
    path::{Path, PathBuf},
};

use foreign::ForeignText;
use tempfile::NamedTempFile;
use toml_edit::{DocumentMut, Item, Table, TomlError};

use crate::{Launch, problem::Problems};

/// Key of the table that contains the parameters of a stage.
const PARAMETERS: &str = "set";

/// Failure to change a launch file. The file remains unchanged.
#[derive(Debug, thiserror::Error)]
pub enum EditError {
    /// The file cannot be read or replaced.
    #[error("cannot change {}: {cause}; the launch file is unchanged", foreign::path(path))]
    File {
        /// Path of the launch file.
        path: PathBuf,
        /// Operating system error.
        cause: io::Error,
    },
    /// The file or the new sections are not TOML.
    #[error("cannot change {}: {}; the launch file is unchanged", foreign::path(path), cause.with_lines())]
    Syntax {
        /// Path of the launch file.
        path: PathBuf,
        /// Error with its line.
        cause: ForeignText,
    },
    /// A section to be written has the name of an existing value.
    #[error("cannot change {}: `{key}` is not a table; write it as a section", foreign::path(path))]
    NoTable {
        /// Path of the launch file.
        path: PathBuf,
        /// Key of the value.
        key: String,
    },
    /// The changed file would be invalid.
    #[error("the launch file is unchanged, because it would not be valid with the new values:\n{0}")]
    Invalid(Problems),
}

/// Replaces the sections of `block`, which is TOML, in a launch file. All other text is kept.
///
/// The file is replaced atomically, and created if it does not exist. If `path` is a symbolic link,
/// its target is replaced and the link is kept.
///
/// # Errors
///
/// Returns an error if the file cannot be read or written, or would be invalid.
pub fn write_sections(path: &Path, block: &str) -> Result<(), EditError> {
    let file_error = |cause| EditError::File { path: path.into(), cause };
    let syntax_error = |cause: TomlError| EditError::Syntax { path: path.into(), cause: cause.to_string().into() };
    // A new file gets the user's default permissions.
    match fs::File::create_new(path) {
        Err(cause) if cause.kind() != io::ErrorKind::AlreadyExists => return Err(file_error(cause)),
        Ok(_) | Err(_) => {}
    }
    let target = fs::canonicalize(path).map_err(file_error)?;
    let text = fs::read_to_string(&target).map_err(file_error)?;
    let mut document: DocumentMut = text.parse().map_err(syntax_error)?;
    let block: DocumentMut = block.parse().map_err(syntax_error)?;
    replace_sections(document.as_table_mut(), block.as_table())
        .map_err(|key| EditError::NoTable { path: path.into(), key })?;
    let changed = document.to_string();
    Launch::parse(&path.to_string_lossy(), &changed).map_err(EditError::Invalid)?;
    let folder = target.parent().unwrap_or(Path::new("/"));
    let mut file = NamedTempFile::new_in(folder).map_err(file_error)?;
    file.write_all(changed.as_bytes()).map_err(file_error)?;
    file.as_file().set_permissions(fs::metadata(&target).map_err(file_error)?.permissions()).map_err(file_error)?;
    file.as_file().sync_all().map_err(file_error)?;
    file.persist(&target).map_err(|error| file_error(error.error))?;
    Ok(())
}

/// Replaces in `target` each section of `source` that has values. Returns the key of a section that
/// exists but is not a table.
fn replace_sections(target: &mut Table, source: &Table) -> Result<(), String> {
    for (key, item) in source {
        let Some(source) = item.as_table() else { continue };
        let existing = target.entry(key).or_insert_with(|| {
            let mut table = Table::new();
            table.set_implicit(source.is_implicit());
            Item::Table(table)
        });
        // An inline table becomes a section.
        if let Some(inline) = existing.as_inline_table() {
            *existing = Item::Table(inline.clone().into_table());
        }
        let existing = existing.as_table_mut().ok_or_else(|| key.to_owned())?;
        if source.iter().any(|(_, item)| item.is_value()) {
            replace_values(existing, source);
        }
        replace_sections(existing, source)?;
    }
    Ok(())
}

/// Replaces the values of a section. Comments on remaining keys are kept.
///
/// In the section of a stage, which has parameters in `set`, only the parameters in `source` are
/// replaced. The stage and its other parameters are kept.
fn replace_values(target: &mut Table, source: &Table) {
    target.set_implicit(false);
    let parameters = source.get(PARAMETERS).and_then(Item::as_table_like);
    if let (Some(parameters), Some(existing)) =
        (parameters, target.get_mut(PARAMETERS).and_then(Item::as_table_like_mut))
    {
        parameters.iter().for_each(|(key, item)| drop(existing.insert(key, item.clone())));
        return;
    }
    let is_obsolete = |key: &str, item: &Item| item.is_value() && !source.contains_key(key) && parameters.is_none();
    let obsolete: Vec<_> =
        target.iter().filter(|(key, item)| is_obsolete(key, item)).map(|(key, _)| key.to_owned()).collect();
    obsolete.iter().for_each(|key| drop(target.remove(key)));
    for (key, value) in source.iter().filter_map(|(key, item)| Some((key, item.as_value()?))) {
        match target.get_mut(key).and_then(Item::as_value_mut) {
            Some(_) if parameters.is_some() && key != PARAMETERS => {}
            Some(existing) => {
                let mut value = value.clone();
                *value.decor_mut() = existing.decor().clone();
                *existing = value;
            }
            None => drop(target.insert(key, Item::Value(value.clone()))),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    const GYRO: &str = "[ingest.calibration.gyro]\nbias = [0.1, 0.2, 0.3] # rad/s\n";

    fn write(text: &str, block: &str) -> Result<String, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("launch.toml");
        fs::write(&path, text).unwrap();
        let result = write_sections(&path, block).map_err(|error| error.to_string());
        let after = fs::read_to_string(&path).unwrap();
        assert!(result.is_ok() || after == text, "a rejected change leaves the file unchanged: {after}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        result.map(|()| after)
    }

    #[test]
    fn missing_section_is_appended_and_comments_are_kept() {
        let text = "# mine\nname = \"a\" # name\n\n[ingest] # source\nsource = \"sim\"\n# end\n";
        let after = write(text, GYRO).unwrap();
        assert!(after.starts_with(text.trim_end_matches("# end\n")) && after.contains("# end"), "{after}");
        assert!(after.contains("[ingest.calibration.gyro]\nbias = [0.1, 0.2, 0.3] # rad/s"), "{after}");
        assert_eq!(Launch::parse("x", &after).unwrap().ingest.calibration.gyro.bias, [0.1, 0.2, 0.3]);
    }

    #[test]
    fn existing_section_is_replaced_with_comments_kept() {
        let text = "# unit 7\n[ingest.calibration.gyro] # by hand\n# measured\nbias = [0, 0, 0] # old unit\nscale = [2, 2, 2]\n\n[ingest.limits]\ngap_s = 0.5 # mine\n";
        let expected = "# unit 7\n[ingest.calibration.gyro] # by hand\n# measured\nbias = [0.1, 0.2, 0.3] # old unit\n\n[ingest.limits]\ngap_s = 0.5 # mine\n";
        assert_eq!(write(text, GYRO).unwrap(), expected);
    }

    #[test]
    fn inline_and_dotted_sections_are_replaced() {
        for text in [
            "ingest = { source = \"sim\", calibration = { gyro = { bias = [0, 0, 1] } } }\n",
            "ingest.calibration.gyro.bias = [0, 0, 1]\ningest.source = \"sim\"\n",
            "[ingest]\nsource = \"sim\"\ncalibration.gyro = { bias = [0, 0, 1], scale = [2, 2, 2] }\n",
        ] {
            let after = Launch::parse("x", &write(text, GYRO).unwrap()).unwrap();
            let expected = "ingest = { source = \"sim\", calibration.gyro.bias = [0.1, 0.2, 0.3] }";
            assert_eq!(after, Launch::parse("x", expected).unwrap(), "{text}");
        }
    }

    #[test]
    fn stage_keeps_its_name_and_other_parameters() {
        let block = "[fuser]\nstage = \"multiple-model\"\nset = { magnetometer_delay_s = 0.02 }\n";
        let text = "[fuser]\nstage = \"wz\" # chosen\nset = { hard_iron_sd_ut = 9 }\n";
        let after = write(text, block).unwrap();
        assert!(after.starts_with("[fuser]\nstage = \"wz\" # chosen\nset = { hard_iron_sd_ut = 9"), "{after}");
        let fuser = Launch::parse("x", &after).unwrap().fuser;
        assert_eq!((fuser.set["hard_iron_sd_ut"], fuser.set["magnetometer_delay_s"]), (9.0, 0.02));
        let rejected = write("[fuser]\nstage = \"vqf\"\n", block).unwrap_err();
        assert!(rejected.contains("unknown key \"magnetometer_delay_s\""), "{rejected}");
    }

    #[test]
    fn file_that_would_be_invalid_is_left_unchanged() {
        assert!(write("nme = \"a\"\n", GYRO).unwrap_err().contains("did you mean \"name\"?"));
        assert!(write("ingest = 3\n", GYRO).unwrap_err().contains("`ingest` is not a table"));
        assert!(write("a = [", GYRO).unwrap_err().contains("is unchanged"));
        assert!(
            write_sections(Path::new("/nowhere/launch.toml"), GYRO).unwrap_err().to_string().contains("No such file")
        );
    }

    #[test]
    fn missing_file_is_created_with_sections() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("launch.toml");
        write_sections(&path, GYRO).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), GYRO);
    }

    #[test]
    fn symbolic_link_and_permissions_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("a.toml"), folder.path().join("launch.toml"));
        fs::write(&file, "").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        symlink("a.toml", &link).unwrap();
        write_sections(&link, GYRO).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(fs::read_to_string(&file).unwrap().contains("bias"));
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o640);
    }
}
