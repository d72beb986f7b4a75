//! Swap requests are executed once and answered by their deadlines.
use std::{
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    thread,
    time::Duration,
};

use control::{SwapOutcome, SwapReport};
use gateway::idempotent_swaps::IdempotentSwaps;
use runtime::clock::monotonic_ns;
use wire::v1::{SwapAnswer, SwapRequest, swap_answer};

const SECOND_NS: u64 = 1_000_000_000;

/// Returns an instance with a supervisor that commits after `delay`, and a counter of its calls.
fn swaps(delay: Duration) -> (Arc<IdempotentSwaps>, Arc<AtomicU32>) {
    let calls = Arc::new(AtomicU32::new(0));
    let counter = calls.clone();
    let client = move |request: control::SwapRequest| {
        counter.fetch_add(1, Ordering::SeqCst);
        assert_eq!(request.expected_epoch, Some(3));
        thread::sleep(delay);
        Ok(SwapReport {
            slot: request.slot.into(),
            from: "wz".into(),
            to: request.stage.stage.into(),
            commit_tick: Some(100),
            lost: 0,
            duplicated: 0,
            gap_us: 1000.0,
            jump_deg: 0.0,
            outcome: SwapOutcome::Committed,
            reason: None,
        })
    };
    (Arc::new(IdempotentSwaps::new(Box::new(client))), calls)
}

fn request(id: &str, timeout_ns: u64) -> SwapRequest {
    SwapRequest {
        request_id: id.into(),
        slot: "fuser".into(),
        stage: "vqf".into(),
        expected_epoch: 3,
        t_deadline_ns: monotonic_ns() + timeout_ns,
        ..SwapRequest::default()
    }
}

fn assert_rejected(answer: &SwapAnswer, reason: &str) {
    assert_eq!(answer.outcome(), swap_answer::Outcome::Refused, "{answer:?}");
    assert!(answer.reason.contains(reason), "{answer:?}");
}

#[test]
fn repeated_request_gets_same_reply() {
    let (swaps, calls) = swaps(Duration::from_millis(50));
    let answers: Vec<_> = (0..5)
        .map(|_| {
            let (swaps, request) = (swaps.clone(), request("a", 10 * SECOND_NS));
            thread::spawn(move || swaps.handle(request))
        })
        .map(|thread| thread.join().unwrap())
        .collect();
    assert!(answers.iter().all(|answer| *answer == answers[0] && answer.commit_tick == Some(100)), "{answers:?}");
    // The deadline has passed, but the result is remembered.
    let late = SwapRequest { t_deadline_ns: 1, ..request("a", 0) };
    assert_eq!(swaps.handle(late), answers[0]);
    assert_eq!(calls.load(Ordering::SeqCst), 1);
    assert_eq!(swaps.counts(), [1, 5]);
}

#[test]
fn request_with_invalid_deadline_has_no_effect() {
    let (swaps, calls) = swaps(Duration::ZERO);
    assert_rejected(&swaps.handle(SwapRequest { t_deadline_ns: 1, ..request("a", 0) }), "after its deadline");
    assert_rejected(&swaps.handle(request("a", 61 * SECOND_NS)), "more than a minute ahead");
    assert_eq!(calls.load(Ordering::SeqCst), 0);
}

#[test]
fn reused_request_id_is_rejected() {
    let (swaps, calls) = swaps(Duration::ZERO);
    swaps.handle(request("a", SECOND_NS));
    let other = SwapRequest { stage: "wz".into(), ..request("a", SECOND_NS) };
    assert_rejected(&swaps.handle(other), "was used for another request");
    assert_eq!(calls.load(Ordering::SeqCst), 1);
}

#[test]
fn expired_request_is_unknown_and_can_be_repeated() {
    let (swaps, calls) = swaps(Duration::from_millis(300));
    let answer = swaps.handle(request("a", SECOND_NS / 50));
    assert_eq!(answer.outcome(), swap_answer::Outcome::Unknown, "{answer:?}");
    assert_eq!(swaps.handle(request("a", 10 * SECOND_NS)).outcome(), swap_answer::Outcome::Committed);
    assert_eq!(calls.load(Ordering::SeqCst), 1);
}

#[test]
fn requests_in_progress_and_remembered_are_limited() {
    let (slow, _) = swaps(Duration::from_millis(500));
    for id in ["a", "b", "c", "d"] {
        slow.handle(request(id, 1_000_000));
    }
    assert_rejected(&slow.handle(request("e", SECOND_NS)), "requests are in progress already");
    let (quick, calls) = swaps(Duration::ZERO);
    for i in 0..600 {
        assert_eq!(quick.handle(request(&format!("{i}"), 10 * SECOND_NS)).outcome(), swap_answer::Outcome::Committed);
    }
    // The oldest requests are forgotten, the newest are remembered.
    quick.handle(request("599", SECOND_NS));
    assert_eq!(calls.load(Ordering::SeqCst), 600);
}
