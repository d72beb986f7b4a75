//! Progress of the reproduction.

/// Counter of finished steps that reports each change.
pub struct Progress<'a> {
    done: u64,
    total: u64,
    report: &'a mut dyn FnMut(u64, u64),
}

impl<'a> Progress<'a> {
    /// Creates a counter for `total` steps. `report` receives the number of finished steps and the
    /// total.
    pub fn new(total: u64, report: &'a mut dyn FnMut(u64, u64)) -> Self {
        Self { done: 0, total, report }
    }

    /// Adds steps that the total did not include before.
    pub(crate) fn add_steps(&mut self, steps: u64) {
        self.total += steps;
    }

    /// Records a finished step and reports the progress.
    pub(crate) fn step(&mut self) {
        self.done += 1;
        (self.report)(self.done, self.total);
    }
}
