//! Pages of memory for the rows of a batch.

use rustix::{
    mm::{Advice, madvise},
    param::page_size,
};

/// Lets the kernel provide the pages for the next `rows` elements of a vector in one call.
///
/// Otherwise, the first write to each page would cause an exception, which costs more than the call
/// does per page. The vector is not changed.
pub(super) fn provide_pages<T>(vector: &mut Vec<T>, rows: usize) {
    let memory = vector.as_mut_ptr();
    let [next, end, end_of_memory] =
        [vector.len(), vector.len() + rows, vector.capacity()].map(|index| memory.addr() + index * size_of::<T>());
    // Only pages that belong to the vector alone.
    let first = (next / page_size() * page_size()).max(memory.addr().next_multiple_of(page_size()));
    let end = end.next_multiple_of(page_size()).min(end_of_memory / page_size() * page_size());
    if first < end {
        // SAFETY: The pages belong to the vector, and the call does not change their contents. An
        // error is ignored, because the pages are then provided at the first write.
        #[allow(unsafe_code)]
        let _ = unsafe { madvise(memory.with_addr(first).cast(), end - first, Advice::LinuxPopulateWrite) };
    }
}
