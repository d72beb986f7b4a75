//! MCAP file that keeps its index in a second file instead of in memory.
//!
//! Input: schemas, channels, messages, attachments and metadata.
//!
//! Output: an MCAP file with chunks, message indexes and a summary (<https://mcap.dev/spec>).
//!
//! Failure: no more data is written after the first error.
//!
//! The writer of the crate `mcap` keeps the index of every chunk in memory until the end, and then
//! copies it twice. At four chunks per second that is 11 MB per hour.

use std::{
    collections::BTreeMap,
    io::{self, Write},
    mem,
    path::Path,
};

use mcap::{
    MAGIC,
    records::{AttachmentHeader, MessageHeader, op},
};

use crate::{chunk_file::ChunkFile, spill_file::SpillFile};

/// Uncompressed size at which a chunk is completed without waiting for the next flush, bytes.
const CHUNK_BYTES: usize = 1 << 20;
/// Name of the compression of chunks.
const COMPRESSION: &str = "lz4";

pub(crate) struct McapFile {
    file: ChunkFile,
    /// Checksum of the data section so far.
    crc: crc32fast::Hasher,
    chunk: Chunk,
    /// Schema and channel records, repeated in the summary.
    schemas: Group,
    channels: Group,
    /// Identifiers of the schemas by name.
    schema_ids: BTreeMap<String, u16>,
    /// Number of messages of each channel.
    messages: BTreeMap<u16, u64>,
    /// Times of the earliest and the latest message.
    span: Option<[u64; 2]>,
    chunk_indexes: SpillFile,
    attachment_indexes: Group,
    metadata_indexes: SpillFile,
}

/// Records of one kind that are few enough to be kept in memory.
#[derive(Default)]
struct Group {
    records: Vec<u8>,
    count: u32,
}

/// Chunk that is not complete yet.
#[derive(Default)]
struct Chunk {
    records: Vec<u8>,
    /// Time and offset of each message, by channel.
    indexes: BTreeMap<u16, Vec<(u64, u64)>>,
    /// Times of the earliest and the latest message.
    span: Option<[u64; 2]>,
}

impl McapFile {
    /// Starts a file. The index is kept in an unnamed file in the folder of `path`.
    pub(crate) fn create(file: ChunkFile, path: &Path, library: &str) -> io::Result<Self> {
        let mut mcap = Self {
            file,
            crc: crc32fast::Hasher::new(),
            chunk: Chunk::default(),
            schemas: Group::default(),
            channels: Group::default(),
            schema_ids: BTreeMap::new(),
            messages: BTreeMap::new(),
            span: None,
            chunk_indexes: SpillFile::create(path, "chunks")?,
            attachment_indexes: Group::default(),
            metadata_indexes: SpillFile::create(path, "metadata")?,
        };
        mcap.append(MAGIC);
        mcap.append(&record(op::HEADER, Body::default().text("").text(library)));
        Ok(mcap)
    }

    /// Adds a channel with protobuf messages and returns its identifier.
    pub(crate) fn add_channel(
        &mut self,
        topic: &str,
        (schema, descriptors): (&str, &[u8]),
        metadata: &BTreeMap<String, String>,
    ) -> io::Result<u16> {
        let schema_id = match self.schema_ids.get(schema) {
            Some(id) => *id,
            None => {
                let id = identifier(self.schemas.count + 1)?;
                let body = Body::default().u16(id).text(schema).text("protobuf").bytes32(descriptors);
                self.schema_ids.insert(schema.into(), id);
                self.schemas.add(&record(op::SCHEMA, body), &mut self.chunk.records);
                id
            }
        };
        let id = identifier(self.channels.count)?;
        let body = Body::default().u16(id).u16(schema_id).text(topic).text("protobuf").map(metadata);
        self.channels.add(&record(op::CHANNEL, body), &mut self.chunk.records);
        Ok(id)
    }

    /// Adds a message to the current chunk.
    pub(crate) fn write_message(&mut self, header: &MessageHeader, data: &[u8]) -> io::Result<()> {
        let MessageHeader { channel_id, sequence, log_time, publish_time } = *header;
        let offset = self.chunk.records.len() as u64;
        let body = Body::default().u16(channel_id).u32(sequence).u64(log_time).u64(publish_time);
        write_record(&mut self.chunk.records, op::MESSAGE, &[&body.0, data]);
        self.chunk.indexes.entry(channel_id).or_default().push((log_time, offset));
        *self.messages.entry(channel_id).or_default() += 1;
        for span in [&mut self.chunk.span, &mut self.span] {
            let [first, last] = span.unwrap_or([log_time; 2]);
            *span = Some([first.min(log_time), last.max(log_time)]);
        }
        if self.chunk.records.len() >= CHUNK_BYTES { self.flush() } else { Ok(()) }
    }

    /// Completes the current chunk and writes an attachment.
    pub(crate) fn attach(&mut self, header: &AttachmentHeader, data: &[u8]) -> io::Result<()> {
        self.flush()?;
        let AttachmentHeader { log_time, create_time, name, media_type } = header;
        let body = Body::default().u64(*log_time).u64(*create_time).text(name).text(media_type).bytes64(data);
        let crc = crc32fast::hash(&body.0);
        let [offset, length] = self.append(&record(op::ATTACHMENT, body.u32(crc)));
        let index = Body::default().u64(offset).u64(length).u64(*log_time).u64(*create_time).u64(data.len() as u64);
        self.attachment_indexes.add(&record(op::ATTACHMENT_INDEX, index.text(name).text(media_type)), &mut Vec::new());
        self.file.flush()
    }

    /// Completes the current chunk and writes a metadata record.
    pub(crate) fn write_metadata(&mut self, name: &str, metadata: &BTreeMap<String, String>) -> io::Result<()> {
        self.flush()?;
        let [offset, length] = self.append(&record(op::METADATA, Body::default().text(name).map(metadata)));
        self.metadata_indexes.push(&record(op::METADATA_INDEX, Body::default().u64(offset).u64(length).text(name)))?;
        self.file.flush()
    }

    /// Completes the current chunk and writes it to the file.
    pub(crate) fn flush(&mut self) -> io::Result<()> {
        if !self.chunk.records.is_empty() {
            let chunk = mem::take(&mut self.chunk);
            let [start, end] = chunk.span.unwrap_or([0; 2]);
            let size = chunk.records.len() as u64;
            let compressed = compress(&chunk.records)?;
            let compressed_size = compressed.len() as u64;
            let body = Body::default().u64(start).u64(end).u64(size).u32(crc32fast::hash(&chunk.records));
            let [offset, length] = self.append(&record(op::CHUNK, body.text(COMPRESSION).bytes64(&compressed)));
            let (mut offsets, mut index_length) = (Vec::new(), 0);
            for (channel, entries) in &chunk.indexes {
                let times: Vec<u8> =
                    entries.iter().flat_map(|(t, at)| [t.to_le_bytes(), at.to_le_bytes()].concat()).collect();
                let [offset, length] =
                    self.append(&record(op::MESSAGE_INDEX, Body::default().u16(*channel).bytes32(&times)));
                offsets.extend(channel.to_le_bytes());
                offsets.extend(offset.to_le_bytes());
                index_length += length;
            }
            let index = Body::default().u64(start).u64(end).u64(offset).u64(length).bytes32(&offsets);
            let index = index.u64(index_length).text(COMPRESSION).u64(compressed_size).u64(size);
            self.chunk_indexes.push(&record(op::CHUNK_INDEX, index))?;
            // The buffer is reused.
            self.chunk.records = chunk.records;
            self.chunk.records.clear();
        }
        self.file.flush()
    }

    /// Completes the file with its summary.
    pub(crate) fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        let crc = mem::take(&mut self.crc).finalize();
        self.file.write_all(&record(op::DATA_END, Body::default().u32(crc)))?;
        let start = self.file.position();
        let mut summary = Summary { file: &mut self.file, crc: crc32fast::Hasher::new(), offsets: Vec::new() };
        summary.write_group(op::SCHEMA, |summary| summary.write(&self.schemas.records))?;
        summary.write_group(op::CHANNEL, |summary| summary.write(&self.channels.records))?;
        let counts: Vec<u8> = self
            .messages
            .iter()
            .flat_map(|(id, count)| [&id.to_le_bytes()[..], &count.to_le_bytes()].concat())
            .collect();
        let [first, last] = self.span.unwrap_or([0; 2]);
        let statistics = Body::default()
            .u64(self.messages.values().sum())
            .u16(identifier(self.schemas.count)?)
            .u32(self.channels.count)
            .u32(self.attachment_indexes.count)
            .u32(self.metadata_indexes.count())
            .u32(self.chunk_indexes.count())
            .u64(first)
            .u64(last)
            .bytes32(&counts);
        summary.write_group(op::STATISTICS, |summary| summary.write(&record(op::STATISTICS, statistics)))?;
        let (chunks, metadata) = (&mut self.chunk_indexes, &mut self.metadata_indexes);
        summary.write_group(op::CHUNK_INDEX, |summary| chunks.read(&mut |part| summary.write(part)))?;
        summary.write_group(op::ATTACHMENT_INDEX, |summary| summary.write(&self.attachment_indexes.records))?;
        summary.write_group(op::METADATA_INDEX, |summary| metadata.read(&mut |part| summary.write(part)))?;
        let offsets_start = summary.file.position();
        let offsets = mem::take(&mut summary.offsets);
        summary.write(&offsets)?;
        // The checksum includes the footer up to the checksum itself.
        let footer = record(op::FOOTER, Body::default().u64(start).u64(offsets_start).u32(0));
        let (checked, _) = footer.split_at(footer.len() - size_of::<u32>());
        summary.write(checked)?;
        let crc = summary.crc.finalize();
        self.file.write_all(&crc.to_le_bytes())?;
        self.file.write_all(MAGIC)?;
        self.file.flush()
    }

    /// Returns the underlying file.
    pub(crate) fn into_inner(self) -> ChunkFile {
        self.file
    }

    /// Appends bytes to the data section and returns their offset and length.
    fn append(&mut self, bytes: &[u8]) -> [u64; 2] {
        let offset = self.file.position();
        self.crc.update(bytes);
        self.file.append(bytes);
        [offset, bytes.len() as u64]
    }
}

impl Group {
    /// Appends a record to the group and to `copy`.
    fn add(&mut self, record: &[u8], copy: &mut Vec<u8>) {
        self.records.extend_from_slice(record);
        copy.extend_from_slice(record);
        self.count += 1;
    }
}

/// Summary section that is being written.
struct Summary<'a> {
    file: &'a mut ChunkFile,
    crc: crc32fast::Hasher,
    /// Records with the offset of each group.
    offsets: Vec<u8>,
}

impl Summary<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.crc.update(bytes);
        self.file.write_all(bytes)
    }

    /// Writes a group of records with the opcode `code`, unless it is empty.
    fn write_group(&mut self, code: u8, write: impl FnOnce(&mut Self) -> io::Result<()>) -> io::Result<()> {
        let start = self.file.position();
        write(self)?;
        let length = self.file.position() - start;
        if length > 0 {
            self.offsets.extend(record(op::SUMMARY_OFFSET, Body::default().u8(code).u64(start).u64(length)));
        }
        Ok(())
    }
}

/// Content of a record.
#[derive(Default)]
struct Body(Vec<u8>);

impl Body {
    fn u8(self, value: u8) -> Self {
        self.raw(&[value])
    }

    fn u16(self, value: u16) -> Self {
        self.raw(&value.to_le_bytes())
    }

    fn u32(self, value: u32) -> Self {
        self.raw(&value.to_le_bytes())
    }

    fn u64(self, value: u64) -> Self {
        self.raw(&value.to_le_bytes())
    }

    fn text(self, text: &str) -> Self {
        self.bytes32(text.as_bytes())
    }

    /// Adds the number of bytes as 32 bits, then the bytes.
    fn bytes32(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len() as u32).raw(bytes)
    }

    /// Adds the number of bytes as 64 bits, then the bytes.
    fn bytes64(self, bytes: &[u8]) -> Self {
        self.u64(bytes.len() as u64).raw(bytes)
    }

    fn map(self, entries: &BTreeMap<String, String>) -> Self {
        let content = entries.iter().fold(Self::default(), |body, (key, value)| body.text(key).text(value));
        self.bytes32(&content.0)
    }

    fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }
}

/// Returns a complete record.
fn record(code: u8, body: Body) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_record(&mut bytes, code, &[&body.0]);
    bytes
}

/// Appends a record. Its content is the concatenation of `parts`.
fn write_record(bytes: &mut Vec<u8>, code: u8, parts: &[&[u8]]) {
    let length: usize = parts.iter().map(|part| part.len()).sum();
    bytes.push(code);
    bytes.extend((length as u64).to_le_bytes());
    parts.iter().for_each(|part| bytes.extend_from_slice(part));
}

/// Converts the number of a schema or channel to an identifier. Fails if there are too many.
fn identifier(number: u32) -> io::Result<u16> {
    u16::try_from(number).map_err(|_| io::Error::other("more than 65535 schemas or channels"))
}

fn compress(bytes: &[u8]) -> io::Result<Vec<u8>> {
    // Block checksums are omitted, because some readers do not support them. The checksum of the
    // chunk covers its content anyway.
    let checksum = lz4::liblz4::BlockChecksum::NoBlockChecksum;
    let mut encoder = lz4::EncoderBuilder::new().block_checksum(checksum).build(Vec::new())?;
    encoder.write_all(bytes)?;
    let (compressed, result) = encoder.finish();
    result.map(|()| compressed)
}

#[cfg(test)]
mod tests {
    use std::{fs, io::Read};

    use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

    use super::*;

    /// Writes a file with `chunks` chunks and returns its content.
    fn file_with_chunks(path: &Path, chunks: u64, between: &mut dyn FnMut(u64)) -> Vec<u8> {
        let mut mcap = McapFile::create(ChunkFile::create(path).unwrap(), path, "test").unwrap();
        let channels: Vec<_> = (0..28)
            .map(|number| {
                mcap.add_channel(&format!("/{number}"), ("Schema", b"descriptors"), &BTreeMap::new()).unwrap()
            })
            .collect();
        let header = AttachmentHeader { log_time: 1, create_time: 2, name: "a".into(), media_type: "b".into() };
        mcap.attach(&header, b"content").unwrap();
        for chunk in 0..chunks {
            for channel_id in &channels {
                let header = MessageHeader { channel_id: *channel_id, sequence: 1, log_time: chunk, publish_time: 3 };
                mcap.write_message(&header, &chunk.to_le_bytes()).unwrap();
            }
            mcap.flush().unwrap();
            between(chunk);
        }
        mcap.write_metadata("m", &BTreeMap::from([("key".into(), "value".into())])).unwrap();
        mcap.finish().unwrap();
        drop(mcap);
        fs::read(path).unwrap()
    }

    #[test]
    fn library_reads_messages_index_and_checksums() {
        let folder = tempfile::tempdir().unwrap();
        let bytes = file_with_chunks(&folder.path().join("a.mcap"), 3000, &mut |_| {});
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "the file of the index has no name");
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let stats = summary.stats.clone().unwrap();
        assert_eq!((stats.message_count, stats.schema_count, stats.channel_count), (84_000, 1, 28));
        assert_eq!((stats.attachment_count, stats.metadata_count, stats.chunk_count), (1, 1, 3001));
        assert_eq!((stats.message_start_time, stats.message_end_time), (0, 2999));
        assert_eq!(stats.channel_message_counts.len(), 28);
        assert_eq!((summary.chunk_indexes.len(), summary.channels.len(), summary.schemas.len()), (3001, 28, 1));
        let last = summary.chunk_indexes.last().unwrap();
        assert_eq!((last.message_start_time, last.message_index_offsets.len()), (2999, 28));
        let indexed = summary.read_message_indexes(&bytes, last).unwrap();
        assert_eq!(indexed.len(), 28);
        for entries in indexed.values() {
            let message = summary.seek_message(&bytes, last, &entries[0]).unwrap();
            assert_eq!((message.log_time, &message.data[..]), (2999, &2999_u64.to_le_bytes()[..]));
        }
        let attachment = mcap::read::attachment(&bytes, &summary.attachment_indexes[0]).unwrap();
        assert_eq!((&attachment.data[..], &attachment.name[..]), (&b"content"[..], "a"));
        let metadata = mcap::read::metadata(&bytes, &summary.metadata_indexes[0]).unwrap();
        assert_eq!(metadata.metadata["key"], "value");
        let messages = mcap::MessageStream::new(&bytes).unwrap();
        assert_eq!(messages.map(|message| message.unwrap().log_time).sum::<u64>(), 28 * 2999 * 3000 / 2);

        assert!(has_valid_checksums(&bytes));
        let mut damaged = bytes.clone();
        // The first byte to be damaged is in the name of the library, the second in the statistics.
        for at in [MAGIC.len() + 9 + 8, bytes.len() - 1000] {
            damaged[at] ^= 1;
            assert!(!has_valid_checksums(&damaged), "byte {at}");
            damaged[at] ^= 1;
        }
    }

    fn has_valid_checksums(mut bytes: &[u8]) -> bool {
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true);
        let mut reader = LinearReader::new_with_options(options);
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(count)) => {
                    let read = bytes.read(reader.insert(count)).unwrap();
                    reader.notify_read(read);
                }
                Ok(LinearReadEvent::Record { .. }) => {}
                Err(_) => return false,
            }
        }
        true
    }

    /// Environment variable that is set in the process that measures its own memory.
    const MEASURES: &str = "PLUMBLINE_MEASURES_MEMORY";

    #[test]
    fn memory_does_not_grow_with_number_of_chunks() {
        if std::env::var_os(MEASURES).is_none() {
            // The memory is measured in a separate process, in which no other test allocates.
            let name = "mcap_file::tests::memory_does_not_grow_with_number_of_chunks";
            let mut command = std::process::Command::new(std::env::current_exe().unwrap());
            let output = command.args(["--exact", name, "--nocapture"]).env(MEASURES, "1").output().unwrap();
            let printed = String::from_utf8_lossy(&output.stdout);
            assert!(output.status.success() && printed.contains("1 passed"), "{printed}");
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let (mut early, mut late) = (0, 0);
        // Number of chunks of a flight of three hours.
        file_with_chunks(&folder.path().join("a.mcap"), 43_200, &mut |chunk| match chunk {
            2000 => early = anonymous_kb(),
            43_199 => late = anonymous_kb(),
            _ => {}
        });
        println!("{early} KiB, then {late} KiB");
        assert!(late < early + 8192, "{early} KiB, then {late} KiB");
    }

    /// Returns the size of the heap and the stacks of this process, KiB.
    fn anonymous_kb() -> u64 {
        let status = fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find(|line| line.starts_with("RssAnon")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }
}
