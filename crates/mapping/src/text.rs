//! Splits lines into fields and parses times.

/// Exclusive limit of the absolute value of a time, s. Nanoseconds within this limit fit into an
/// `i64`.
const TIME_LIMIT_S: i128 = 9_000_000_000;

/// Returns the fields of a line, without surrounding blanks and quotes.
///
/// A separator between quotes belongs to the field. An unclosed quote ends with the line.
pub fn fields(line: &[u8], separator: u8) -> impl Iterator<Item = &[u8]> {
    let mut is_quoted = false;
    let parts = line.split(move |&byte| {
        is_quoted ^= byte == b'"';
        byte == separator && !is_quoted
    });
    parts.map(|part| match part.trim_ascii() {
        [b'"', inner @ .., b'"'] => inner.trim_ascii(),
        part => part,
    })
}

/// Parses a decimal time into nanoseconds, rounded half away from zero.
///
/// `digits` is the number of decimal places needed to write a time in the given unit with
/// nanosecond resolution: 9 for seconds. A number with an exponent is parsed as `f64`. Returns
/// `None` if the text is not a number or the time is not within ±9e9 s.
pub fn time_ns(text: &str, digits: usize) -> Option<i64> {
    let limit_ns = TIME_LIMIT_S * 1_000_000_000;
    let (is_negative, unsigned) = match text.strip_prefix('-') {
        Some(plain) => (true, plain),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, fraction) = unsigned.split_once('.').unwrap_or((unsigned, ""));
    if whole.len() + fraction.len() == 0 || !whole.bytes().chain(fraction.bytes()).all(|byte| byte.is_ascii_digit()) {
        let t_ns = (text.parse::<f64>().ok()? * 10f64.powi(i32::try_from(digits).ok()?)).round();
        return (t_ns.abs() < limit_ns as f64).then_some(t_ns as i64);
    }
    let decimals = fraction.bytes().chain(std::iter::repeat(b'0')).take(digits);
    let sum = whole.bytes().chain(decimals).fold(0i128, |sum, byte| {
        // Further digits are ignored once the time limit is exceeded, because they could overflow
        // the sum.
        if sum > limit_ns { sum } else { sum * 10 + i128::from(byte - b'0') }
    });
    let rounded = sum + i128::from(fraction.as_bytes().get(digits).is_some_and(|byte| *byte >= b'5'));
    let t_ns = i64::try_from(rounded).ok().filter(|t_ns| i128::from(*t_ns) < limit_ns)?;
    Some(if is_negative { -t_ns } else { t_ns })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_exact_in_every_unit() {
        for (text, digits, t_ns) in [
            ("1700000000123456789", 0, 1_700_000_000_123_456_789),
            ("1700000000123456.789", 3, 1_700_000_000_123_456_789),
            ("-0.5", 6, -500_000),
            ("0.0000000005", 9, 1),
            ("1.5e3", 9, 1_500_000_000_000),
            ("8999999999.999999999", 9, 8_999_999_999_999_999_999),
        ] {
            assert_eq!(time_ns(text, digits), Some(t_ns), "{text}");
        }
        for (text, digits) in
            [("", 9), (".", 9), ("1.2.3", 9), ("nan", 0), ("9e9", 9), ("9000000000", 9), ("99999999999999999999999", 0)]
        {
            assert_eq!(time_ns(text, digits), None, "{text}");
        }
    }
}
