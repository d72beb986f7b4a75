//! Order in which a slot polls its inputs.

/// Polls inputs until no input has a message, or `may_continue` returns `false`.
///
/// `poll` reads a few messages from an input and returns their number. The input that the next
/// output waits for (`awaited_input`) is polled first. This way an input that is behind catches up
/// before the others get further ahead, and no input is given up while it still has messages.
pub fn poll_fairly<T, E>(
    slot: &mut T,
    inputs: usize,
    mut may_continue: impl FnMut(&mut T) -> bool,
    awaited_input: impl Fn(&T) -> usize,
    mut poll: impl FnMut(&mut T, usize) -> Result<usize, E>,
) -> Result<(), E> {
    while may_continue(slot) {
        let awaited = awaited_input(slot);
        if poll(slot, awaited)? > 0 {
            continue;
        }
        let mut count = 0;
        for input in (0..inputs).filter(|input| *input != awaited) {
            count += poll(slot, input)?;
        }
        if count == 0 {
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
        let may_continue = |read: &mut [usize; 2]| {
            lead = lead.max(read[0].abs_diff(read[1]));
            true
        };
        let poll = |read: &mut [usize; 2], input: usize| -> Result<usize, Infallible> {
            let count = batch_size.min(available[input] - read[input]);
            read[input] += count;
            Ok(count)
        };
        let Ok(()) = poll_fairly(&mut read, 2, may_continue, awaited_input, poll);
        (read, lead)
    }

    #[test]
    fn delayed_input_catches_up_first() {
        assert_eq!(poll_two([300, 300], 17, [70, 0]), ([300, 300], 70));
        assert_eq!(poll_two([300, 300], 17, [0, 0]), ([300, 300], 17));
    }

    #[test]
    fn exhausted_input_does_not_block_the_other() {
        assert_eq!(poll_two([300, 40], 17, [0, 0]).0, [300, 40]);
        assert_eq!(poll_two([40, 300], 17, [0, 0]).0, [40, 300]);
    }
}
