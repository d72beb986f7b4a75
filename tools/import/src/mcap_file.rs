//! Conversion of a Plumbline recording into an MCAP file.
//!
//! Input: a recording and its fixes.
//!
//! Output: messages of `proto/plumbline/v1` on the topics `imu`, `mag`, `reference` and `gnss`,
//! readable by any MCAP and protobuf reader. Importing the file restores the values.
//!
//! Time: timestamps of the recording.
//!
//! Failure: no partial file remains.

use std::{
    collections::BTreeMap,
    fs::File,
    io::BufWriter,
    path::{Path, PathBuf},
};

use mcap::{Compression, WriteOptions, Writer, records::MessageHeader};
use messages::{Flags, GnssFix, Header, ImuSample, MagSample, Reference};
use recording::{
    Reader, Row,
    gnss::{self, FixReader},
};
use tempfile::NamedTempFile;
use wire::Payload;

use crate::ImportError;

/// Library name in the file header. It distinguishes an import from a recorded flight.
const LIBRARY: &str = "plumb import";
const CHUNK_BYTES: u64 = 1 << 20;

/// Converts a recording and its fixes into the MCAP file `out`.
///
/// The file is readable only by its owner and appears only once it is complete.
///
/// # Errors
///
/// Returns [`ImportError::Recording`] if the recording cannot be read, and
/// [`ImportError::WriteMcap`] if the file cannot be written.
pub fn to_mcap(recording: &Path, out: &Path) -> Result<(), ImportError> {
    let failed = |cause: String| ImportError::WriteMcap { path: out.to_owned(), cause };
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).map_or(Path::new("."), |folder| folder);
    let file = NamedTempFile::new_in(folder).map_err(|cause| failed(cause.to_string()))?;
    let mut messages = MessageWriter::new(&file).map_err(|cause| failed(cause.to_string()))?;
    let mut fixes = gnss::find_for(recording).map(|path: PathBuf| FixReader::open(&path)).transpose()?;
    let mut previous_ns = None;
    for (tick, row) in (0..).zip(Reader::open(recording)?) {
        let row = row?;
        let fix = fixes.as_mut().map_or(Ok(None), |fixes| fixes.latest_until(row.t_ns))?;
        let t_start_ns = previous_ns.replace(row.t_ns).unwrap_or(row.t_ns);
        messages.write_row(tick, t_start_ns, &row, fix.as_ref()).map_err(|cause| failed(cause.to_string()))?;
    }
    messages.writer.finish().map_err(|cause| failed(cause.to_string()))?;
    drop(messages);
    file.persist(out).map_err(|cause| failed(cause.error.to_string()))?;
    Ok(())
}

/// MCAP writer with one channel per topic.
struct MessageWriter<'a> {
    writer: Writer<BufWriter<&'a File>>,
    channels: BTreeMap<&'static str, u16>,
}

impl<'a> MessageWriter<'a> {
    fn new(file: &'a NamedTempFile) -> mcap::McapResult<Self> {
        let options = WriteOptions::new().profile("").library(LIBRARY).compression(Some(Compression::Zstd));
        let writer = options.chunk_size(Some(CHUNK_BYTES)).create(BufWriter::new(file.as_file()))?;
        Ok(Self { writer, channels: BTreeMap::new() })
    }

    fn write_row(&mut self, tick: u64, t_start_ns: i64, row: &Row, fix: Option<&gnss::Fix>) -> mcap::McapResult<()> {
        let Row { t_ns, rate_rad_s, force_m_s2, field_ut, reference } = *row;
        let flags = Flags::FIELD.when(field_ut.is_some()) | Flags::FIX.when(fix.is_some());
        let header = Header { tick, t_start_ns, t_end_ns: t_ns, flags, ..bytemuck::Zeroable::zeroed() };
        if let Some(fix) = fix {
            let or_nan = |number: Option<f64>| number.unwrap_or(f64::NAN);
            let message = GnssFix {
                header: Header { t_end_ns: fix.t_ns, ..header },
                velocity_m_s: fix.velocity_m_s,
                velocity_sd_m_s: f64::NAN,
                age_s: f64::NAN,
                latitude_rad: or_nan(fix.latitude_deg).to_radians(),
                longitude_rad: or_nan(fix.longitude_deg).to_radians(),
                altitude_m: or_nan(fix.altitude_m),
            };
            self.write(tick, fix.t_ns, &message)?;
        }
        if let Some(field_ut) = field_ut {
            self.write(tick, t_ns, &MagSample { header, field_ut })?;
        }
        if let Some(recording::Reference { quaternion, scored }) = reference {
            self.write(tick, t_ns, &Reference { tick, t_end_ns: t_ns, scored: scored.into(), quaternion })?;
        }
        self.write(tick, t_ns, &ImuSample { header, rate_rad_s, force_m_s2 })
    }

    fn write<M: Payload>(&mut self, tick: u64, t_ns: i64, message: &M) -> mcap::McapResult<()> {
        let entry = M::TOPIC;
        let channel_id = match self.channels.get(entry.name) {
            Some(id) => *id,
            None => {
                let schema = format!("plumbline.v1.{}", entry.payload);
                let descriptors = wire::schema::descriptors_for(&schema).unwrap_or_default();
                let schema = self.writer.add_schema(&schema, "protobuf", &descriptors)?;
                let name = format!("/{}", entry.name);
                let id = self.writer.add_channel(schema, &name, "protobuf", &BTreeMap::new())?;
                self.channels.insert(entry.name, id);
                id
            }
        };
        // MCAP cannot express log times before 1970. The message content has the correct time.
        let time = u64::try_from(t_ns).unwrap_or(0);
        let header = MessageHeader { channel_id, sequence: tick as u32, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, &message.to_bytes())
    }
}
