//! Decompression of gzip with a limit on the ratio of decompressed to compressed size.
//!
//! Input: gzip data.
//!
//! Output: the decompressed bytes.
//!
//! Failure: corrupt data is an error. So are more than [`MAX_RATIO`] bytes per compressed byte,
//! once [`MIN_LIMITED_BYTES`] have been decompressed.

use std::io::{self, Read};

use flate2::read::MultiGzDecoder;

/// Maximum ratio of decompressed to compressed size. Recordings stay below 50. A file crafted to
/// keep the reader busy can reach 1000.
const MAX_RATIO: u64 = 250;
/// Decompressed size below which the ratio is not limited, bytes.
const MIN_LIMITED_BYTES: u64 = 1 << 26;

/// Reader of the decompressed bytes.
pub struct GzipReader<R> {
    decoder: MultiGzDecoder<Counted<R>>,
    bytes: u64,
}

struct Counted<R> {
    inner: R,
    bytes: u64,
}

impl<R: Read> GzipReader<R> {
    /// Creates a reader of gzip data, which may consist of several members.
    pub fn new(inner: R) -> Self {
        Self { decoder: MultiGzDecoder::new(Counted { inner, bytes: 0 }), bytes: 0 }
    }
}

impl<R: Read> Read for GzipReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.decoder.read(buffer)?;
        self.bytes += count as u64;
        let compressed_bytes = self.decoder.get_ref().bytes;
        if self.bytes > MIN_LIMITED_BYTES && self.bytes / MAX_RATIO > compressed_bytes {
            let found = format!("{compressed_bytes} bytes of gzip decompress to more than {} bytes", self.bytes);
            return Err(io::Error::other(format!(
                "{found}, {MAX_RATIO} times as many; check the file, unpack it first"
            )));
        }
        Ok(count)
    }
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.bytes += count as u64;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::{Compression, write::GzEncoder};

    use super::*;

    fn compressed(chunk: &[u8], count: u64) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        (0..count).for_each(|_| encoder.write_all(chunk).unwrap());
        encoder.finish().unwrap()
    }

    #[test]
    fn ratio_of_long_data_is_limited() {
        let chunk = [b'\n'; 1 << 16];
        let read = |bytes: &[u8]| io::copy(&mut GzipReader::new(bytes), &mut io::sink());
        let limit = MIN_LIMITED_BYTES / chunk.len() as u64;
        assert_eq!(read(&compressed(&chunk, limit)).unwrap(), MIN_LIMITED_BYTES);
        let error = read(&compressed(&chunk, 2 * limit)).unwrap_err();
        assert!(error.to_string().contains("bytes of gzip decompress to more than"), "{error}");
    }
}
