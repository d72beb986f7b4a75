//! Texts in memory provided by the caller.

/// Writes a zero-terminated text. A text that does not fit is truncated at a character boundary.
/// Returns the number of bytes written, not counting the zero.
pub(crate) fn write_text(text: &str, buffer: &mut [u8]) -> usize {
    let Some(space) = buffer.len().checked_sub(1) else { return 0 };
    let len = text.floor_char_boundary(space);
    buffer[..len].copy_from_slice(&text.as_bytes()[..len]);
    buffer[len] = 0;
    len
}
