//! The order in which a slot looks at its inputs.

/// Looks at inputs one after the other until none gives anything, or `goes_on` says no. The one that the next output waits for
/// (`lacks`) comes before the others: an input that is behind catches up before another one, which waits beside it, gets further ahead, and
/// is not taken for silent while it has something. `look` takes a few messages of an input and says how many.
pub fn take_turns<T, E>(
    slot: &mut T,
    inputs: usize,
    mut goes_on: impl FnMut(&mut T) -> bool,
    lacks: impl Fn(&T) -> usize,
    mut look: impl FnMut(&mut T, usize) -> Result<usize, E>,
) -> Result<(), E> {
    while goes_on(slot) {
        let first = lacks(slot);
        if look(slot, first)? > 0 {
            continue;
        }
        let mut taken = 0;
        for input in (0..inputs).filter(|input| *input != first) {
            taken += look(slot, input)?;
        }
        if taken == 0 {
            break;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    /// How far two inputs have been read that hold `waiting` messages each, and how far one was ahead of the other at most.
    fn read(waiting: [usize; 2], turn: usize, begun: [usize; 2]) -> ([usize; 2], usize) {
        let (mut read, mut lead) = (begun, 0);
        let lacks = |read: &[usize; 2]| usize::from(read[1] < read[0]);
        let goes_on = |read: &mut [usize; 2]| {
            lead = lead.max(read[0].abs_diff(read[1]));
            true
        };
        let look = |read: &mut [usize; 2], input: usize| -> Result<usize, Infallible> {
            let taken = turn.min(waiting[input] - read[input]);
            read[input] += taken;
            Ok(taken)
        };
        let Ok(()) = take_turns(&mut read, 2, goes_on, lacks, look);
        (read, lead)
    }

    #[test]
    fn an_input_that_was_away_catches_up_before_the_other_gets_further_ahead() {
        assert_eq!(read([300, 300], 17, [70, 0]), ([300, 300], 70));
        assert_eq!(read([300, 300], 17, [0, 0]), ([300, 300], 17));
    }

    #[test]
    fn an_input_that_gives_nothing_holds_nobody_up() {
        assert_eq!(read([300, 40], 17, [0, 0]).0, [300, 40]);
        assert_eq!(read([40, 300], 17, [0, 0]).0, [40, 300]);
    }
}
