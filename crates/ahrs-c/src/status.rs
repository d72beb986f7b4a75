//! Status of a call, and the message of the newest error.

use core::{
    cell::RefCell,
    ffi::{CStr, c_char},
    fmt::{self, Write as _},
};

use plumbline_ahrs::{BuildError, CalibrationError, SnapshotError};

/// Status that a function returns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum PlumblineStatus {
    /// Success.
    Ok = 0,
    /// A pointer that must not be null is null.
    NullPointer = 1,
    /// An argument is not one of the allowed constants, or a text is not UTF-8.
    InvalidArgument = 2,
    /// A value is out of range or not a number.
    OutOfRange = 3,
    /// No stage, parameter or entry has this name or index.
    NotFound = 4,
    /// The matrix or bias of a calibration or mounting is invalid.
    InvalidCalibration = 5,
    /// Memory allocation failed.
    OutOfMemory = 6,
    /// The memory of the caller is too small or not aligned.
    InvalidMemory = 7,
    /// The snapshot is damaged or belongs to a filter with other stages.
    InvalidSnapshot = 8,
    /// A stage has failed permanently. The attitude no longer changes.
    StageFailed = 9,
}

impl PlumblineStatus {
    const TEXTS: [&CStr; 10] = [
        c"success",
        c"a pointer is null",
        c"an argument is not one of its constants, or a text is not UTF-8",
        c"a value is out of range or not a number",
        c"there is no stage, parameter or entry of this name or index",
        c"the matrix or bias of a calibration or mounting is invalid",
        c"memory allocation failed",
        c"the memory of the caller is too small or not aligned",
        c"the snapshot is damaged or belongs to a filter with other stages",
        c"a stage has failed permanently",
    ];

    /// Records a message for [`plumbline_error_message`] and returns the status.
    pub(crate) fn with(self, message: impl fmt::Display) -> Self {
        // No message can be stored while the thread-local storage is being destroyed.
        _ = MESSAGE.try_with(|text| {
            let mut text = text.borrow_mut();
            text.clear();
            // A message longer than the buffer is truncated.
            _ = write!(text, "{message}");
        });
        self
    }

    /// Returns the status of a result.
    pub(crate) fn of(result: Result<(), Self>) -> Self {
        result.err().unwrap_or(Self::Ok)
    }
}

impl From<BuildError> for PlumblineStatus {
    fn from(error: BuildError) -> Self {
        let status = match error {
            BuildError::OutOfRange { .. } => Self::OutOfRange,
            _ => Self::NotFound,
        };
        status.with(error)
    }
}

impl From<CalibrationError> for PlumblineStatus {
    fn from(error: CalibrationError) -> Self {
        Self::InvalidCalibration.with(error)
    }
}

impl From<SnapshotError> for PlumblineStatus {
    fn from(error: SnapshotError) -> Self {
        let status = match error {
            SnapshotError::BufferTooSmall { .. } => Self::InvalidMemory,
            _ => Self::InvalidSnapshot,
        };
        status.with(error)
    }
}

/// Size of the error message buffer in bytes, including the terminating zero. The longest message
/// names all parameters of a stage.
const MESSAGE_BYTES: usize = 4096;

thread_local! {
    static MESSAGE: RefCell<Text> = const { RefCell::new(Text { bytes: [0; MESSAGE_BYTES], len: 0 }) };
}

/// Zero-terminated text, truncated to the size of the buffer.
struct Text {
    bytes: [u8; MESSAGE_BYTES],
    len: usize,
}

impl Text {
    fn clear(&mut self) {
        self.len = 0;
        self.bytes[0] = 0;
    }
}

impl fmt::Write for Text {
    fn write_str(&mut self, part: &str) -> fmt::Result {
        let written = crate::text::write_text(part, &mut self.bytes[self.len..]);
        self.len += written;
        if written == part.len() { Ok(()) } else { Err(fmt::Error) }
    }
}

/// Returns a description of a status, in English. The text is static.
#[unsafe(no_mangle)]
pub extern "C" fn plumbline_status_text(status: u32) -> *const c_char {
    PlumblineStatus::TEXTS.get(status as usize).unwrap_or(&c"unknown status").as_ptr()
}

/// Returns the message of the newest error of the calling thread: cause, value found and remedy.
///
/// The text is valid until the next error of the thread. It is empty before the first error.
#[unsafe(no_mangle)]
pub extern "C" fn plumbline_error_message() -> *const c_char {
    MESSAGE.try_with(|text| text.borrow().bytes.as_ptr().cast()).unwrap_or(c"".as_ptr())
}
