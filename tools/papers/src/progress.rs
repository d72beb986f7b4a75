//! How far the work has come.

/// Counts what is done, and tells it.
pub struct Progress<'a> {
    done: u64,
    of: u64,
    told: &'a mut dyn FnMut(u64, u64),
}

impl<'a> Progress<'a> {
    /// Work of so many steps.
    pub fn new(of: u64, told: &'a mut dyn FnMut(u64, u64)) -> Self {
        Self { done: 0, of, told }
    }

    /// So many steps more than was known before.
    pub(crate) fn more(&mut self, steps: u64) {
        self.of += steps;
    }

    /// One step is done.
    pub(crate) fn step(&mut self) {
        self.done += 1;
        (self.told)(self.done, self.of);
    }
}
