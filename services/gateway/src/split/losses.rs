//! Summaries of lost ticks, for display.

use std::ops::Range;

/// Maximum number of spans listed in a summary. Further spans are only counted.
const MAX_LISTED_SPANS: usize = 8;

/// Lost spans that have not been reported yet.
#[derive(Debug, Default)]
pub struct LossLog {
    spans: Vec<Range<u64>>,
}

impl LossLog {
    /// Adds a lost span.
    pub fn add(&mut self, span: Range<u64>) {
        match self.spans.last_mut() {
            Some(last) if last.end == span.start => last.end = span.end,
            _ => self.spans.push(span),
        }
    }

    /// Returns and clears the summary of unreported spans, or returns `None` if all are reported.
    ///
    /// `lost` is the total number of lost ticks.
    pub fn take_summary(&mut self, lost: u64) -> Option<String> {
        if self.spans.is_empty() {
            return None;
        }
        let spans = std::mem::take(&mut self.spans);
        let listed = spans.iter().take(MAX_LISTED_SPANS);
        let mut text: Vec<_> =
            listed.map(|span| format!("{} to {} ({})", span.start, span.end - 1, span.end - span.start)).collect();
        let others: u64 = spans.iter().skip(MAX_LISTED_SPANS).map(|span| span.end - span.start).sum();
        if others > 0 {
            text.push(format!("{others} more"));
        }
        Some(format!("ticks lost, no longer cached by the other host: {}; {lost} in total", text.join(", ")))
    }
}
