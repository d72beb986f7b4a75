//! From the recorder into the file and back.

use std::fs;

use graph::Topic;
use messages::{AttitudeOutput, Health, ImuSample};

use crate::{FlightError, FlightInfo, Heading, Mode, Recorder};

const TOPICS: [Topic; 3] = [Topic::Imu, Topic::Attitude, Topic::Health];

fn heading() -> Heading {
    Heading {
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

fn recorded(recorder: &mut Recorder, ticks: impl Iterator<Item = u64>) {
    let mut attitude: AttitudeOutput = bytemuck::Zeroable::zeroed();
    attitude.quaternion = [1.0, 0.0, 0.0, 0.0];
    let health: Health = bytemuck::Zeroable::zeroed();
    for tick in ticks {
        recorder.take(Topic::Imu, &imu(tick));
        attitude.header.tick = tick;
        recorder.take(Topic::Attitude, bytemuck::bytes_of(&attitude));
        recorder.take(Topic::Gyro, &[]);
    }
    recorder.take(Topic::Health, bytemuck::bytes_of(&health));
    recorder.look();
}

fn counts(info: &FlightInfo) -> Vec<(&str, u64)> {
    info.topics.iter().map(|topic| (topic.topic.as_str(), topic.messages)).collect()
}

#[test]
fn what_was_taken_is_read_back_with_all_that_goes_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let mut recorder = Recorder::begin(&path, &heading(), &TOPICS, Mode::Lockstep).unwrap();
    recorded(&mut recorder, 0..5000);
    let summary = recorder.end("it was a test", Some("{}".into()));
    assert_eq!((summary.messages, summary.missed, &summary.error), (10_001, 0, &None));
    let info = FlightInfo::read(&path).unwrap();
    assert_eq!((&info.cut, info.end.as_deref(), info.bytes), (&None, Some("it was a test"), summary.bytes));
    assert_eq!(counts(&info), [("/attitude", 5000), ("/health", 1), ("/imu", 5000), ("/pose", 5000), ("/tf", 5000)]);
    assert_eq!(info.metadata["plumbline"]["system"], "boat");
    let attached: Vec<_> = info.attachments.iter().map(|it| (it.name.as_str(), it.bytes)).collect();
    assert_eq!(attached, [("launch.toml", 14), ("config.json", 2), ("report.json", 2)]);

    let error = Recorder::begin(&path, &heading(), &TOPICS, Mode::Live).unwrap_err();
    assert!(matches!(error, FlightError::Exists { .. }), "{error}");
}

#[test]
fn what_is_missed_is_told_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let mut recorder = Recorder::begin(&path, &heading(), &TOPICS, Mode::FromTheFirst).unwrap();
    recorded(&mut recorder, (3..10).chain(14..20));
    recorder.overflowed(Topic::Health);
    recorder.overflowed(Topic::Imu);
    let summary = recorder.end("it was a test", None);
    assert_eq!(summary.missed, 2 * 7 + 1);
    assert!(summary.error.unwrap().contains("not in the file: 15 messages"));
    let info = FlightInfo::read(&path).unwrap();
    let missed: Vec<_> = info.missed.iter().map(|(topic, count)| (topic.as_str(), *count)).collect();
    assert_eq!(missed, [("/attitude", 7), ("/health", 1), ("/imu", 7)]);
}

#[test]
fn wherever_a_file_is_cut_what_is_before_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let [path, cut] = ["flight.mcap", "cut.mcap"].map(|name| folder.path().join(name));
    let mut recorder = Recorder::begin(&path, &heading(), &TOPICS, Mode::Lockstep).unwrap();
    recorded(&mut recorder, 0..30_000);
    recorder.end("it was a test", None);
    let whole = fs::read(&path).unwrap();
    let mut most = 0;
    for part in 0..=64 {
        fs::write(&cut, &whole[..(whole.len() - 1) * part / 64]).unwrap();
        let info = FlightInfo::read(&cut).unwrap();
        assert!(info.cut.is_some() && info.messages >= most, "{part}: {info:?}");
        most = info.messages;
    }
    assert_eq!(most, 120_001);
    // Of a chunk that is damaged nothing is taken for messages.
    let mut fewest = u64::MAX;
    for part in 1..16 {
        let mut damaged = whole[..whole.len() - 8].to_vec();
        damaged[whole.len() * part / 16] ^= 0x55;
        fs::write(&cut, &damaged).unwrap();
        let info = FlightInfo::read(&cut).unwrap();
        assert!(info.cut.is_some() && info.messages <= most, "{part}: {info:?}");
        fewest = fewest.min(info.messages);
    }
    assert!(fewest < most / 2, "{fewest} of {most}");
    fs::write(&cut, "t_s,gx,gy\n0,1,2\n").unwrap();
    assert!(matches!(FlightInfo::read(&cut), Err(FlightError::Malformed { .. })));
}

#[test]
fn names_are_free() {
    let folder = tempfile::tempdir().unwrap();
    let first = crate::free_path(folder.path(), "boat").unwrap();
    let name = first.file_name().unwrap().to_str().unwrap();
    assert!(name.starts_with("boat-20") && name.ends_with("Z.mcap") && name.len() == 26, "{name}");
    fs::write(&first, "").unwrap();
    assert_ne!(crate::free_path(folder.path(), "boat").unwrap(), first);
}
