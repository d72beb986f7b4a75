//! Pages of memory for the rows of a batch.

use std::{ops::Range, ptr::without_provenance_mut};

use rustix::{
    mm::{Advice, madvise},
    param::page_size,
};

/// Location of the memory of a vector.
#[derive(Clone, Copy)]
pub(super) struct Location {
    address: usize,
    element_bytes: usize,
    capacity: usize,
}

impl Location {
    pub(super) fn new<T>(vector: &Vec<T>) -> Self {
        Self { address: vector.as_ptr().addr(), element_bytes: size_of::<T>(), capacity: vector.capacity() }
    }

    /// Lets the kernel provide the pages of elements in one call.
    ///
    /// Otherwise, the first write to each page would cause an exception, which costs more than the
    /// call does per page.
    pub(super) fn provide_pages(self, elements: Range<usize>) {
        let [first, end] =
            [elements.start, elements.end].map(|index| self.address + index.min(self.capacity) * self.element_bytes);
        let first = first / page_size() * page_size();
        // SAFETY: The call does not change the contents of any memory. An error is ignored, because
        // the pages are then provided at the first write.
        #[allow(unsafe_code)]
        let _ = unsafe { madvise(without_provenance_mut(first), end - first, Advice::LinuxPopulateWrite) };
    }
}
