//! Access to the memory of the caller.

use core::ffi::{CStr, c_char};

use crate::PlumblineStatus;

/// Returns the object at `pointer`.
///
/// # Safety
///
/// The pointer is null, or valid for reads of a `T` that nothing writes during `'a`.
pub(crate) unsafe fn shared<'a, T>(pointer: *const T, name: &str) -> Result<&'a T, PlumblineStatus> {
    // SAFETY: required of the caller.
    unsafe { pointer.as_ref() }.ok_or_else(|| null(name))
}

/// Returns the object at `pointer`.
///
/// # Safety
///
/// The pointer is null, or valid for reads and writes of a `T` that nothing else uses during `'a`.
pub(crate) unsafe fn exclusive<'a, T>(pointer: *mut T, name: &str) -> Result<&'a mut T, PlumblineStatus> {
    // SAFETY: required of the caller.
    unsafe { pointer.as_mut() }.ok_or_else(|| null(name))
}

/// Returns the `N` numbers at `pointer`.
///
/// # Safety
///
/// The pointer is null, or valid for reads of `N` numbers.
pub(crate) unsafe fn numbers<const N: usize>(pointer: *const f64, name: &str) -> Result<[f64; N], PlumblineStatus> {
    // SAFETY: required of the caller; an array has the alignment of its elements.
    unsafe { shared(pointer.cast::<[f64; N]>(), name) }.copied()
}

/// Writes `value` to `pointer` unless it is null. The memory need not be initialised.
///
/// # Safety
///
/// The pointer is null, or valid for writes of a `T`.
pub(crate) unsafe fn write<T>(pointer: *mut T, value: T) {
    if !pointer.is_null() {
        // SAFETY: required of the caller.
        unsafe { pointer.write(value) };
    }
}

/// Returns the text at `pointer`.
///
/// # Safety
///
/// The pointer is null, or the text ends with a zero byte and does not change during `'a`.
pub(crate) unsafe fn text<'a>(pointer: *const c_char, name: &str) -> Result<&'a str, PlumblineStatus> {
    // SAFETY: required of the caller.
    let pointer = unsafe { shared(pointer, name) }?;
    // SAFETY: required of the caller.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|error| PlumblineStatus::InvalidArgument.with(format_args!("{name} is not UTF-8: {error}")))
}

/// Returns the message about a null pointer.
pub(crate) fn null(name: &str) -> PlumblineStatus {
    PlumblineStatus::NullPointer.with(format_args!("{name} is null"))
}
