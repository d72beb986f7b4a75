//! Rules for text with numbers, shared by files and live streams: comments, separators, numbers
//! and times.

use std::{borrow::Cow, ops::RangeInclusive};

/// Exclusive limit of the absolute value of a time, s. Nanoseconds within this limit fit into an
/// `i64`.
const TIME_LIMIT_S: i128 = 9_000_000_000;
/// Signs that start a comment.
const COMMENT_SIGNS: [&str; 3] = ["#", "%", "//"];
const BYTE_ORDER_MARK: char = '\u{feff}';
/// Length of a day, ns. A time of day wraps after it.
pub const DAY_NS: i64 = 86_400_000_000_000;
const NS_PER_S: i64 = 1_000_000_000;
/// Column counts that are accepted without column names.
const UNNAMED_COLUMN_COUNTS: [usize; 2] = [7, 10];
/// Column names assumed for text without names.
const UNNAMED_COLUMNS: [&str; 10] = ["t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz"];

/// Separator between the fields of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Separator {
    /// One character between two fields. Blanks around it are ignored.
    Char(u8),
    /// Any number of blanks and tabs.
    Blanks,
}

impl Separator {
    /// Separators in order of preference.
    ///
    /// Tabs, semicolons and bars come first because they rarely occur in names, and because a comma
    /// in a text with one of these separators is a decimal comma.
    pub const ALL: [Self; 5] = [Self::Char(b'\t'), Self::Char(b';'), Self::Char(b'|'), Self::Char(b','), Self::Blanks];

    /// Returns the fields of a line, without surrounding blanks and quotes.
    ///
    /// A separator between quotes belongs to the field. An unclosed quote ends with the line.
    pub fn fields(self, line: &str) -> Vec<&str> {
        let mut is_quoted = false;
        let parts = line.trim_ascii().split(move |found: char| {
            is_quoted ^= found == '"';
            !is_quoted
                && match self {
                    Self::Char(separator) => found == char::from(separator),
                    Self::Blanks => matches!(found, ' ' | '\t'),
                }
        });
        let unquoted = parts.map(|part| {
            let part = part.trim_ascii();
            part.strip_prefix('"').and_then(|part| part.strip_suffix('"')).map_or(part, str::trim_ascii)
        });
        unquoted.filter(|part| self != Self::Blanks || !part.is_empty()).collect()
    }

    /// Returns the fields of a row with `count` columns. A separator at the end of the line ends
    /// the last field instead of starting an empty one.
    pub fn row_fields(self, line: &str, count: usize) -> Vec<&str> {
        let mut fields = self.fields(line);
        if fields.len() == count + 1 && fields.last().is_some_and(|last| last.is_empty()) {
            fields.pop();
        }
        fields
    }

    /// Returns the separator of a line: the first that occurs in it, else blanks.
    pub fn of_line(line: &str) -> Self {
        Self::of_lines(&[line])
    }

    /// Returns the first separator that splits all lines into the same number of fields, at least
    /// two.
    pub fn common(lines: &[&str]) -> Option<Self> {
        Self::ALL.into_iter().find(|separator| {
            let mut counts = lines.iter().map(|line| separator.fields(line).len());
            let first = counts.next().unwrap_or(0);
            first > 1 && counts.all(|count| count == first)
        })
    }

    fn of_lines(lines: &[&str]) -> Self {
        Self::common(lines).unwrap_or(Self::Blanks)
    }
}

/// Content of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Line<'a> {
    /// Blank line.
    Blank,
    /// Comment, without its sign. It may hold the column names.
    Comment(&'a str),
    /// Names or values.
    Content(&'a str),
}

impl<'a> Line<'a> {
    /// Classifies a line. Returns `None` for bytes that are not text, such as the zeros at the end
    /// of a damaged file.
    pub fn parse(line: &'a [u8]) -> Option<Self> {
        let text = str::from_utf8(line).ok()?;
        let is_text = |byte: u8| !byte.is_ascii_control() || matches!(byte, b'\t' | b'\r' | b'\n' | 0x0c);
        if !text.bytes().all(is_text) {
            return None;
        }
        let text = text.trim_start_matches(BYTE_ORDER_MARK).trim_ascii();
        Some(match COMMENT_SIGNS.iter().find_map(|sign| text.strip_prefix(sign)) {
            _ if text.is_empty() => Self::Blank,
            Some(comment) => Self::Comment(comment.trim_ascii()),
            None => Self::Content(text),
        })
    }
}

/// Returns `true` if `line` is a row of values. In such a row, at least two of the fields, and at
/// least half of those that are not blank, are numbers or times. It is enough that one of the
/// separators yields such a row.
pub fn is_row(line: &str) -> bool {
    Separator::ALL.into_iter().any(|separator| {
        let fields = separator.fields(line);
        let is_value = |field: &&str| {
            let field = with_point(field);
            field.parse::<f64>().is_ok() || calendar_ns(&field).is_some() || time_of_day_ns(&field).is_some()
        };
        let blank = fields.iter().filter(|field| field.is_empty()).count();
        let values = fields.iter().filter(|field| is_value(field)).count();
        values >= 2 && 2 * values >= fields.len() - blank
    })
}

/// Returns the assumed column names of a text without names. Its rows have `count` fields. Returns
/// `None` if names are required for this number of fields.
pub fn unnamed_columns(count: usize) -> Option<&'static [&'static str]> {
    UNNAMED_COLUMNS.get(..count).filter(|_| UNNAMED_COLUMN_COUNTS.contains(&count))
}

/// Returns the column name without a unit in brackets at its end: `wx` for `wx [rad/s]`.
pub fn without_unit(name: &str) -> &str {
    let start = match name.trim_ascii_end().chars().next_back() {
        Some(']') => name.rfind('['),
        Some(')') => name.rfind('('),
        _ => None,
    };
    let plain = start.and_then(|start| name.get(..start)).unwrap_or_default().trim_ascii();
    if plain.is_empty() { name } else { plain }
}

/// Separator and decimal mark of a text, found in its first row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dialect {
    /// Separator of the fields.
    pub separator: Separator,
    /// Decimal mark, or `None` until the first decimal fraction.
    decimal_mark: Option<u8>,
}

/// Text expected in place of an invalid field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Expected {
    /// A number.
    Number,
    /// A number with the same decimal mark as the numbers before it.
    Mark {
        /// `true` if the decimal mark is a comma.
        is_comma: bool,
    },
    /// A time within ±9e9 s.
    Time,
    /// A number, a time of day or a date.
    TimeText,
    /// A date such as `27/11/2026`, in which the order of day and month is evident.
    DateOrder,
}

impl Expected {
    /// Returns the description used in messages. For times, it does not include the unit.
    pub fn description(self) -> &'static str {
        match self {
            Self::Number => "a number",
            Self::Mark { is_comma: false } => "a number with a decimal point, as before",
            Self::Mark { is_comma: true } => "a number with a decimal comma, as before",
            Self::Time => "less than 9e9 s; set another unit with --units",
            Self::TimeText => "a number, a time of day such as 13:05:00.02 or a date such as 2026-05-01T13:05:00.02Z",
            Self::DateOrder => {
                "a date whose first number is known to be the month or the day; write the year first: months with `sed -E 's|([0-9]+)/([0-9]+)/([0-9]{4})|\\3-\\1-\\2|' FILE > NEW`, days with \\3-\\2-\\1 in it"
            }
        }
    }
}

impl Dialect {
    /// Creates the dialect of a text with this separator.
    pub fn new(separator: Separator) -> Self {
        Self { separator, decimal_mark: None }
    }

    /// Parses a number. A blank field is NaN.
    ///
    /// # Errors
    ///
    /// Returns the expected text if the field is not a number.
    pub fn number(&mut self, field: &str) -> Result<f64, Expected> {
        let text = self.decimal(field)?;
        if text.is_empty() { Ok(f64::NAN) } else { text.parse().map_err(|_| Expected::Number) }
    }

    /// Parses a time. `digits` is as for [`time_ns`]. A blank field is `None`.
    ///
    /// # Errors
    ///
    /// Returns the expected text if the field is not a time.
    pub fn time(&mut self, field: &str, digits: usize) -> Result<Option<Time>, Expected> {
        if field.is_empty() {
            return Ok(None);
        }
        let point = with_point(field);
        if let Some(t_ns) = calendar_ns(&point) {
            return Ok(Some(Time::Calendar(t_ns)));
        }
        if let Some(t_ns) = time_of_day_ns(&point) {
            return Ok(Some(Time::OfDay(t_ns)));
        }
        if is_ambiguous_date(&point) {
            return Err(Expected::DateOrder);
        }
        let decimal = self.decimal(field).map_err(|expected| match expected {
            Expected::Number => Expected::TimeText,
            expected => expected,
        })?;
        let is_number = decimal.parse::<f64>().is_ok();
        let expected = if is_number { Expected::Time } else { Expected::TimeText };
        time_ns(&decimal, digits).map(|t_ns| Some(Time::Count(t_ns))).ok_or(expected)
    }

    /// Replaces a decimal comma with a point. All numbers of a text have the same decimal mark.
    fn decimal<'a>(&mut self, field: &'a str) -> Result<Cow<'a, str>, Expected> {
        let Some(mark) = field.bytes().find(|byte| matches!(byte, b'.' | b',')) else { return Ok(field.into()) };
        if field.contains('.') && field.contains(',') {
            return Err(Expected::Number);
        }
        match self.decimal_mark.replace(self.decimal_mark.unwrap_or(mark)) {
            Some(known) if known != mark => Err(Expected::Mark { is_comma: known == b',' }),
            _ => Ok(with_point(field)),
        }
    }
}

/// Replaces a decimal comma with a point.
fn with_point(field: &str) -> Cow<'_, str> {
    let has_decimal_comma = field.contains(',') && !field.contains('.');
    if has_decimal_comma { field.replacen(',', ".", 1).into() } else { field.into() }
}

/// Time parsed from text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Time {
    /// Plain number, converted from the unit of the column to ns.
    Count(i64),
    /// Date and time (ISO 8601) as UNIX time, ns.
    Calendar(i64),
    /// Time of day, ns. It wraps at midnight.
    OfDay(i64),
}

impl Time {
    /// Returns the time, ns.
    pub fn ns(self) -> i64 {
        match self {
            Self::Count(t_ns) | Self::Calendar(t_ns) | Self::OfDay(t_ns) => t_ns,
        }
    }
}

/// Parses a time of day such as `13:05:00.020`, `13:05:00:020` or `1:05:00.02 PM`.
fn time_of_day_ns(text: &str) -> Option<i64> {
    let text = text.trim_ascii_end();
    let (text, half_day) = match text.len().checked_sub(2).and_then(|at| text.split_at_checked(at)) {
        Some((clock, half)) if half.eq_ignore_ascii_case("am") => (clock, Some(0)),
        Some((clock, half)) if half.eq_ignore_ascii_case("pm") => (clock, Some(12)),
        _ => (text, None),
    };
    let mut parts = text.trim_ascii_end().splitn(3, ':');
    let [hours, minutes, seconds] = [parts.next()?, parts.next()?, parts.next()?];
    let digits = |text: &str, limit: i64| {
        let is_number = (1..=2).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit());
        text.parse().ok().filter(|number: &i64| is_number && *number < limit)
    };
    let hours = match (digits(hours, 24)?, half_day) {
        (hours, None) => hours,
        (hours @ 1..=12, Some(half_day)) => hours % 12 + half_day,
        _ => return None,
    };
    let is_positive = seconds.starts_with(|first: char| first.is_ascii_digit());
    let seconds = seconds.replacen([':', ','], ".", 1);
    // A leap second is the 61st of its minute.
    let seconds_ns = time_ns(&seconds, 9).filter(|ns| is_positive && *ns < 61 * NS_PER_S)?;
    Some((hours * 60 + digits(minutes, 60)?) * 60 * NS_PER_S + seconds_ns)
}

/// Parses a date and time of ISO 8601, such as `2026-05-01T13:05:00.020Z`,
/// `2026-05-01 15:05:00+02:00` or `20260501T130500.02Z`, or with a date such as `01.05.2026` or
/// `05/27/2026`. A time without an offset is taken as UTC.
fn calendar_ns(text: &str) -> Option<i64> {
    let (date, time) = text.split_once(['T', 't', ' '])?;
    let (year, month, day) = date_parts(date)?;
    let month_days = [31, if is_leap_year(year) { 29 } else { 28 }, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let days_of_month = *month_days.get(usize::try_from(month).ok()?.checked_sub(1)?)?;
    if !(1..=days_of_month).contains(&day) || year < 1970 {
        return None;
    }
    let time = time.trim_ascii();
    let (time, offset_ns) = match time.strip_suffix(['Z', 'z']) {
        Some(utc) => (utc, 0),
        None => match time.rfind(['+', '-']) {
            Some(at) => (time.get(..at)?, offset_ns(time.get(at..)?)?),
            None => (time, 0),
        },
    };
    let leap_days = |year: i64| year / 4 - year / 100 + year / 400;
    let days = (year - 1970) * 365 + leap_days(year - 1) - leap_days(1969);
    let days = days + month_days.iter().take(usize::try_from(month).ok()? - 1).sum::<i64>() + day - 1;
    let t_ns = days.checked_mul(DAY_NS)?.checked_add(clock_ns(time.trim_ascii())?)?;
    t_ns.checked_sub(offset_ns).filter(|t_ns| i128::from(*t_ns) < TIME_LIMIT_S * i128::from(NS_PER_S))
}

/// Parses the year, month and day of a date: `2026-05-01`, `2026/05/01`, `20260501`, `01.05.2026`,
/// `05/27/2026` or `27/05/2026`. A date such as `05/01/2026` is rejected, because its order is
/// ambiguous.
fn date_parts(date: &str) -> Option<(i64, i64, i64)> {
    if let Some([first, second, year]) = parts_before_year(date) {
        return match (first, second) {
            (13.., _) => Some((year, second, first)),
            (_, 13..) => Some((year, first, second)),
            _ => (first == second).then_some((year, first, second)),
        };
    }
    let parts: Vec<&str> = date.splitn(4, ['-', '/']).collect();
    match (&parts[..], date.split('.').collect::<Vec<_>>().as_slice()) {
        ([year, month, day], _) | (_, [day, month, year]) => {
            Some((whole_number(year, 4..=4)?, whole_number(month, 1..=2)?, whole_number(day, 1..=2)?))
        }
        _ => {
            let digits = whole_number(date, 8..=8)?;
            Some((digits / 10_000, digits / 100 % 100, digits % 100))
        }
    }
}

/// Returns the numbers of a date such as `05/27/2026`, in which day and month precede the year.
fn parts_before_year(date: &str) -> Option<[i64; 3]> {
    let mut parts = date.splitn(3, '/');
    let [first, second, year] = [parts.next()?, parts.next()?, parts.next()?];
    Some([whole_number(first, 1..=2)?, whole_number(second, 1..=2)?, whole_number(year, 4..=4)?])
}

/// Returns `true` for a date and time such as `05/01/2026 13:05:00`, of which the first number may
/// be the month or the day.
fn is_ambiguous_date(text: &str) -> bool {
    let parts = text.split_once(['T', 't', ' ']).and_then(|(date, _)| parts_before_year(date));
    parts
        .is_some_and(|[first, second, _]| first != second && [first, second].iter().all(|part| (1..=12).contains(part)))
}

fn whole_number(text: &str, digits: RangeInclusive<usize>) -> Option<i64> {
    (digits.contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit())).then(|| text.parse().ok())?
}

/// Parses the time of a date, with or without colons.
fn clock_ns(time: &str) -> Option<i64> {
    let (whole, fraction) = time.split_once(['.', ',']).unwrap_or((time, "0"));
    match (whole.len(), whole.get(..2), whole.get(2..4), whole.get(4..)) {
        (6, Some(hours), Some(minutes), Some(seconds)) => {
            time_of_day_ns(&format!("{hours}:{minutes}:{seconds}.{fraction}"))
        }
        _ => time_of_day_ns(time),
    }
}

/// Parses an offset from UTC, such as `+02:00`, `-0330` or `+02`.
fn offset_ns(text: &str) -> Option<i64> {
    let (sign, digits) = match text.split_at_checked(1)? {
        ("-", digits) => (-1, digits.replacen(':', "", 1)),
        (_, digits) => (1, digits.replacen(':', "", 1)),
    };
    if !matches!(digits.len(), 2 | 4) || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let (hours, minutes) = digits.split_at(2);
    let minutes = if minutes.is_empty() { 0 } else { minutes.parse::<i64>().ok()? };
    Some(sign * (hours.parse::<i64>().ok()? * 60 + minutes) * 60 * NS_PER_S)
}

fn is_leap_year(year: i64) -> bool {
    year % 4 == 0 && (year % 100 != 0 || year % 400 == 0)
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

    #[test]
    fn calendar_times_and_times_of_day_are_parsed() {
        let mut dialect = Dialect::new(Separator::Char(b';'));
        let unix_ns = 1_777_640_700_020_000_000;
        for text in [
            "2026-05-01T13:05:00.020Z",
            "2026-05-01 13:05:00,020",
            "2026-05-01T15:05:00.02+02:00",
            "2026-05-01T09:35:00.02-0330",
            "2026/05/01 13:05:00.020 Z",
            "20260501T130500.020Z",
            "01.05.2026 13:05:00,020",
            "2026-05-01 01:05:00.020 PM",
            "2026-5-1 13:05:00.020",
        ] {
            assert_eq!(dialect.time(text, 9), Ok(Some(Time::Calendar(unix_ns))), "{text}");
        }
        let later_ns = unix_ns + 26 * DAY_NS;
        for text in ["05/27/2026 13:05:00.020", "27/05/2026 13:05:00,020", "5/27/2026 1:05:00.020 PM"] {
            assert_eq!(dialect.time(text, 9), Ok(Some(Time::Calendar(later_ns))), "{text}");
        }
        assert_eq!(calendar_ns("05/05/2026 13:05:00.020"), Some(unix_ns + 4 * DAY_NS));
        assert_eq!(dialect.time("05/01/2026 13:05:00", 9), Err(Expected::DateOrder));
        for text in ["13:05:00.020", "13:05:00:020", "13:05:00,020", "1:05:00.02 pm", "01:05:00.020PM"] {
            assert_eq!(dialect.time(text, 9), Ok(Some(Time::OfDay(47_100_020_000_000))), "{text}");
        }
        assert_eq!(dialect.time("12:00:00 AM", 9), Ok(Some(Time::OfDay(0))));
        for text in [
            "25:00:00",
            "1:2",
            "2026-02-29T00:00:00Z",
            "2026-13-01T00:00:00Z",
            "2026-05-01T",
            "12:-1:00",
            "13:00:00 PM",
            "13/13/2026 13:05:00",
            "2026050T130500",
            "1.2.3.4",
        ] {
            assert_eq!(dialect.time(text, 9), Err(Expected::TimeText), "{text}");
        }
        assert_eq!(dialect.time("1700000000000", 9), Err(Expected::Time));
        assert_eq!(calendar_ns("2024-02-29T23:59:60Z"), calendar_ns("2024-03-01T00:00:00Z"));
    }

    #[test]
    fn separators_are_found_in_lines_that_agree() {
        for (header, row, separator, count) in [
            ("t,x,y", "0,1,2", Separator::Char(b','), 3),
            ("t x y", "0,5 1,5  2", Separator::Blanks, 3),
            ("t, s;x", "0,5;1,5", Separator::Char(b';'), 2),
            ("t|x, y", "0,5|1,5", Separator::Char(b'|'), 2),
            ("t\tx", "0\t1", Separator::Char(b'\t'), 2),
            ("\"t, s\",x", "\"0,5\",1", Separator::Char(b','), 2),
        ] {
            assert_eq!(Separator::common(&[header, row]), Some(separator), "{header}");
            assert_eq!(separator.fields(row).len(), count, "{row}");
        }
        assert_eq!(Separator::common(&["a,b", "a b c"]), None);
        let comma = Separator::Char(b',');
        assert_eq!([comma.row_fields("0,1,", 2), comma.row_fields("0,1,", 3)], [vec!["0", "1"], vec!["0", "1", ""]]);
    }

    #[test]
    fn lines_are_comments_names_or_rows() {
        assert_eq!(Line::parse(b"\xef\xbb\xbf#t [ns],x\r"), Some(Line::Comment("t [ns],x")));
        assert_eq!(Line::parse(b"% t"), Some(Line::Comment("t")));
        assert_eq!(Line::parse(b" \r"), Some(Line::Blank));
        assert_eq!([Line::parse(b"1,\0"), Line::parse(b"\xb5")], [None, None]);
        for (line, expected) in [
            ("0;1;x;2", true),
            ("t,x,y", false),
            ("13:05:00 1 2", true),
            ("0,5 1,5", true),
            ("a 1", false),
            ("1,,,nan,", true),
        ] {
            assert_eq!(is_row(line), expected, "{line}");
        }
        assert_eq!(["wx [rad/s]", "wx (°/s)", "[x]", "f(x) a"].map(without_unit), ["wx", "wx", "[x]", "f(x) a"]);
    }

    #[test]
    fn all_numbers_have_one_decimal_mark() {
        let mut dialect = Dialect::new(Separator::Char(b';'));
        assert_eq!(dialect.number("1,5"), Ok(1.5));
        assert_eq!(dialect.number("1.5"), Err(Expected::Mark { is_comma: true }));
        assert_eq!(dialect.number("1,234.5"), Err(Expected::Number));
        assert_eq!(dialect.number("2"), Ok(2.0));
        assert!(dialect.number("").is_ok_and(f64::is_nan));
    }
}
