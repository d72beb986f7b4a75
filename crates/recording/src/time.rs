//! Formats the times of a recording.

use std::fmt;

/// Exclusive limit of the absolute value of a time, s. Nanoseconds within this limit fit into an
/// `i64`.
const TIME_LIMIT_S: i64 = 9_000_000_000;
const NS_PER_S: i64 = 1_000_000_000;

/// Number of decimal places of a time in seconds that correspond to 1 ns.
pub(crate) const DIGITS: usize = 9;
/// Description of the text that can be read as a time.
pub(crate) const EXPECTED: &str = "a finite time in seconds within ±9e9";

/// Returns `true` if [`time_ns`](mapping::text::time_ns) reads the time that is formatted as
/// [`Seconds`].
pub(crate) fn is_in_range(t_ns: i64) -> bool {
    t_ns.unsigned_abs() / NS_PER_S.unsigned_abs() < TIME_LIMIT_S.unsigned_abs()
}

/// Time in ns, formatted as seconds without trailing zeros. [`time_ns`](mapping::text::time_ns)
/// reads it back exactly.
pub(crate) struct Seconds(pub(crate) i64);

impl fmt::Display for Seconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let per_s = NS_PER_S.unsigned_abs();
        let (whole_s, mut fraction) = (self.0.unsigned_abs() / per_s, self.0.unsigned_abs() % per_s);
        write!(f, "{}{whole_s}", if self.0 < 0 { "-" } else { "" })?;
        if fraction == 0 {
            return Ok(());
        }
        let mut digits = 9;
        while fraction.is_multiple_of(10) {
            (fraction, digits) = (fraction / 10, digits - 1);
        }
        write!(f, ".{fraction:0digits$}")
    }
}

#[cfg(test)]
mod tests {
    use mapping::text::time_ns;

    use super::*;

    #[test]
    fn seconds_are_written_without_trailing_zeros() {
        for (t_ns, text) in [
            (0, "0"),
            (3_500_000, "0.0035"),
            (-500_000_000, "-0.5"),
            (1_700_000_000_123_456_789, "1700000000.123456789"),
            (7_000_000_000, "7"),
            (1, "0.000000001"),
        ] {
            assert_eq!(Seconds(t_ns).to_string(), text);
            assert_eq!(time_ns(text, DIGITS), Some(t_ns));
        }
        let end_ns = TIME_LIMIT_S * NS_PER_S;
        for (t_ns, in_range) in [(end_ns - 1, true), (end_ns, false), (-end_ns, false), (i64::MIN, false)] {
            assert_eq!(is_in_range(t_ns), in_range);
            assert_eq!(time_ns(&Seconds(t_ns).to_string(), DIGITS), in_range.then_some(t_ns));
        }
    }
}
