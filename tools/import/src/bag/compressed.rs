//! Messages that a recorder of ROS 2 has compressed each by itself.

use std::io::Read;

use super::Message;

/// What begins compressed data; no message of CDR or protobuf that is read begins so.
const ZSTD: &[u8] = b"\x28\xb5\x2f\xfd";
const MAX_MESSAGE_BYTES: u64 = 1 << 16;

/// The message as it was before; what is damaged stays as it is, and says nothing.
pub(super) fn unpacked(message: Message) -> Message {
    if !message.data.starts_with(ZSTD) {
        return message;
    }
    let mut data = Vec::new();
    let unpacked = zstd::Decoder::with_buffer(&message.data[..])
        .and_then(|decoder| decoder.take(MAX_MESSAGE_BYTES).read_to_end(&mut data));
    if unpacked.is_ok() { Message { data, ..message } } else { message }
}
