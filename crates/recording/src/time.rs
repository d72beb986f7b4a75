//! Parses and formats the times of a recording.

use std::fmt;

/// Exclusive limit of the absolute value of a time, s. Nanoseconds within this limit fit into an
/// `i64`.
const TIME_LIMIT_S: i64 = 9_000_000_000;
const NS_PER_S: i64 = 1_000_000_000;

/// Description of the text that [`parse_ns`] accepts.
pub(crate) const EXPECTED: &str = "a finite time in seconds within ±9e9";

/// Parses decimal seconds into nanoseconds, rounded half away from zero.
///
/// Returns `None` unless the absolute value is less than 9e9 s. Plain decimals are parsed exactly.
/// Numbers with an exponent are parsed as `f64`.
pub(crate) fn parse_ns(text: &str) -> Option<i64> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let digits_only = whole.bytes().chain(fraction.bytes()).all(|byte| byte.is_ascii_digit());
    if !digits_only || whole.len() + fraction.len() == 0 {
        let t_s: f64 = text.parse().ok()?;
        return (t_s.abs() < TIME_LIMIT_S as f64).then(|| (t_s * NS_PER_S as f64).round() as i64);
    }
    let digit = |byte: u8| i64::from(byte - b'0');
    let whole_s = whole.bytes().fold(0i64, |sum, byte| sum.saturating_mul(10).saturating_add(digit(byte)));
    if whole_s >= TIME_LIMIT_S {
        return None;
    }
    let mut fraction = fraction.bytes().map(digit).chain(std::iter::repeat(0));
    let fraction_ns = fraction.by_ref().take(9).fold(0, |sum, digit| sum * 10 + digit);
    let carry_ns = i64::from(fraction.next() >= Some(5));
    Some(sign * (whole_s * NS_PER_S + fraction_ns + carry_ns))
}

/// Returns `true` if [`parse_ns`] accepts the time once it is formatted as [`Seconds`].
pub(crate) fn is_in_range(t_ns: i64) -> bool {
    t_ns.unsigned_abs() / NS_PER_S.unsigned_abs() < TIME_LIMIT_S.unsigned_abs()
}

/// Time in ns, formatted as seconds without trailing zeros. [`parse_ns`] reads it back exactly.
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
            assert_eq!(parse_ns(text), Some(t_ns));
        }
        let end_ns = TIME_LIMIT_S * NS_PER_S;
        for (t_ns, in_range) in [(end_ns - 1, true), (end_ns, false), (-end_ns, false), (i64::MIN, false)] {
            assert_eq!(is_in_range(t_ns), in_range);
            assert_eq!(parse_ns(&Seconds(t_ns).to_string()), in_range.then_some(t_ns));
        }
    }

    #[test]
    fn decimals_keep_every_nanosecond() {
        for (text, t_ns) in [
            ("0", 0),
            ("-0.0", 0),
            ("0.0035", 3_500_000),
            ("1700000000.123456789", 1_700_000_000_123_456_789),
            ("-1700000000.123456789", -1_700_000_000_123_456_789),
            ("+.5", 500_000_000),
            ("7.", 7_000_000_000),
            ("0000000000000000000001", 1_000_000_000),
            ("8999999999.999999999", 8_999_999_999_999_999_999),
        ] {
            assert_eq!(parse_ns(text), Some(t_ns), "{text}");
        }
    }

    #[test]
    fn sub_nanosecond_digits_round_half_away_from_zero() {
        for (text, t_ns) in [
            ("0.0000000004999", 0),
            ("0.0000000005", 1),
            ("-0.0000000005", -1),
            ("0.9999999999", 1_000_000_000),
            ("8999999999.9999999999", 9_000_000_000_000_000_000),
        ] {
            assert_eq!(parse_ns(text), Some(t_ns), "{text}");
        }
    }

    #[test]
    fn exponents_are_parsed() {
        for (text, t_ns) in [("3.5e-3", 3_500_000), ("1.5E3", 1_500_000_000_000), ("-1e-9", -1)] {
            assert_eq!(parse_ns(text), Some(t_ns), "{text}");
        }
    }

    #[test]
    fn invalid_or_out_of_range_times_are_rejected() {
        for text in
            ["", ".", "-", "+-1", "1.2.3", "1 2", "nan", "inf", "-inf", "9e9", "-9000000000", "99999999999999999999"]
        {
            assert_eq!(parse_ns(text), None, "{text}");
        }
    }
}
