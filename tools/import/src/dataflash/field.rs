//! Field of a DataFlash message.

/// Position of a field in a message, and the type of its value.
#[derive(Debug, Clone, Copy)]
pub(super) struct Field {
    pub(super) offset: usize,
    pub(super) type_code: u8,
}

impl Field {
    /// Returns the value of the field in a message; NaN if it is not numeric.
    pub(super) fn number(self, message: &[u8]) -> f64 {
        let Some(bytes) = message.get(self.offset..) else { return f64::NAN };
        macro_rules! number {
            ($type:ty) => {
                bytes.first_chunk().map_or(f64::NAN, |bytes| <$type>::from_le_bytes(*bytes) as f64)
            };
        }
        match self.type_code {
            b'b' => number!(i8),
            b'B' | b'M' => number!(u8),
            b'h' => number!(i16),
            b'H' => number!(u16),
            b'i' => number!(i32),
            b'I' => number!(u32),
            b'q' => number!(i64),
            b'Q' => number!(u64),
            b'f' => number!(f32),
            b'd' => number!(f64),
            b'c' => number!(i16) / 100.0,
            b'C' => number!(u16) / 100.0,
            b'e' => number!(i32) / 100.0,
            b'E' => number!(u32) / 100.0,
            b'L' => number!(i32) / 1e7,
            _ => f64::NAN,
        }
    }

    /// Returns the value of an unsigned integer field in a message; `None` for other types.
    pub(super) fn unsigned(self, message: &[u8]) -> Option<u64> {
        let bytes = message.get(self.offset..)?;
        match self.type_code {
            b'B' => bytes.first().map(|byte| (*byte).into()),
            b'H' => bytes.first_chunk().map(|bytes| u16::from_le_bytes(*bytes).into()),
            b'I' => bytes.first_chunk().map(|bytes| u32::from_le_bytes(*bytes).into()),
            b'Q' => bytes.first_chunk().map(|bytes| u64::from_le_bytes(*bytes)),
            _ => None,
        }
    }
}
