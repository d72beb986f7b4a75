//! What is carried arrives whole and in order, whatever the network does with it; what cannot arrive is named exactly.
use std::ops::Range;

use bytemuck::Zeroable;
use gateway::split::{
    arrivals::{ArrivalError, Arrivals, Turn},
    cache::Cache,
    frame::{Frame, FrameError, Head},
    losses::Losses,
    merge::Merge,
    record::{CARRIED_TOPICS, Record, place, places},
};
use messages::{AccelPoint, Flags, GyroStep, Header, MagSample, Message};
use proptest::prelude::*;

const RATE_HZ: f64 = 1000.0;
const LATENESS: u64 = 20;

fn mask(topics: &[&str]) -> u8 {
    topics.iter().fold(0, |mask, topic| mask | 1 << place(topic).unwrap())
}

fn header(tick: u64) -> Header {
    // Each third tick has a field.
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
    merge.offer(place(M::TOPIC.name).unwrap(), header.tick, header.flags, bytemuck::bytes_of(&message));
}

/// What the merge makes of one tick with all its messages.
fn whole(tick: u64) -> Record {
    let mut record = Record::empty(tick);
    if tick.is_multiple_of(3) {
        record.push(place("mag").unwrap(), bytemuck::bytes_of(&mag(tick)));
    }
    record.push(place("gyro").unwrap(), bytemuck::bytes_of(&gyro(tick)));
    record.push(place("accel").unwrap(), bytemuck::bytes_of(&accel(tick)));
    record
}

fn all() -> u8 {
    mask(&["mag", "accel", "gyro"])
}

fn head(cache: &Cache, first_tick: u64) -> Head {
    let topics = places(all()).map(|(_, topic)| (topic.name.to_owned(), topic.fingerprint)).collect();
    Head {
        run: 7,
        rate_hz: RATE_HZ,
        topics,
        oldest_tick: cache.oldest_tick().unwrap(),
        next_tick: cache.next_tick().unwrap(),
        first_tick,
    }
}

/// The bytes of the kept ticks of a span.
fn frame(cache: &Cache, span: Range<u64>) -> Vec<u8> {
    let first_tick = span.start.clamp(cache.oldest_tick().unwrap(), cache.next_tick().unwrap());
    Frame::encode(&head(cache, first_tick), cache.from(first_tick).take_while(|record| record.tick < span.end)).0
}

fn cache(ticks: Range<u64>, max: usize) -> Cache {
    let mut cache = Cache::new(max);
    ticks.for_each(|tick| cache.push(whole(tick)));
    cache
}

fn arrivals(next_tick: u64) -> Arrivals {
    Arrivals::new(all(), RATE_HZ, None, next_tick, u64::MAX)
}

fn take_all(merge: &mut Merge) -> Vec<Record> {
    std::iter::from_fn(|| merge.take()).collect()
}

#[test]
fn the_stream_waits_for_the_topic_that_is_behind() {
    let mut merge = Merge::starting(all(), LATENESS);
    offer(&mut merge, gyro(0));
    assert_eq!(merge.lacks(), place("accel"));
    offer(&mut merge, accel(0));
    offer(&mut merge, accel(1));
    assert_eq!(merge.lacks(), place("mag"), "tick 0 has a field");
    offer(&mut merge, mag(0));
    assert!(merge.take().is_some());
    assert_eq!(merge.lacks(), place("gyro"));
}

#[test]
fn something_is_ready_when_and_only_when_it_can_be_taken() {
    let mut cache = Cache::new(4);
    let mut arrivals = Arrivals::new(all(), RATE_HZ, None, 0, u64::MAX);
    assert!(!arrivals.is_ready());
    (0..6).for_each(|tick| cache.push(whole(tick)));
    let (bytes, _) = Frame::encode(&head(&cache, 4), cache.from(4));
    arrivals.offer(Frame::decode(&bytes).unwrap()).unwrap();
    assert!(arrivals.is_ready() && arrivals.take() == Some(Turn::Lost(0..2)));
    assert!(!arrivals.is_ready() && arrivals.take().is_none(), "2 and 3 can still come");
    let (bytes, _) = Frame::encode(&head(&cache, 2), cache.from(2));
    arrivals.offer(Frame::decode(&bytes).unwrap()).unwrap();
    assert!(arrivals.is_ready() && matches!(arrivals.take(), Some(Turn::Record(record)) if record.tick == 2));
}

#[test]
fn topics_in_any_order_become_whole_ticks() {
    let mut merge = Merge::starting(all(), LATENESS);
    let mut records = Vec::new();
    (0..10).for_each(|tick| offer(&mut merge, gyro(tick)));
    assert_eq!(take_all(&mut merge), [], "accel may still come");
    (0..10).for_each(|tick| offer(&mut merge, accel(tick)));
    assert_eq!(take_all(&mut merge), [], "the flag of tick 0 says that it has a field");
    for tick in [0, 3, 6, 9] {
        offer(&mut merge, mag(tick));
        records.extend(take_all(&mut merge));
    }
    assert_eq!(records, (0..10).map(whole).collect::<Vec<_>>());
}

#[test]
fn a_topic_that_passed_a_tick_or_is_late_is_left_out_and_no_tick_is_missing() {
    let mut merge = Merge::starting(mask(&["accel", "gyro"]), LATENESS);
    (0..10).for_each(|tick| offer(&mut merge, gyro(tick)));
    [0, 1, 5, 6].iter().for_each(|tick| offer(&mut merge, accel(*tick)));
    let records = take_all(&mut merge);
    assert_eq!(records.iter().map(|record| record.tick).collect::<Vec<_>>(), (0..7).collect::<Vec<_>>());
    let gyro_only = mask(&["gyro"]);
    assert!([2, 3, 4].iter().all(|tick| records[*tick].mask == gyro_only));
    (10..7 + LATENESS).for_each(|tick| offer(&mut merge, gyro(tick)));
    assert_eq!(take_all(&mut merge), []);
    offer(&mut merge, gyro(7 + LATENESS));
    assert_eq!(
        take_all(&mut merge).iter().map(|record| (record.tick, record.mask)).collect::<Vec<_>>(),
        [(7, gyro_only)]
    );
}

#[test]
fn a_later_life_begins_with_the_first_tick_that_all_topics_still_hold() {
    let mut merge = Merge::joining(all(), LATENESS, 200);
    (100..200).for_each(|tick| offer(&mut merge, gyro(tick)));
    assert_eq!(take_all(&mut merge), [], "the others hold something too, which comes when they next act");
    offer(&mut merge, accel(103));
    assert_eq!(
        take_all(&mut merge),
        [whole(103)],
        "what was published once is not given up, however far another topic is"
    );
    (104..200).for_each(|tick| offer(&mut merge, accel(tick)));
    (60..200).filter(|tick: &u64| tick.is_multiple_of(3)).for_each(|tick| offer(&mut merge, mag(tick)));
    assert_eq!(take_all(&mut merge), (104..200).map(whole).collect::<Vec<_>>());
}

#[test]
fn the_cache_keeps_the_newest() {
    let cache = cache(0..100, 30);
    assert_eq!((cache.oldest_tick(), cache.next_tick()), (Some(70), Some(100)));
    for (from, first) in [(0, Some(70)), (90, Some(90)), (100, None), (u64::MAX, None)] {
        assert_eq!(cache.from(from).next().map(|record| record.tick), first);
    }
}

#[test]
fn a_frame_comes_back_as_it_was() {
    let cache = cache(0..100, 100);
    let frame = Frame::decode(&frame(&cache, 10..20)).unwrap();
    assert_eq!(frame.records, (10..20).map(whole).collect::<Vec<_>>());
    let (_, message) = frame.records[2].messages().find(|(topic, _)| CARRIED_TOPICS[*topic].name == "mag").unwrap();
    assert_eq!(bytemuck::pod_read_unaligned::<MagSample>(message), mag(12));
}

#[test]
fn a_foreign_layout_is_refused_with_both_fingerprints() {
    let cache = cache(0..3, 10);
    let mut head = head(&cache, 0);
    head.topics[1].1 ^= 1;
    let error = Frame::decode(&Frame::encode(&head, cache.from(0)).0).unwrap_err();
    let (here, there) = (GyroStep::layout().fingerprint(), GyroStep::layout().fingerprint() ^ 1);
    assert_eq!(error, FrameError::Layout { topic: "gyro".into(), here, there });
    let text = error.to_string();
    assert!(text.contains(&format!("{here:016x}")) && text.contains(&format!("{there:016x}")), "{text}");
}

#[test]
fn a_head_that_cannot_be_is_refused() {
    let cache = cache(0..30, 20);
    let right = head(&cache, 10);
    for wrong in [
        Head { oldest_tick: u64::MAX, ..right.clone() },
        Head { next_tick: u64::MAX, ..right.clone() },
        Head { next_tick: 20, ..right.clone() },
        Head { first_tick: 9, ..right.clone() },
    ] {
        let bytes = Frame::encode(&wrong, cache.from(10)).0;
        assert!(matches!(Frame::decode(&bytes), Err(FrameError::Malformed { .. })), "{wrong:?}");
    }
    assert!(Frame::decode(&Frame::encode(&right, cache.from(10)).0).is_ok());
}

#[test]
fn many_losses_are_said_in_one_line() {
    let mut losses = Losses::default();
    assert_eq!(losses.take_line(0), None);
    [3..5, 5..9, 20..21].into_iter().for_each(|span| losses.add(span));
    let line = "lost, no longer kept by the other host: ticks 3 to 8 (6), 20 to 20 (1); 7 in all";
    assert_eq!(losses.take_line(7).as_deref(), Some(line));
    (0..10).for_each(|span| losses.add(10 * span..10 * span + 2));
    assert!(losses.take_line(27).unwrap().ends_with("70 to 71 (2), 4 others; 27 in all"));
    assert_eq!(losses.take_line(27), None);
}

#[test]
fn another_run_another_rate_and_a_topic_that_is_not_there_are_refused() {
    let cache = cache(0..3, 10);
    let frame = |head: Head| Frame { head, records: Vec::new() };
    let mut arrivals = arrivals(0);
    let rate = Head { rate_hz: 100.0, ..head(&cache, 0) };
    assert_eq!(arrivals.offer(frame(rate)), Err(ArrivalError::Rate { here: RATE_HZ, there: 100.0 }));
    let mut less = head(&cache, 0);
    less.topics.remove(2);
    assert_eq!(arrivals.offer(frame(less)), Err(ArrivalError::Topic { topic: "accel" }));
    arrivals.offer(frame(head(&cache, 0))).unwrap();
    assert_eq!(arrivals.offer(frame(Head { run: 8, ..head(&cache, 0) })), Err(ArrivalError::Run));
}

#[test]
fn ticks_no_longer_kept_are_named_exactly_and_the_stream_goes_on_behind_them() {
    let mut arrivals = arrivals(0);
    arrivals.offer(Frame::decode(&frame(&cache(0..10, 50), 0..10)).unwrap()).unwrap();
    assert_eq!(std::iter::from_fn(|| arrivals.take()).count(), 10);
    let later = cache(0..100, 50);
    // The newest ticks come first, as they do after a cut.
    arrivals.offer(Frame::decode(&frame(&later, 95..100)).unwrap()).unwrap();
    assert_eq!(arrivals.take(), Some(Turn::Lost(10..50)));
    assert_eq!((arrivals.take(), arrivals.missing()), (None, Some(50..95)));
    arrivals.offer(Frame::decode(&frame(&later, 50..95)).unwrap()).unwrap();
    let rest: Vec<_> = std::iter::from_fn(|| arrivals.take()).collect();
    assert_eq!(rest, (50..100).map(|tick| Turn::Record(whole(tick))).collect::<Vec<_>>());
}

#[test]
fn ticks_that_came_before_they_were_given_up_are_not_lost() {
    let mut arrivals = arrivals(10);
    arrivals.offer(Frame::decode(&frame(&cache(0..30, 50), 20..30)).unwrap()).unwrap();
    assert_eq!(arrivals.take(), None, "10 to 19 are still kept");
    arrivals.offer(Frame::decode(&frame(&cache(0..100, 50), 50..60)).unwrap()).unwrap();
    let turns: Vec<_> = std::iter::from_fn(|| arrivals.take()).collect();
    let came = |ticks: Range<u64>| ticks.map(|tick| Turn::Record(whole(tick)));
    let expected = [Turn::Lost(10..20)].into_iter().chain(came(20..30)).chain([Turn::Lost(30..50)]).chain(came(50..60));
    assert_eq!(turns, expected.collect::<Vec<_>>());
}

#[test]
fn nothing_is_taken_beyond_the_end() {
    let mut arrivals = Arrivals::new(all(), RATE_HZ, None, 0, 5);
    arrivals.offer(Frame::decode(&frame(&cache(0..10, 50), 0..10)).unwrap()).unwrap();
    assert_eq!(std::iter::from_fn(|| arrivals.take()).count(), 5);
    assert!(arrivals.is_whole() && arrivals.missing().is_none());
}

proptest! {
    #[test]
    fn whatever_is_lost_repeated_reordered_or_restarted_every_tick_comes_once_or_is_named(
        steps in prop::collection::vec((0u64..25, 0usize..5, 0u64..40), 1..80),
        kept in 20usize..400,
    ) {
        let mut cache = Cache::new(kept);
        let (mut arrivals, mut held) = (arrivals(0), Vec::<Vec<u8>>::new());
        let (mut next, mut came, mut lost) = (0, Vec::new(), Vec::new());
        let run = |arrivals: &mut Arrivals, came: &mut Vec<u64>, lost: &mut Vec<u64>| while let Some(turn) = arrivals.take() {
            match turn {
                Turn::Record(record) => {
                    assert_eq!(record, whole(record.tick));
                    came.push(record.tick);
                }
                Turn::Lost(span) => lost.extend(span),
            }
        };
        for (ticks, what, back) in steps {
            let before = next;
            (0..ticks).for_each(|_| { cache.push(whole(next)); next += 1; });
            if next == 0 { continue; }
            let live = frame(&cache, before..next);
            match what {
                // Delivered; lost; late; the importer begins again a little before; what is missing is asked for.
                0 => arrivals.offer(Frame::decode(&live).unwrap()).unwrap(),
                1 => {}
                2 => held.push(live),
                3 => {
                    let from = arrivals.next_tick().saturating_sub(back);
                    came.retain(|tick| *tick < from);
                    lost.retain(|tick| *tick < from);
                    arrivals = Arrivals::new(all(), RATE_HZ, arrivals.run(), from, u64::MAX);
                }
                _ => {
                    for late in held.drain(..).rev() {
                        arrivals.offer(Frame::decode(&late).unwrap()).unwrap();
                    }
                    if let Some(span) = arrivals.missing() {
                        arrivals.offer(Frame::decode(&frame(&cache, span)).unwrap()).unwrap();
                    }
                }
            }
            run(&mut arrivals, &mut came, &mut lost);
        }
        if next > 0 {
            // The network is whole again: a few questions and nothing is open.
            for _ in 0..200 {
                let span = arrivals.next_tick()..u64::MAX;
                arrivals.offer(Frame::decode(&frame(&cache, span)).unwrap()).unwrap();
                run(&mut arrivals, &mut came, &mut lost);
            }
        }
        let mut all_ticks: Vec<_> = came.iter().chain(&lost).copied().collect();
        prop_assert!(came.is_sorted() && lost.is_sorted());
        all_ticks.sort_unstable();
        prop_assert_eq!(all_ticks, (0..next).collect::<Vec<_>>());
    }

    #[test]
    fn bytes_that_are_no_frame_are_refused(cut in 0usize..2000, place in 0usize..2000, bit in 0u8..8) {
        let whole = frame(&cache(0..5, 10), 0..5);
        let mut bytes = whole.clone();
        let place = place % bytes.len();
        bytes[place] ^= 1 << bit;
        // Whatever comes of it, it is no panic.
        let _ = Frame::decode(&bytes);
        bytes.truncate(cut % bytes.len());
        let _ = Frame::decode(&bytes);
        let cut = cut % whole.len();
        if let Ok(frame) = Frame::decode(&whole[..cut]) {
            prop_assert!(frame.records.len() < 5, "a whole number of ticks");
        }
    }
}
