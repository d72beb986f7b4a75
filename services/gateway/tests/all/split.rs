//! Ticks carried from one host to another arrive complete and in order over a faulty network. Lost
//! ticks are reported exactly.
use std::ops::Range;

use bytemuck::Zeroable;
use gateway::split::{
    cache::Cache,
    frame::{Frame, FrameError, FrameHeader},
    losses::LossLog,
    merge::Merge,
    reassembly::{Delivery, Reassembly, ReassemblyError},
    record::{CARRIED_TOPICS, Record, index_of, topics_in},
};
use messages::{AccelPoint, Flags, GyroStep, Header, MagSample, Message};
use proptest::prelude::*;

const RATE_HZ: f64 = 1000.0;
const LATENESS: u64 = 20;

fn mask(topics: &[&str]) -> u8 {
    topics.iter().fold(0, |mask, topic| mask | 1 << index_of(topic).unwrap())
}

fn header(tick: u64) -> Header {
    // Every third tick has a magnetic field.
    let flags = Flags::FIELD.when(tick.is_multiple_of(3));
    Header {
        tick,
        t_start_ns: tick as i64 * 1_000_000,
        t_end_ns: (tick as i64 + 1) * 1_000_000,
        flags,
        ..Header::zeroed()
    }
}

fn gyro(tick: u64) -> GyroStep {
    GyroStep { header: header(tick), z_rad: tick as f64, ..GyroStep::zeroed() }
}

fn accel(tick: u64) -> AccelPoint {
    AccelPoint { header: header(tick), norm_m_s2: tick as f64, ..AccelPoint::zeroed() }
}

fn mag(tick: u64) -> MagSample {
    MagSample { header: header(tick), field_ut: [tick as f64; 3] }
}

fn offer<M: messages::Ticked>(merge: &mut Merge, message: M) {
    let header = message.header();
    merge.offer(index_of(M::TOPIC.name).unwrap(), header.tick, header.flags, bytemuck::bytes_of(&message));
}

/// Returns the merged record of a tick with all its messages.
fn full_record(tick: u64) -> Record {
    let mut record = Record::new(tick);
    if tick.is_multiple_of(3) {
        record.push(index_of("mag").unwrap(), bytemuck::bytes_of(&mag(tick)));
    }
    record.push(index_of("gyro").unwrap(), bytemuck::bytes_of(&gyro(tick)));
    record.push(index_of("accel").unwrap(), bytemuck::bytes_of(&accel(tick)));
    record
}

fn all_topics() -> u8 {
    mask(&["mag", "accel", "gyro"])
}

fn frame_header(cache: &Cache, first_tick: u64) -> FrameHeader {
    let topics = topics_in(all_topics()).map(|(_, topic)| (topic.name.to_owned(), topic.fingerprint)).collect();
    FrameHeader {
        run: 7,
        rate_hz: RATE_HZ,
        topics,
        oldest_tick: cache.oldest_tick().unwrap(),
        next_tick: cache.next_tick().unwrap(),
        first_tick,
    }
}

/// Encodes the cached records of a span of ticks.
fn frame(cache: &Cache, span: Range<u64>) -> Vec<u8> {
    let first_tick = span.start.clamp(cache.oldest_tick().unwrap(), cache.next_tick().unwrap());
    Frame::encode(
        &frame_header(cache, first_tick),
        cache.iter_from(first_tick).take_while(|record| record.tick < span.end),
    )
    .0
}

fn cache(ticks: Range<u64>, max: usize) -> Cache {
    let mut cache = Cache::new(max);
    ticks.for_each(|tick| cache.push(full_record(tick)));
    cache
}

fn reassembly(next_tick: u64) -> Reassembly {
    Reassembly::new(all_topics(), RATE_HZ, None, next_tick, u64::MAX)
}

fn drain(merge: &mut Merge) -> Vec<Record> {
    std::iter::from_fn(|| merge.next_record()).collect()
}

#[test]
fn merge_waits_for_slowest_topic() {
    let mut merge = Merge::new(all_topics(), LATENESS);
    offer(&mut merge, gyro(0));
    assert_eq!(merge.awaited_topic(), index_of("accel"));
    offer(&mut merge, accel(0));
    offer(&mut merge, accel(1));
    assert_eq!(merge.awaited_topic(), index_of("mag"), "tick 0 has a field");
    offer(&mut merge, mag(0));
    assert!(merge.next_record().is_some());
    assert_eq!(merge.awaited_topic(), index_of("gyro"));
}

#[test]
fn reassembly_is_ready_iff_delivery_is_available() {
    let mut cache = Cache::new(4);
    let mut reassembly = Reassembly::new(all_topics(), RATE_HZ, None, 0, u64::MAX);
    assert!(!reassembly.is_ready());
    (0..6).for_each(|tick| cache.push(full_record(tick)));
    let (bytes, _) = Frame::encode(&frame_header(&cache, 4), cache.iter_from(4));
    reassembly.offer(Frame::decode(&bytes).unwrap()).unwrap();
    assert!(reassembly.is_ready() && reassembly.next_delivery() == Some(Delivery::Lost(0..2)));
    assert!(!reassembly.is_ready() && reassembly.next_delivery().is_none(), "2 and 3 can still come");
    let (bytes, _) = Frame::encode(&frame_header(&cache, 2), cache.iter_from(2));
    reassembly.offer(Frame::decode(&bytes).unwrap()).unwrap();
    assert!(
        reassembly.is_ready()
            && matches!(reassembly.next_delivery(), Some(Delivery::Record(record)) if record.tick == 2)
    );
}

#[test]
fn merge_joins_topics_in_any_order() {
    let mut merge = Merge::new(all_topics(), LATENESS);
    let mut records = Vec::new();
    (0..10).for_each(|tick| offer(&mut merge, gyro(tick)));
    assert_eq!(drain(&mut merge), [], "accel may still come");
    (0..10).for_each(|tick| offer(&mut merge, accel(tick)));
    assert_eq!(drain(&mut merge), [], "tick 0 is flagged to have a field");
    for tick in [0, 3, 6, 9] {
        offer(&mut merge, mag(tick));
        records.extend(drain(&mut merge));
    }
    assert_eq!(records, (0..10).map(full_record).collect::<Vec<_>>());
}

#[test]
fn merge_omits_skipped_or_late_topic_but_no_tick() {
    let mut merge = Merge::new(mask(&["accel", "gyro"]), LATENESS);
    (0..10).for_each(|tick| offer(&mut merge, gyro(tick)));
    [0, 1, 5, 6].iter().for_each(|tick| offer(&mut merge, accel(*tick)));
    let records = drain(&mut merge);
    assert_eq!(records.iter().map(|record| record.tick).collect::<Vec<_>>(), (0..7).collect::<Vec<_>>());
    let gyro_only = mask(&["gyro"]);
    assert!([2, 3, 4].iter().all(|tick| records[*tick].mask == gyro_only));
    (10..7 + LATENESS).for_each(|tick| offer(&mut merge, gyro(tick)));
    assert_eq!(drain(&mut merge), []);
    offer(&mut merge, gyro(7 + LATENESS));
    assert_eq!(drain(&mut merge).iter().map(|record| (record.tick, record.mask)).collect::<Vec<_>>(), [(7, gyro_only)]);
}

#[test]
fn restarted_merge_starts_at_first_tick_held_by_all_topics() {
    let mut merge = Merge::with_unknown_start(all_topics(), LATENESS, 200);
    (100..200).for_each(|tick| offer(&mut merge, gyro(tick)));
    assert_eq!(drain(&mut merge), [], "the other topics have a backlog that is delivered later");
    offer(&mut merge, accel(103));
    assert_eq!(
        drain(&mut merge),
        [full_record(103)],
        "published messages are awaited, however far ahead another topic is"
    );
    (104..200).for_each(|tick| offer(&mut merge, accel(tick)));
    (60..200).filter(|tick: &u64| tick.is_multiple_of(3)).for_each(|tick| offer(&mut merge, mag(tick)));
    assert_eq!(drain(&mut merge), (104..200).map(full_record).collect::<Vec<_>>());
}

#[test]
fn cache_keeps_newest_records() {
    let cache = cache(0..100, 30);
    assert_eq!((cache.oldest_tick(), cache.next_tick()), (Some(70), Some(100)));
    for (from, first) in [(0, Some(70)), (90, Some(90)), (100, None), (u64::MAX, None)] {
        assert_eq!(cache.iter_from(from).next().map(|record| record.tick), first);
    }
}

#[test]
fn frame_round_trips() {
    let cache = cache(0..100, 100);
    let frame = Frame::decode(&frame(&cache, 10..20)).unwrap();
    assert_eq!(frame.records, (10..20).map(full_record).collect::<Vec<_>>());
    let (_, message) = frame.records[2].messages().find(|(topic, _)| CARRIED_TOPICS[*topic].name == "mag").unwrap();
    assert_eq!(bytemuck::pod_read_unaligned::<MagSample>(message), mag(12));
}

#[test]
fn foreign_layout_is_rejected_with_fingerprints() {
    let cache = cache(0..3, 10);
    let mut header = frame_header(&cache, 0);
    header.topics[1].1 ^= 1;
    let error = Frame::decode(&Frame::encode(&header, cache.iter_from(0)).0).unwrap_err();
    let (local, remote) = (GyroStep::layout().fingerprint(), GyroStep::layout().fingerprint() ^ 1);
    assert_eq!(error, FrameError::Layout { topic: "gyro".into(), local, remote });
    let text = error.to_string();
    assert!(text.contains(&format!("{local:016x}")) && text.contains(&format!("{remote:016x}")), "{text}");
}

#[test]
fn inconsistent_header_is_rejected() {
    let cache = cache(0..30, 20);
    let valid = frame_header(&cache, 10);
    for invalid in [
        FrameHeader { oldest_tick: u64::MAX, ..valid.clone() },
        FrameHeader { next_tick: u64::MAX, ..valid.clone() },
        FrameHeader { next_tick: 20, ..valid.clone() },
        FrameHeader { first_tick: 9, ..valid.clone() },
    ] {
        let bytes = Frame::encode(&invalid, cache.iter_from(10)).0;
        assert!(matches!(Frame::decode(&bytes), Err(FrameError::Malformed { .. })), "{invalid:?}");
    }
    assert!(Frame::decode(&Frame::encode(&valid, cache.iter_from(10)).0).is_ok());
}

#[test]
fn loss_log_summarises_losses_in_one_line() {
    let mut losses = LossLog::default();
    assert_eq!(losses.take_summary(0), None);
    [3..5, 5..9, 20..21].into_iter().for_each(|span| losses.add(span));
    let summary = losses.take_summary(7).unwrap();
    assert!(summary.contains("3 to 8 (6), 20 to 20 (1)") && summary.ends_with("7 in total"), "{summary}");
    (0..10).for_each(|span| losses.add(10 * span..10 * span + 2));
    assert!(losses.take_summary(27).unwrap().ends_with("70 to 71 (2), 4 more; 27 in total"));
    assert_eq!(losses.take_summary(27), None);
}

#[test]
fn reassembly_rejects_other_run_rate_or_topics() {
    let cache = cache(0..3, 10);
    let frame = |header: FrameHeader| Frame { header, records: Vec::new() };
    let mut reassembly = reassembly(0);
    let rate = FrameHeader { rate_hz: 100.0, ..frame_header(&cache, 0) };
    assert_eq!(reassembly.offer(frame(rate)), Err(ReassemblyError::Rate { local: RATE_HZ, remote: 100.0 }));
    let mut less = frame_header(&cache, 0);
    less.topics.remove(2);
    assert_eq!(reassembly.offer(frame(less)), Err(ReassemblyError::Topic { topic: "accel" }));
    reassembly.offer(frame(frame_header(&cache, 0))).unwrap();
    assert_eq!(reassembly.offer(frame(FrameHeader { run: 8, ..frame_header(&cache, 0) })), Err(ReassemblyError::Run));
}

#[test]
fn uncached_ticks_are_lost_and_stream_resumes() {
    let mut reassembly = reassembly(0);
    reassembly.offer(Frame::decode(&frame(&cache(0..10, 50), 0..10)).unwrap()).unwrap();
    assert_eq!(std::iter::from_fn(|| reassembly.next_delivery()).count(), 10);
    let later = cache(0..100, 50);
    // The newest ticks arrive first, as after a link outage.
    reassembly.offer(Frame::decode(&frame(&later, 95..100)).unwrap()).unwrap();
    assert_eq!(reassembly.next_delivery(), Some(Delivery::Lost(10..50)));
    assert_eq!((reassembly.next_delivery(), reassembly.missing()), (None, Some(50..95)));
    reassembly.offer(Frame::decode(&frame(&later, 50..95)).unwrap()).unwrap();
    let rest: Vec<_> = std::iter::from_fn(|| reassembly.next_delivery()).collect();
    assert_eq!(rest, (50..100).map(|tick| Delivery::Record(full_record(tick))).collect::<Vec<_>>());
}

#[test]
fn received_ticks_are_delivered_between_losses() {
    let mut reassembly = reassembly(10);
    reassembly.offer(Frame::decode(&frame(&cache(0..30, 50), 20..30)).unwrap()).unwrap();
    assert_eq!(reassembly.next_delivery(), None, "ticks 10 to 19 are still cached");
    reassembly.offer(Frame::decode(&frame(&cache(0..100, 50), 50..60)).unwrap()).unwrap();
    let deliveries: Vec<_> = std::iter::from_fn(|| reassembly.next_delivery()).collect();
    let received = |ticks: Range<u64>| ticks.map(|tick| Delivery::Record(full_record(tick)));
    let expected = [Delivery::Lost(10..20)]
        .into_iter()
        .chain(received(20..30))
        .chain([Delivery::Lost(30..50)])
        .chain(received(50..60));
    assert_eq!(deliveries, expected.collect::<Vec<_>>());
}

#[test]
fn reassembly_stops_at_end_tick() {
    let mut reassembly = Reassembly::new(all_topics(), RATE_HZ, None, 0, 5);
    reassembly.offer(Frame::decode(&frame(&cache(0..10, 50), 0..10)).unwrap()).unwrap();
    assert_eq!(std::iter::from_fn(|| reassembly.next_delivery()).count(), 5);
    assert!(reassembly.is_complete() && reassembly.missing().is_none());
}

proptest! {
    #[test]
    fn every_tick_is_delivered_once_or_reported_lost(
        steps in prop::collection::vec((0u64..25, 0usize..5, 0u64..40), 1..80),
        capacity in 20usize..400,
    ) {
        let mut cache = Cache::new(capacity);
        let (mut reassembly, mut delayed) = (reassembly(0), Vec::<Vec<u8>>::new());
        let (mut next, mut received, mut lost) = (0, Vec::new(), Vec::new());
        let drain_into = |reassembly: &mut Reassembly, received: &mut Vec<u64>, lost: &mut Vec<u64>| while let Some(delivery) = reassembly.next_delivery() {
            match delivery {
                Delivery::Record(record) => {
                    assert_eq!(record, full_record(record.tick));
                    received.push(record.tick);
                }
                Delivery::Lost(span) => lost.extend(span),
            }
        };
        for (ticks, action, rewind) in steps {
            let before = next;
            (0..ticks).for_each(|_| { cache.push(full_record(next)); next += 1; });
            if next == 0 { continue; }
            let live = frame(&cache, before..next);
            match action {
                // Action 0 delivers the frame, 1 loses it, and 2 delays it. Action 3 restarts the
                // importer at a tick up to `rewind` ticks back. Any other action delivers the
                // delayed frames and requests missing ticks.
                0 => reassembly.offer(Frame::decode(&live).unwrap()).unwrap(),
                1 => {}
                2 => delayed.push(live),
                3 => {
                    let from = reassembly.next_tick().saturating_sub(rewind);
                    received.retain(|tick| *tick < from);
                    lost.retain(|tick| *tick < from);
                    reassembly = Reassembly::new(all_topics(), RATE_HZ, reassembly.run(), from, u64::MAX);
                }
                _ => {
                    for late in delayed.drain(..).rev() {
                        reassembly.offer(Frame::decode(&late).unwrap()).unwrap();
                    }
                    if let Some(span) = reassembly.missing() {
                        reassembly.offer(Frame::decode(&frame(&cache, span)).unwrap()).unwrap();
                    }
                }
            }
            drain_into(&mut reassembly, &mut received, &mut lost);
        }
        if next > 0 {
            // The network is restored. Requests now deliver everything that is left.
            for _ in 0..200 {
                let span = reassembly.next_tick()..u64::MAX;
                reassembly.offer(Frame::decode(&frame(&cache, span)).unwrap()).unwrap();
                drain_into(&mut reassembly, &mut received, &mut lost);
            }
        }
        let mut all_ticks: Vec<_> = received.iter().chain(&lost).copied().collect();
        prop_assert!(received.is_sorted() && lost.is_sorted());
        all_ticks.sort_unstable();
        prop_assert_eq!(all_ticks, (0..next).collect::<Vec<_>>());
    }

    #[test]
    fn damaged_frame_does_not_panic(cut in 0usize..2000, position in 0usize..2000, bit in 0u8..8) {
        let whole = frame(&cache(0..5, 10), 0..5);
        let mut bytes = whole.clone();
        let position = position % bytes.len();
        bytes[position] ^= 1 << bit;
        // Any result is allowed except a panic.
        let _ = Frame::decode(&bytes);
        bytes.truncate(cut % bytes.len());
        let _ = Frame::decode(&bytes);
        let cut = cut % whole.len();
        if let Ok(frame) = Frame::decode(&whole[..cut]) {
            prop_assert!(frame.records.len() < 5, "a truncated frame has fewer ticks");
        }
    }
}
