//! Decompression of messages that a ROS 2 recorder compressed individually.

use std::io::Read;

use super::message::Message;

/// First bytes of zstd-compressed data. No supported CDR or protobuf message starts with these
/// bytes.
const ZSTD_MAGIC: &[u8] = b"\x28\xb5\x2f\xfd";
const MAX_MESSAGE_BYTES: u64 = 1 << 16;

/// Decompresses a message if it is compressed. If the data is damaged or longer than
/// [`MAX_MESSAGE_BYTES`], the message is returned unchanged and fails to decode later.
pub(super) fn decompress(message: Message) -> Message {
    if !message.data.starts_with(ZSTD_MAGIC) {
        return message;
    }
    let mut data = Vec::new();
    let result = zstd::Decoder::with_buffer(&message.data[..])
        .and_then(|decoder| decoder.take(MAX_MESSAGE_BYTES + 1).read_to_end(&mut data));
    if result.is_ok() && data.len() as u64 <= MAX_MESSAGE_BYTES { Message { data, ..message } } else { message }
}
