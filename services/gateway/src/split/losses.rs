//! What is lost for good, in words.

use std::ops::Range;

/// Spans named in a line; of more the number of ticks is said.
const SPANS_MAX: usize = 8;

/// Spans that have not been said.
#[derive(Debug, Default)]
pub struct Losses {
    spans: Vec<Range<u64>>,
}

impl Losses {
    /// Adds a span.
    pub fn add(&mut self, span: Range<u64>) {
        match self.spans.last_mut() {
            Some(last) if last.end == span.start => last.end = span.end,
            _ => self.spans.push(span),
        }
    }

    /// A line about what has not been said, if there is anything; `lost` ticks are lost in all.
    pub fn take_line(&mut self, lost: u64) -> Option<String> {
        if self.spans.is_empty() {
            return None;
        }
        let spans = std::mem::take(&mut self.spans);
        let named = spans.iter().take(SPANS_MAX);
        let mut text: Vec<_> =
            named.map(|span| format!("{} to {} ({})", span.start, span.end - 1, span.end - span.start)).collect();
        let others: u64 = spans.iter().skip(SPANS_MAX).map(|span| span.end - span.start).sum();
        if others > 0 {
            text.push(format!("{others} others"));
        }
        Some(format!("lost, no longer kept by the other host: ticks {}; {lost} in all", text.join(", ")))
    }
}
