//! Decompression of files, with a limit on the ratio of the sizes.
//!
//! Input: gzip, zstd or uncompressed data, recognised by its first bytes.
//!
//! Output: the decompressed bytes.
//!
//! Failure: corrupt data, or more than [`MAX_RATIO`] bytes per compressed byte, once
//! [`MIN_LIMITED_BYTES`] have been decompressed.

use std::io::{self, BufRead, BufReader, Read};

use flate2::bufread::MultiGzDecoder;

/// Magic numbers of gzip (RFC 1952, 2.3.1) and zstd (RFC 8878, 3.1.1).
const GZIP_MAGIC: &[u8] = b"\x1f\x8b";
const ZSTD_MAGIC: &[u8] = b"\x28\xb5\x2f\xfd";
/// Maximum ratio of decompressed to compressed size. Recordings stay below 50; a file that only
/// keeps the reader busy can reach 1000.
const MAX_RATIO: u64 = 250;
/// Decompressed size below which the ratio is not limited, bytes.
const MIN_LIMITED_BYTES: u64 = 1 << 26;

/// Reader of the decompressed bytes of a file.
pub struct Unpacked<R: Read>(Kind<R>);

enum Kind<R: Read> {
    Plain(BufReader<Counted<R>>),
    Gzip { decoder: MultiGzDecoder<BufReader<Counted<R>>>, bytes: u64 },
    Zstd { decoder: zstd::Decoder<'static, BufReader<Counted<R>>>, bytes: u64 },
}

struct Counted<R> {
    inner: R,
    bytes: u64,
}

impl<R: Read> Unpacked<R> {
    /// Creates a reader. Compressed data may consist of several members.
    ///
    /// # Errors
    ///
    /// Returns an error if the first bytes cannot be read.
    pub fn new(inner: R) -> io::Result<Self> {
        let mut packed = BufReader::new(Counted { inner, bytes: 0 });
        let start = packed.fill_buf()?;
        Ok(Self(if start.starts_with(GZIP_MAGIC) {
            Kind::Gzip { decoder: MultiGzDecoder::new(packed), bytes: 0 }
        } else if start.starts_with(ZSTD_MAGIC) {
            Kind::Zstd { decoder: zstd::Decoder::with_buffer(packed)?, bytes: 0 }
        } else {
            Kind::Plain(packed)
        }))
    }
}

impl<R: Read> Read for Unpacked<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let (count, bytes, compressed_bytes) = match &mut self.0 {
            Kind::Plain(inner) => return inner.read(buffer),
            Kind::Gzip { decoder, bytes } => (decoder.read(buffer)?, bytes, decoder.get_ref().get_ref().bytes),
            Kind::Zstd { decoder, bytes } => (decoder.read(buffer)?, bytes, decoder.get_ref().get_ref().bytes),
        };
        *bytes += count as u64;
        if *bytes > MIN_LIMITED_BYTES && *bytes / MAX_RATIO > compressed_bytes {
            let found = format!("{compressed_bytes} compressed bytes decompress to more than {bytes} bytes");
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

    fn gzip(chunk: &[u8], count: u64) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        (0..count).for_each(|_| encoder.write_all(chunk).unwrap());
        encoder.finish().unwrap()
    }

    fn zstd(chunk: &[u8], count: u64) -> Vec<u8> {
        let mut encoder = zstd::Encoder::new(Vec::new(), 0).unwrap();
        (0..count).for_each(|_| encoder.write_all(chunk).unwrap());
        encoder.finish().unwrap()
    }

    #[test]
    fn ratio_of_long_data_is_limited() {
        let chunk = [b'\n'; 1 << 16];
        let read = |bytes: &[u8]| io::copy(&mut Unpacked::new(bytes).unwrap(), &mut io::sink());
        let limit = MIN_LIMITED_BYTES / chunk.len() as u64;
        for pack in [gzip, zstd] {
            assert_eq!(read(&pack(&chunk, limit)).unwrap(), MIN_LIMITED_BYTES);
            let error = read(&pack(&chunk, 2 * limit)).unwrap_err();
            assert!(error.to_string().contains("compressed bytes decompress to more than"), "{error}");
        }
    }
}
