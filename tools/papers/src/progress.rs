//! How far the work has come.

/// Counts what is done, and tells it.
pub struct Progress<'a> {
    done: u64,
    total: u64,
    report: &'a mut dyn FnMut(u64, u64),
}

impl<'a> Progress<'a> {
    /// Work total so many steps.
    pub fn new(total: u64, report: &'a mut dyn FnMut(u64, u64)) -> Self {
        Self { done: 0, total, report }
    }

    /// So many steps add_steps than was known before.
    pub(crate) fn add_steps(&mut self, steps: u64) {
        self.total += steps;
    }

    /// One step is done.
    pub(crate) fn step(&mut self) {
        self.done += 1;
        (self.report)(self.done, self.total);
    }
}
