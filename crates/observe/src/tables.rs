//! Messages as CSV tables `DIR/VEHICLE/TOPIC.csv`, with a column for each number in the message.
//!
//! - Input: messages of a topic, in order.
//! - Output: CSV lines. Columns are named after the fields; the columns of an array are numbered.
//! - Failure: a table that cannot be written is reported with its path. The number of tables is
//!   limited.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use messages::{Field, Layout, Message};

/// Maximum number of open files. It is enough for every topic of a small fleet.
const MAX_FILES: usize = 512;

/// Error while writing a table.
#[derive(Debug, thiserror::Error)]
#[error("writing {path}: {cause}; check that the folder can be written to and has space", path = foreign::path(path))]
pub struct TableError {
    path: PathBuf,
    cause: io::Error,
}

/// CSV tables in a folder.
pub struct CsvTables {
    folder: PathBuf,
    files: BTreeMap<PathBuf, BufWriter<File>>,
}

impl CsvTables {
    /// Creates the writer. Each table is created when its first message is written.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.into(), files: BTreeMap::new() }
    }

    /// Appends messages to the table of a vehicle and topic.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be created or written, or if there are too many tables.
    pub fn write<M: Message>(&mut self, vehicle: &str, topic: &str, messages: &[M]) -> Result<(), TableError> {
        let path = self.folder.join(vehicle).join(format!("{topic}.csv"));
        let failed = |cause| TableError { path: path.clone(), cause };
        if !self.files.contains_key(&path) {
            if self.files.len() >= MAX_FILES {
                return Err(failed(io::Error::other(format!("more than {MAX_FILES} tables"))));
            }
            fs::create_dir_all(self.folder.join(vehicle)).map_err(failed)?;
            let mut file = BufWriter::new(File::create(&path).map_err(failed)?);
            writeln!(file, "{}", header::<M>()).map_err(failed)?;
            self.files.insert(path.clone(), file);
        }
        let Some(file) = self.files.get_mut(&path) else { return Ok(()) };
        write_rows(messages, file).map_err(failed)
    }

    /// Flushes all tables.
    ///
    /// # Errors
    ///
    /// Returns the first error.
    pub fn finish(self) -> Result<(), TableError> {
        self.files.into_iter().try_for_each(|(path, mut file)| file.flush().map_err(|cause| TableError { path, cause }))
    }
}

fn header<M: Message>() -> String {
    let Layout { fields, .. } = M::layout();
    let names = fields.iter().flat_map(|field| match element_count(field) {
        1 => vec![field.name.to_owned()],
        many => (0..many).map(|i| format!("{}_{i}", field.name)).collect(),
    });
    names.collect::<Vec<_>>().join(",")
}

fn write_rows<M: Message>(messages: &[M], writer: &mut impl Write) -> io::Result<()> {
    let Layout { fields, .. } = M::layout();
    for message in messages {
        let bytes = bytemuck::bytes_of(message);
        let values =
            fields.iter().flat_map(|field| (0..element_count(field)).map(move |i| format_element(bytes, field, i)));
        writeln!(writer, "{}", values.collect::<Vec<_>>().join(","))?;
    }
    Ok(())
}

/// Returns the number of columns for a field, which is 1 or the length of its array.
///
/// The result is 0 for the array of words in a checkpoint, because its length is not a literal in
/// the layout.
fn element_count(field: &Field) -> usize {
    match field.kind.strip_prefix('[') {
        None => 1,
        Some(array) => array.trim_end_matches(']').rsplit(' ').next().and_then(|n| n.parse().ok()).unwrap_or(0),
    }
}

fn format_element(bytes: &[u8], field: &Field, index: usize) -> String {
    let at = |size: usize| bytes.get(field.offset + index * size..).unwrap_or_default();
    let word = at(8).first_chunk().copied().map(u64::from_le_bytes).unwrap_or_default();
    match field.kind.trim_start_matches('[').split(';').next().unwrap_or_default() {
        "f64" => f64::from_bits(word).to_string(),
        "i64" => word.cast_signed().to_string(),
        "u32" | "State" => at(4).first_chunk().copied().map(u32::from_le_bytes).unwrap_or_default().to_string(),
        "u8" => at(1).first().copied().unwrap_or_default().to_string(),
        _ => word.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{AttitudeOutput, Health};

    fn table<M: Message>(message: M) -> (Vec<String>, Vec<String>) {
        let mut text = Vec::new();
        write_rows(&[message], &mut text).unwrap();
        let split = |line: &str| line.trim_end().split(',').map(str::to_owned).collect();
        (split(&header::<M>()), split(std::str::from_utf8(&text).unwrap()))
    }

    #[test]
    fn each_number_is_in_the_column_of_its_field() {
        let mut output: AttitudeOutput = bytemuck::Zeroable::zeroed();
        (output.header.tick, output.header.t_start_ns, output.header.incarnation) = (7, -5, 9);
        (output.quaternion, output.roll_rad) = ([0.5, -0.5, 0.25, 0.125], -1.5);
        let (head, values) = table(output);
        let cell = |name: &str| values[head.iter().position(|column| column == name).unwrap()].as_str();
        assert_eq!((cell("tick"), cell("t_start_ns"), cell("incarnation"), cell("roll_rad")), ("7", "-5", "9", "-1.5"));
        assert_eq!((cell("quaternion_0"), cell("quaternion_1"), cell("quaternion_3")), ("0.5", "-0.5", "0.125"));
        let (head, values) = table(Health { pid: 77, ..bytemuck::Zeroable::zeroed() });
        assert_eq!(values[head.iter().position(|column| column == "pid").unwrap()], "77");
    }
}
