//! Messages as tables: DIR/VEHICLE/TOPIC.csv, a column for each number of the message, named as its field.
//!
//! Input: messages of a topic, in their order. Output: lines. Failure: a table that cannot be written is an error with its path; more
//! tables than a small fleet has are refused.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use messages::{Field, Layout, Message};

/// Files open at once: every topic of a small fleet.
const MAX_FILES: usize = 512;

/// Why a table was not written.
#[derive(Debug, thiserror::Error)]
#[error("writing {path}: {cause}; check that the folder can be written to and has space")]
pub struct TableError {
    path: PathBuf,
    cause: io::Error,
}

/// The tables of a folder.
pub struct Tables {
    folder: PathBuf,
    files: BTreeMap<PathBuf, BufWriter<File>>,
}

impl Tables {
    /// To be written below this folder; a table is made by its first message.
    pub fn in_folder(folder: &Path) -> Self {
        Self { folder: folder.into(), files: BTreeMap::new() }
    }

    /// Appends messages to the table of a vehicle and topic.
    pub fn write<M: Message>(&mut self, vehicle: &str, topic: &str, messages: &[M]) -> Result<(), TableError> {
        let path = self.folder.join(vehicle).join(format!("{topic}.csv"));
        let failed = |cause| TableError { path: path.clone(), cause };
        if !self.files.contains_key(&path) {
            if self.files.len() >= MAX_FILES {
                return Err(failed(io::Error::other(format!("more than {MAX_FILES} tables"))));
            }
            fs::create_dir_all(self.folder.join(vehicle)).map_err(failed)?;
            let mut file = BufWriter::new(File::create(&path).map_err(failed)?);
            writeln!(file, "{}", head::<M>()).map_err(failed)?;
            self.files.insert(path.clone(), file);
        }
        let Some(file) = self.files.get_mut(&path) else { return Ok(()) };
        lines(messages, file).map_err(failed)
    }

    /// Writes what is still in memory.
    pub fn finish(self) -> Result<(), TableError> {
        self.files.into_iter().try_for_each(|(path, mut file)| file.flush().map_err(|cause| TableError { path, cause }))
    }
}

fn head<M: Message>() -> String {
    let Layout { fields, .. } = M::layout();
    let names = fields.iter().flat_map(|field| match numbers(field) {
        1 => vec![field.name.to_owned()],
        many => (0..many).map(|i| format!("{}_{i}", field.name)).collect(),
    });
    names.collect::<Vec<_>>().join(",")
}

fn lines<M: Message>(messages: &[M], to: &mut impl Write) -> io::Result<()> {
    let Layout { fields, .. } = M::layout();
    for message in messages {
        let bytes = bytemuck::bytes_of(message);
        let values = fields.iter().flat_map(|field| (0..numbers(field)).map(move |i| value(bytes, field, i)));
        writeln!(to, "{}", values.collect::<Vec<_>>().join(","))?;
    }
    Ok(())
}

/// How many numbers a field holds: the length of an array. The words of a checkpoint are left out.
fn numbers(field: &Field) -> usize {
    match field.kind.strip_prefix('[') {
        None => 1,
        Some(array) => array.trim_end_matches(']').rsplit(' ').next().and_then(|n| n.parse().ok()).unwrap_or(0),
    }
}

fn value(bytes: &[u8], field: &Field, i: usize) -> String {
    let at = |size: usize| bytes.get(field.offset + i * size..).unwrap_or_default();
    let wide = at(8).first_chunk().copied().map(u64::from_le_bytes).unwrap_or_default();
    match field.kind.trim_start_matches('[').split(';').next().unwrap_or_default() {
        "f64" => f64::from_bits(wide).to_string(),
        "i64" => wide.cast_signed().to_string(),
        "u32" | "State" => at(4).first_chunk().copied().map(u32::from_le_bytes).unwrap_or_default().to_string(),
        "u8" => at(1).first().copied().unwrap_or_default().to_string(),
        _ => wide.to_string(),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;
    use messages::{AttitudeOutput, Health};

    fn table<M: Message>(message: M) -> (Vec<String>, Vec<String>) {
        let mut text = Vec::new();
        lines(&[message], &mut text).unwrap();
        let split = |line: &str| line.trim_end().split(',').map(str::to_owned).collect();
        (split(&head::<M>()), split(std::str::from_utf8(&text).unwrap()))
    }

    #[test]
    fn every_number_of_a_message_stands_in_the_column_of_its_name() {
        let mut output: AttitudeOutput = bytemuck::Zeroable::zeroed();
        (output.header.tick, output.header.t_start_ns, output.header.incarnation) = (7, -5, 9);
        (output.quaternion, output.roll_rad) = ([0.5, -0.5, 0.25, 0.125], -1.5);
        let (head, values) = table(output);
        let of = |name: &str| values[head.iter().position(|column| column == name).unwrap()].as_str();
        assert_eq!((of("tick"), of("t_start_ns"), of("incarnation"), of("roll_rad")), ("7", "-5", "9", "-1.5"));
        assert_eq!((of("quaternion_0"), of("quaternion_1"), of("quaternion_3")), ("0.5", "-0.5", "0.125"));
        let (head, values) = table(Health { pid: 77, ..bytemuck::Zeroable::zeroed() });
        assert_eq!(values[head.iter().position(|column| column == "pid").unwrap()], "77");
    }
}
