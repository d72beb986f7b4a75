//! Choice of one sender among several that share a port or a stream.
//!
//! Input: senders whose data have yielded a measurement.
//!
//! Output: the sender whose data are used. Only measurements count: other data neither make a
//! sender the chosen one nor keep it chosen.
//!
//! Time: supplied by the caller, relative to any fixed instant. If the time does not advance, the
//! first choice is final.

use std::time::Duration;

/// Time without a measurement after which the choice of a sender lapses.
pub const SENDER_TIMEOUT: Duration = Duration::from_secs(2);

/// Choice of one sender among several.
#[derive(Debug, Clone, Copy)]
pub struct SenderChoice<S> {
    /// Last chosen sender, and the time of its last measurement.
    last: Option<(S, Duration)>,
}

/// No sender is chosen.
impl<S> Default for SenderChoice<S> {
    fn default() -> Self {
        Self { last: None }
    }
}

impl<S: Copy + PartialEq> SenderChoice<S> {
    /// Returns the chosen sender, or `None` if no sender has been chosen yet or the chosen one is
    /// silent.
    pub fn chosen(&self, now: Duration) -> Option<S> {
        let (sender, at) = self.last?;
        (now.saturating_sub(at) < SENDER_TIMEOUT).then_some(sender)
    }

    /// Returns `true` unless another sender is chosen.
    pub fn admits(&self, sender: S, now: Duration) -> bool {
        self.chosen(now).is_none_or(|chosen| chosen == sender)
    }

    /// Chooses an admitted sender because its data have yielded a measurement, or keeps it chosen.
    ///
    /// Returns `true` if the sender differs from the one chosen last. A sender that is not admitted
    /// is ignored.
    pub fn confirm(&mut self, sender: S, now: Duration) -> bool {
        if !self.admits(sender, now) {
            return false;
        }
        let previous = self.last.replace((sender, now));
        previous.is_none_or(|(previous, _)| previous != sender)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at_ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn first_sender_with_measurement_excludes_others() {
        let mut choice = SenderChoice::default();
        assert!(choice.admits(1, at_ms(0)) && choice.admits(2, at_ms(0)), "no sender has a measurement");
        assert!(choice.confirm(2, at_ms(0)));
        assert!(!choice.admits(1, at_ms(10)) && choice.admits(2, at_ms(10)));
        assert!(!choice.confirm(1, at_ms(10)), "another sender is chosen");
        assert_eq!(choice.chosen(at_ms(20)), Some(2));
    }

    #[test]
    fn choice_lapses_two_seconds_after_last_measurement() {
        let mut choice = SenderChoice::default();
        choice.confirm(1, at_ms(0));
        assert!(!choice.confirm(1, at_ms(1_500)), "the same sender");
        assert_eq!(choice.chosen(at_ms(3_499)), Some(1));
        assert_eq!(choice.chosen(at_ms(3_500)), None);
        assert!(choice.confirm(2, at_ms(3_500)));
        assert!(!choice.admits(1, at_ms(3_600)));
    }

    #[test]
    fn returning_sender_is_not_a_new_choice() {
        let mut choice = SenderChoice::default();
        choice.confirm(1, at_ms(0));
        assert!(!choice.confirm(1, at_ms(60_000)));
        assert_eq!(choice.chosen(at_ms(60_001)), Some(1));
    }
}
