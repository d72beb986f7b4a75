//! Conversion between swap reports and `SwapAnswer`, their form in messages to other hosts.

use swap::SwapOutcome;
use wire::v1::{SwapAnswer, swap_answer::Outcome};

use crate::SwapReport;

/// Converts a report to the answer to the request with this ID.
pub fn to_answer(request_id: String, report: SwapReport) -> SwapAnswer {
    let SwapReport { slot, from, to, commit_tick, lost, duplicated, gap_us, jump_deg, outcome, reason } = report;
    let outcome = match outcome {
        SwapOutcome::Committed => Outcome::Committed,
        SwapOutcome::Refused => Outcome::Refused,
        SwapOutcome::Aborted => Outcome::Aborted,
    };
    SwapAnswer {
        request_id,
        outcome: outcome.into(),
        reason: reason.unwrap_or_default(),
        slot,
        from,
        to,
        commit_tick,
        lost,
        duplicated,
        gap_s: gap_us * 1e-6,
        jump_rad: jump_deg.to_radians(),
    }
}

/// Converts an answer to a report.
pub fn from_answer(answer: SwapAnswer) -> SwapReport {
    let outcome = match answer.outcome() {
        Outcome::Committed => SwapOutcome::Committed,
        Outcome::Aborted => SwapOutcome::Aborted,
        // An outcome that is unknown at the deadline also counts as refused. The reason explains
        // it.
        Outcome::Refused | Outcome::Unknown | Outcome::Unspecified => SwapOutcome::Refused,
    };
    let SwapAnswer { reason, slot, from, to, commit_tick, lost, duplicated, gap_s, jump_rad, .. } = answer;
    SwapReport {
        slot,
        from,
        to,
        commit_tick,
        lost,
        duplicated,
        gap_us: gap_s * 1e6,
        jump_deg: jump_rad.to_degrees(),
        outcome,
        reason: Some(reason).filter(|reason| !reason.is_empty()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn report_survives_the_conversion() {
        for (outcome, reason) in [
            (SwapOutcome::Committed, None),
            (SwapOutcome::Refused, Some("no such slot".to_owned())),
            (SwapOutcome::Aborted, Some("too late".to_owned())),
        ] {
            let report = SwapReport {
                slot: "fuser".into(),
                from: "wz".into(),
                to: "vqf".into(),
                commit_tick: reason.is_none().then_some(1200),
                lost: 3,
                duplicated: 4,
                gap_us: 1500.0,
                jump_deg: 45.0,
                outcome,
                reason,
            };
            let answer = to_answer("7".into(), report.clone());
            assert_eq!((answer.request_id.as_str(), answer.gap_s), ("7", 0.0015));
            assert_eq!(from_answer(answer), report);
        }
    }
}
