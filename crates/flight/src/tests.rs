//! Tests that record to a file and read it back.

use std::{collections::BTreeMap, fs, io::Cursor};

use foreign::ForeignText;
use graph::Topic;
use mcap::{
    Compression, WriteOptions,
    records::{MessageHeader, Metadata},
};
use messages::{AttitudeOutput, Health, ImuSample, Reference};

use crate::{FlightError, FlightHeader, FlightInfo, Recorder, RecordingMode, info::AttachmentInfo};

const TOPICS: [Topic; 3] = [Topic::Imu, Topic::Attitude, Topic::Health];

fn header() -> FlightHeader {
    FlightHeader {
        version: "1.2.3",
        system: "boat".into(),
        host: "board".into(),
        launch_file: None,
        launch: Some("name = \"boat\"\n".into()),
        config: "{}".into(),
        output: launch::Output::default(),
        rate_hz: 100.0,
    }
}

fn imu(tick: u64) -> Vec<u8> {
    let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
    (sample.header.tick, sample.header.t_end_ns) = (tick, 10_000_000 * tick.cast_signed());
    bytemuck::bytes_of(&sample).to_vec()
}

fn record_ticks(recorder: &mut Recorder, ticks: impl Iterator<Item = u64>) {
    let mut attitude: AttitudeOutput = bytemuck::Zeroable::zeroed();
    attitude.quaternion = [1.0, 0.0, 0.0, 0.0];
    let health: Health = bytemuck::Zeroable::zeroed();
    for tick in ticks {
        recorder.record(Topic::Imu, &imu(tick));
        attitude.header.tick = tick;
        recorder.record(Topic::Attitude, bytemuck::bytes_of(&attitude));
        recorder.record(Topic::Gyro, &[]);
    }
    recorder.record(Topic::Health, bytemuck::bytes_of(&health));
    recorder.poll();
}

fn counts(info: &FlightInfo) -> Vec<(&str, u64)> {
    info.topics.iter().map(|topic| (topic.topic.raw(), topic.messages)).collect()
}

#[test]
fn recorded_messages_and_attachments_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let mut recorder = Recorder::create(&path, &header(), &TOPICS, RecordingMode::Lockstep).unwrap();
    record_ticks(&mut recorder, 0..5000);
    let summary = recorder.finish("test ended", Some("{}".into()));
    assert_eq!((summary.messages, summary.missed, &summary.error), (10_001, 0, &None));
    let info = FlightInfo::read(&path).unwrap();
    assert_eq!(
        (&info.incomplete, info.end_reason.as_ref().map(ForeignText::raw), info.bytes),
        (&None, Some("test ended"), summary.bytes)
    );
    assert_eq!(counts(&info), [("/attitude", 5000), ("/health", 1), ("/imu", 5000), ("/pose", 5000), ("/tf", 5000)]);
    assert_eq!(info.metadata["plumbline"]["system"], "boat");
    let attached: Vec<_> =
        info.attachments.iter().map(|attachment| (attachment.name.raw(), attachment.bytes)).collect();
    assert_eq!(attached, [("launch.toml", 14), ("config.json", 2), ("report.json", 2)]);

    let error = Recorder::create(&path, &header(), &TOPICS, RecordingMode::FromAnyTick).unwrap_err();
    assert!(matches!(error, FlightError::Exists { .. }), "{error}");
}

#[test]
fn reference_received_late_has_time_of_its_sample() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let topics = [Topic::Imu, Topic::Reference];
    let mut recorder = Recorder::create(&path, &header(), &topics, RecordingMode::Lockstep).unwrap();
    (0..100).for_each(|tick| recorder.record(Topic::Imu, &imu(tick)));
    for tick in 0_u64..100 {
        let t_end_ns = 10_000_000 * tick.cast_signed();
        let reference = Reference { tick, t_end_ns, scored: 1, quaternion: [1.0, 0.0, 0.0, 0.0] };
        recorder.record(Topic::Reference, bytemuck::bytes_of(&reference));
    }
    recorder.finish("test ended", None);
    let mut times_ns = Vec::new();
    let mut collect = |t_ns, topic, _: &[u8]| {
        if topic == Topic::Reference {
            times_ns.push(t_ns);
        }
    };
    crate::reader::for_each_message(&path, &mut collect).unwrap();
    assert_eq!(times_ns, (0..100).map(|tick| 10_000_000 * tick).collect::<Vec<_>>());
}

#[test]
fn missed_messages_are_reported_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let mut recorder = Recorder::create(&path, &header(), &TOPICS, RecordingMode::FromFirstTick).unwrap();
    record_ticks(&mut recorder, (3..10).chain(14..20));
    recorder.record_overflow(Topic::Health);
    recorder.record_overflow(Topic::Imu);
    let summary = recorder.finish("test ended", None);
    assert_eq!(summary.missed, 2 * 7 + 1);
    assert!(summary.error.unwrap().contains("15 messages"));
    let info = FlightInfo::read(&path).unwrap();
    let missed: Vec<_> = info.missed.iter().map(|(topic, count)| (topic.raw(), *count)).collect();
    assert_eq!(missed, [("/attitude", 7), ("/health", 1), ("/imu", 7)]);
}

#[test]
fn truncated_file_is_read_up_to_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let [path, truncated] = ["flight.mcap", "truncated.mcap"].map(|name| folder.path().join(name));
    let mut recorder = Recorder::create(&path, &header(), &TOPICS, RecordingMode::Lockstep).unwrap();
    record_ticks(&mut recorder, 0..30_000);
    recorder.finish("test ended", None);
    let complete = fs::read(&path).unwrap();
    let mut max_messages = 0;
    for part in 0..=64 {
        fs::write(&truncated, &complete[..(complete.len() - 1) * part / 64]).unwrap();
        let info = FlightInfo::read(&truncated).unwrap();
        assert!(info.incomplete.is_some() && info.messages >= max_messages, "{part}: {info:?}");
        max_messages = info.messages;
    }
    assert_eq!(max_messages, 120_001);
    // Messages in a damaged chunk are not counted.
    let mut min_messages = u64::MAX;
    for part in 1..16 {
        let mut damaged = complete[..complete.len() - 8].to_vec();
        damaged[complete.len() * part / 16] ^= 0x55;
        fs::write(&truncated, &damaged).unwrap();
        let info = FlightInfo::read(&truncated).unwrap();
        assert!(info.incomplete.is_some() && info.messages <= max_messages, "{part}: {info:?}");
        min_messages = min_messages.min(info.messages);
    }
    assert!(min_messages < max_messages / 2, "{min_messages} of {max_messages}");
    fs::write(&truncated, "t_s,gx,gy\n0,1,2\n").unwrap();
    assert!(matches!(FlightInfo::read(&truncated), Err(FlightError::Malformed { .. })));
}

/// Text with a terminal escape and a forged line.
const HOSTILE: &str = "a\x1b[2J\nforged";

#[test]
fn info_of_hostile_flight_has_neither_escapes_nor_forged_lines() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("{HOSTILE}.mcap"));
    let header = FlightHeader { system: HOSTILE.into(), host: HOSTILE.into(), ..header() };
    let mut recorder = Recorder::create(&path, &header, &TOPICS, RecordingMode::Lockstep).unwrap();
    record_ticks(&mut recorder, 0..10);
    recorder.finish(HOSTILE, None);
    let mut info = FlightInfo::read(&path).unwrap();
    let hostile = ForeignText::from(HOSTILE);
    (info.topics[0].topic, info.topics[0].schema) = (hostile.clone(), hostile.clone());
    info.missed.insert(hostile.clone(), 1);
    info.attachments.push(AttachmentInfo { name: hostile.clone(), media_type: hostile.clone(), bytes: 1 });
    let text = info.to_string();
    assert_eq!(text.matches(r"a\u{1b}[2J\nforged").count(), 9, "{text:?}");
    assert!(!text.contains('\x1b') && !text.lines().any(|line| line.starts_with("forged")), "{text:?}");
    let json: serde_json::Value = serde_json::to_value(&info).unwrap();
    assert_eq!(json["metadata"]["plumbline"]["system"], HOSTILE);
}

#[test]
fn error_of_hostile_file_is_a_single_line_without_escapes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let mut file = mcap::MAGIC.to_vec();
    // Chunk with an unknown compression. Its fields are times and size, CRC, name of the
    // compression and length of the records.
    let chunk = [&[0; 28][..], &(HOSTILE.len() as u32).to_le_bytes(), HOSTILE.as_bytes(), &[0; 8]].concat();
    file.push(6);
    file.extend((chunk.len() as u64).to_le_bytes());
    file.extend(chunk);
    fs::write(&path, file).unwrap();
    let error = crate::read_launch_file(&path).unwrap_err().to_string();
    assert!(error.contains(r"a\u{1b}[2J\nforged") && error.lines().count() == 1, "{error:?}");
    let info = FlightInfo::read(&path).unwrap();
    assert!(info.incomplete.is_some_and(|reason| reason.raw().contains(HOSTILE)));
}

#[test]
fn implausibly_uniform_file_is_refused_while_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let mut file = Cursor::new(Vec::new());
    let mut writer = WriteOptions::new().compression(Some(Compression::Zstd)).create(&mut file).unwrap();
    let channel_id = writer.add_channel(0, "/imu", "protobuf", &BTreeMap::new()).unwrap();
    let header = MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
    (0..100).for_each(|_| writer.write_to_known_channel(&header, &[0; 1 << 20]).unwrap());
    writer.finish().unwrap();
    drop(writer);
    // If the end of the file is missing, `FlightInfo` reads the records instead of the summary.
    let bytes = &file.get_ref()[..file.get_ref().len() - mcap::MAGIC.len()];
    fs::write(&path, bytes).unwrap();
    let expected = "bytes decompress to more than 6";
    let error = crate::read_launch_file(&path).unwrap_err().to_string();
    assert!(error.contains(expected), "{error}");
    let info = FlightInfo::read(&path).unwrap();
    assert!(info.messages < 70 && info.incomplete.unwrap().raw().contains(expected));
}

#[test]
fn index_that_repeats_a_long_record_is_not_followed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let mut file = Cursor::new(Vec::new());
    let mut writer = WriteOptions::new().calculate_summary_section_crc(false).create(&mut file).unwrap();
    for (name, length) in [("long.", 1 << 20)].into_iter().chain([("short", 1); 100]) {
        let metadata = BTreeMap::from([("text".to_owned(), "x".repeat(length))]);
        writer.write_metadata(&Metadata { name: name.into(), metadata }).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    // An entry of the index has an opcode, a length, the position and length of the record, and a
    // name. Every entry is changed to that of the first record.
    let mut bytes = file.into_inner();
    let start = [&[13][..], &25u64.to_le_bytes()].concat();
    let entries: Vec<_> = (0..bytes.len()).filter(|at| bytes[*at..].starts_with(&start)).collect();
    assert_eq!(entries.len(), 101);
    let first = entries[0] + start.len()..entries[0] + start.len() + 16;
    entries.iter().for_each(|at| bytes.copy_within(first.clone(), at + start.len()));
    fs::write(&path, bytes).unwrap();
    let info = FlightInfo::read(&path).unwrap();
    let names: Vec<_> = info.metadata.keys().map(ForeignText::raw).collect();
    let damage = info.incomplete.as_ref().map_or("", ForeignText::raw);
    assert!(damage.contains("longer than the file") && names == ["long.", "short"], "{damage:?} {names:?}");
}

#[test]
fn unused_path_skips_existing_file() {
    let folder = tempfile::tempdir().unwrap();
    let first = crate::unused_path(folder.path(), "boat").unwrap();
    let name = first.file_name().unwrap().to_str().unwrap();
    assert!(name.starts_with("boat-20") && name.ends_with("Z.mcap") && name.len() == 26, "{name}");
    fs::write(&first, "").unwrap();
    assert_ne!(crate::unused_path(folder.path(), "boat").unwrap(), first);
}
