//! Durations on the command line.

use std::time::Duration;

/// Parses a duration in ms, s, m or h. A number without a unit is in seconds.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let scale = match &text[split..] {
        "ms" => 1e-3,
        "s" | "" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err("expected a number with ms, s, m or h".into()),
    };
    let number: f64 = text[..split].trim().parse().map_err(|_| "expected a number with ms, s, m or h")?;
    let seconds = Some(number * scale).filter(|s| (1e-3..=1e8).contains(s));
    seconds.map(Duration::from_secs_f64).ok_or_else(|| "expected 1 ms to 27000 h".into())
}
