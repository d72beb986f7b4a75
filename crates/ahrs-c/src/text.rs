//! Texts in the memory of the caller.

/// Writes a text with a terminating zero, cut to the buffer at the end of a character. Returns the
/// number of bytes written without the zero.
pub(crate) fn write_text(text: &str, buffer: &mut [u8]) -> usize {
    let Some(space) = buffer.len().checked_sub(1) else { return 0 };
    let len = text.floor_char_boundary(space);
    buffer[..len].copy_from_slice(&text.as_bytes()[..len]);
    buffer[len] = 0;
    len
}
