//! Conversion of replies to and from network messages.

use foreign::ForeignText;
use swap::SwapOutcome;
use wire::v1::{self, SwapAnswer, swap_answer::Outcome};

use crate::{Diagnostic, ServiceStatus, SwapReport};

impl SwapReport {
    /// Converts the report into the answer to the request `request_id`.
    pub fn into_answer(self, request_id: String) -> SwapAnswer {
        let Self { slot, from, to, commit_tick, lost, duplicated, gap_us, jump_deg, outcome, reason } = self;
        let outcome = match outcome {
            SwapOutcome::Committed => Outcome::Committed,
            SwapOutcome::Refused => Outcome::Refused,
            SwapOutcome::Aborted => Outcome::Aborted,
        };
        SwapAnswer {
            request_id,
            outcome: outcome.into(),
            reason: reason.map(|reason| without_controls(reason.raw())).unwrap_or_default(),
            slot: slot.raw().into(),
            from: from.raw().into(),
            to: to.raw().into(),
            commit_tick,
            lost,
            duplicated,
            gap_s: gap_us * 1e-6,
            jump_rad: jump_deg.to_radians(),
        }
    }
}

impl From<SwapAnswer> for SwapReport {
    fn from(answer: SwapAnswer) -> Self {
        let outcome = match answer.outcome() {
            Outcome::Committed => SwapOutcome::Committed,
            Outcome::Aborted => SwapOutcome::Aborted,
            // An outcome that is unknown at the deadline also counts as refused. The text of
            // `reason` explains this.
            Outcome::Refused | Outcome::Unknown | Outcome::Unspecified => SwapOutcome::Refused,
        };
        let SwapAnswer { reason, slot, from, to, commit_tick, lost, duplicated, gap_s, jump_rad, .. } = answer;
        Self {
            slot: slot.into(),
            from: from.into(),
            to: to.into(),
            commit_tick,
            lost,
            duplicated,
            gap_us: gap_s * 1e6,
            jump_deg: jump_rad.to_degrees(),
            outcome,
            reason: non_empty(reason),
        }
    }
}

impl From<ServiceStatus> for v1::ServiceStatus {
    fn from(status: ServiceStatus) -> Self {
        let ServiceStatus { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, .. } = status;
        let to_proto = |Diagnostic { kind, found, remedy }| v1::Diagnostic {
            kind: kind.raw().into(),
            found: found.raw().into(),
            remedy: remedy.raw().into(),
        };
        let diagnostics = status.diagnostics.into_iter().map(to_proto).collect();
        let [stage, address] = [stage, status.address].map(|text| text.unwrap_or_default().raw().to_owned());
        let [service, state] = [service, state].map(|text| text.raw().to_owned());
        let pid = pid.unwrap_or_default();
        Self { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, address, diagnostics }
    }
}

impl From<v1::ServiceStatus> for ServiceStatus {
    fn from(status: v1::ServiceStatus) -> Self {
        let v1::ServiceStatus {
            service,
            stage,
            state,
            pid,
            restarts,
            incarnation,
            epoch,
            ticks,
            lost,
            address,
            diagnostics,
        } = status;
        let diagnostic = |v1::Diagnostic { kind, found, remedy }| Diagnostic {
            kind: kind.into(),
            found: found.into(),
            remedy: remedy.into(),
        };
        let diagnostics = diagnostics.into_iter().map(diagnostic).collect();
        let (stage, address) = (non_empty(stage), non_empty(address));
        let pid = Some(pid).filter(|pid| *pid != 0);
        let (service, state) = (service.into(), state.into());
        Self { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, address, diagnostics }
    }
}

fn non_empty(text: String) -> Option<ForeignText> {
    Some(text).filter(|text| !text.is_empty()).map(ForeignText::from)
}

/// Removes control characters, which receivers reject. Line feeds are kept.
fn without_controls(text: &str) -> String {
    text.chars().filter(|letter| !letter.is_control() || *letter == '\n').collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn report_survives_the_conversion() {
        for (outcome, reason) in [
            (SwapOutcome::Committed, None),
            (SwapOutcome::Refused, Some("no such slot")),
            (SwapOutcome::Aborted, Some("too late")),
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
                reason: reason.map(ForeignText::from),
            };
            let answer = report.clone().into_answer("7".into());
            assert_eq!((answer.request_id.as_str(), answer.gap_s), ("7", 0.0015));
            assert_eq!(SwapReport::from(answer), report);
        }
    }

    #[test]
    fn hostile_output_in_reason_is_sent_and_printed_without_escapes() {
        let [slot, from, to] = ["fuser", "wz", "vqf\x1b[2J\nforged"].map(String::from);
        let reason = "the new stage exited; its stderr:\n\x1b[2Jtext\nforged".into();
        let report = SwapReport::failed(slot, from, to, SwapOutcome::Refused, reason);
        let printed = "fuser unchanged (wz): the new stage exited; its stderr:\n  | \\u{1b}[2Jtext\n  | forged";
        assert_eq!(report.to_string(), printed);
        let answer = report.clone().into_answer("7".into());
        assert_eq!(answer.reason, "the new stage exited; its stderr:\n[2Jtext\nforged");
        let swapped = SwapReport { commit_tick: Some(1), outcome: SwapOutcome::Committed, ..answer.into() };
        assert!(swapped.to_string().starts_with(r"fuser: wz → vqf\u{1b}[2J\nforged from tick 1;"), "{swapped}");
    }

    #[test]
    fn service_status_survives_the_conversion() {
        let diagnostic = Diagnostic { kind: "axes".into(), found: "z points down".into(), remedy: "turn it".into() };
        let status = ServiceStatus {
            service: "fuser".into(),
            stage: Some("wz".into()),
            state: "running".into(),
            pid: Some(7),
            restarts: 1,
            incarnation: 2,
            epoch: 3,
            ticks: 4,
            lost: 5,
            address: Some("http://127.0.0.1:8088/".into()),
            diagnostics: vec![diagnostic],
        };
        let empty = ServiceStatus { stage: None, pid: None, address: None, ..status.clone() };
        for status in [status, empty] {
            assert_eq!(ServiceStatus::from(v1::ServiceStatus::from(status.clone())), status);
        }
    }
}
