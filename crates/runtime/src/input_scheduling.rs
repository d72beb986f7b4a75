//! Order in which a slot polls its inputs.

/// Polls inputs until each one was empty at its last poll, or `may_continue` returns `false`.
///
/// `poll` reads a few messages from an input and returns `true` if the input may have more. The
/// input that the next output waits for (`awaited_input`) is polled first. An input that is behind
/// can thus catch up before the others get further ahead, and no input is given up while it still
/// has messages. After a poll that leaves messages unread, `may_continue` is called and then all
/// inputs are polled again. There are at most 64 inputs.
pub fn poll_fairly<T, E>(
    slot: &mut T,
    inputs: usize,
    mut may_continue: impl FnMut(&mut T) -> bool,
    awaited_input: impl Fn(&T) -> usize,
    mut poll: impl FnMut(&mut T, usize) -> Result<bool, E>,
) -> Result<(), E> {
    let all = !(u64::MAX << inputs);
    // One bit for each input that may have messages.
    let mut pending = all;
    while pending != 0 {
        let awaited = 1 << awaited_input(slot);
        let polled = if pending & awaited != 0 { awaited } else { pending };
        let mut has_more = false;
        for input in (0..inputs).filter(|input| polled & 1 << input != 0) {
            has_more |= poll(slot, input)?;
        }
        pending = if has_more { all } else { pending & !polled };
        if has_more && !may_continue(slot) {
            break;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    /// Polls two inputs that contain `available` messages each, starting from the positions
    /// `start`. Returns the final positions, and the largest lead of one input over the other.
    fn poll_two(available: [usize; 2], batch_size: usize, start: [usize; 2]) -> ([usize; 2], usize) {
        let (mut read, mut lead) = (start, 0);
        let awaited_input = |read: &[usize; 2]| usize::from(read[1] < read[0]);
        let poll = |read: &mut [usize; 2], input: usize| -> Result<bool, Infallible> {
            lead = lead.max(read[0].abs_diff(read[1]));
            let count = batch_size.min(available[input] - read[input]);
            read[input] += count;
            Ok(count == batch_size)
        };
        let Ok(()) = poll_fairly(&mut read, 2, |_| true, awaited_input, poll);
        (read, lead)
    }

    #[test]
    fn delayed_input_catches_up_first() {
        assert_eq!(poll_two([300, 300], 17, [70, 0]), ([300, 300], 70));
        assert_eq!(poll_two([300, 300], 17, [0, 0]), ([300, 300], 17));
    }

    #[test]
    fn empty_input_is_polled_once() {
        let mut polled = [0; 3];
        let poll = |_: &mut (), input: usize| -> Result<bool, Infallible> {
            polled[input] += 1;
            Ok(false)
        };
        let Ok(()) = poll_fairly(&mut (), 3, |_| true, |()| 1, poll);
        assert_eq!(polled, [1; 3]);
    }

    #[test]
    fn awaited_input_is_polled_again_between_batches() {
        let (mut order, mut batches) = (Vec::new(), 3);
        let poll = |_: &mut (), input: usize| -> Result<bool, Infallible> {
            order.push(input);
            batches -= usize::from(input == 1);
            Ok(input == 1 && batches > 0)
        };
        let Ok(()) = poll_fairly(&mut (), 2, |_| true, |()| 0, poll);
        assert_eq!(order, [0, 1, 0, 1, 0, 1]);
    }

    #[test]
    fn exhausted_input_does_not_block_the_other() {
        assert_eq!(poll_two([300, 40], 17, [0, 0]).0, [300, 40]);
        assert_eq!(poll_two([40, 300], 17, [0, 0]).0, [40, 300]);
    }
}
