//! A request for a swap is carried out once, and answered by its deadline.
use std::{
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    thread,
    time::Duration,
};

use control::{Outcome, SwapReport};
use gateway::idempotent_swaps::IdempotentSwaps;
use runtime::clock::monotonic_ns;
use wire::v1::{SwapAnswer, SwapRequest, swap_answer};

const SECOND_NS: u64 = 1_000_000_000;

/// Swaps whose supervisor takes so long and says that it has done it; and how often it was asked.
fn swaps(takes: Duration) -> (Arc<IdempotentSwaps>, Arc<AtomicU32>) {
    let asked = Arc::new(AtomicU32::new(0));
    let count = asked.clone();
    let asking = move |wish: control::SwapRequest| {
        count.fetch_add(1, Ordering::SeqCst);
        assert_eq!(wish.expected_epoch, Some(3));
        thread::sleep(takes);
        Ok(SwapReport {
            slot: wish.slot,
            from: "wz".into(),
            to: wish.stage.stage,
            commit_tick: Some(100),
            lost: 0,
            duplicated: 0,
            gap_us: 1000.0,
            jump_deg: 0.0,
            outcome: Outcome::Committed,
            reason: None,
        })
    };
    (Arc::new(IdempotentSwaps::new(Box::new(asking))), asked)
}

fn request(id: &str, within_ns: u64) -> SwapRequest {
    SwapRequest {
        request_id: id.into(),
        slot: "fuser".into(),
        stage: "vqf".into(),
        expected_epoch: 3,
        t_deadline_ns: monotonic_ns() + within_ns,
        ..SwapRequest::default()
    }
}

fn assert_refused(answer: &SwapAnswer, reason: &str) {
    assert_eq!(answer.outcome(), swap_answer::Outcome::Refused, "{answer:?}");
    assert!(answer.reason.contains(reason), "{answer:?}");
}

#[test]
fn a_request_that_comes_again_is_answered_as_the_first_was() {
    let (swaps, asked) = swaps(Duration::from_millis(50));
    let answers: Vec<_> = (0..5)
        .map(|_| {
            let (swaps, request) = (swaps.clone(), request("a", 10 * SECOND_NS));
            thread::spawn(move || swaps.answer(request))
        })
        .map(|thread| thread.join().unwrap())
        .collect();
    assert!(answers.iter().all(|answer| *answer == answers[0] && answer.commit_tick == Some(100)), "{answers:?}");
    // Its deadline is over, but what came of it is known.
    let late = SwapRequest { t_deadline_ns: 1, ..request("a", 0) };
    assert_eq!(swaps.answer(late), answers[0]);
    assert_eq!(asked.load(Ordering::SeqCst), 1);
    assert_eq!(swaps.counts(), [1, 5]);
}

#[test]
fn a_request_that_comes_late_has_no_effect() {
    let (swaps, asked) = swaps(Duration::ZERO);
    assert_refused(&swaps.answer(SwapRequest { t_deadline_ns: 1, ..request("a", 0) }), "after its deadline");
    assert_refused(&swaps.answer(request("a", 61 * SECOND_NS)), "more than a minute ahead");
    assert_eq!(asked.load(Ordering::SeqCst), 0);
}

#[test]
fn an_id_belongs_to_one_request() {
    let (swaps, asked) = swaps(Duration::ZERO);
    swaps.answer(request("a", SECOND_NS));
    let other = SwapRequest { stage: "wz".into(), ..request("a", SECOND_NS) };
    assert_refused(&swaps.answer(other), "was that of another request");
    assert_eq!(asked.load(Ordering::SeqCst), 1);
}

#[test]
fn when_the_deadline_passes_first_that_is_the_answer_and_one_may_ask_on() {
    let (swaps, asked) = swaps(Duration::from_millis(300));
    let answer = swaps.answer(request("a", SECOND_NS / 50));
    assert_eq!(answer.outcome(), swap_answer::Outcome::Unknown, "{answer:?}");
    assert_eq!(swaps.answer(request("a", 10 * SECOND_NS)).outcome(), swap_answer::Outcome::Committed);
    assert_eq!(asked.load(Ordering::SeqCst), 1);
}

#[test]
fn there_is_a_limit_to_what_is_under_way_and_to_what_is_remembered() {
    let (slow, _) = swaps(Duration::from_millis(500));
    for id in ["a", "b", "c", "d"] {
        slow.answer(request(id, 1_000_000));
    }
    assert_refused(&slow.answer(request("e", SECOND_NS)), "too many requests are under way");
    let (quick, asked) = swaps(Duration::ZERO);
    for i in 0..600 {
        assert_eq!(quick.answer(request(&format!("{i}"), 10 * SECOND_NS)).outcome(), swap_answer::Outcome::Committed);
    }
    // The oldest are forgotten, the newest are not.
    quick.answer(request("599", SECOND_NS));
    assert_eq!(asked.load(Ordering::SeqCst), 600);
}
