//! Lengths and sizes as the wrappers of this family check and pass them.

use crate::error::KernelError;

/// Fails unless a buffer has exactly the length that its shape asks for.
pub(super) fn expect_len(
    kernel: &'static str,
    buffer: &'static str,
    got: usize,
    expected: usize,
    shape: &str,
) -> Result<(), KernelError> {
    if got == expected {
        Ok(())
    } else {
        Err(shape_error(kernel, buffer, format!("[{got}]"), format!("[{expected}] = {shape}")))
    }
}

/// Fails unless `value` is a positive multiple of `unit`.
pub(super) fn expect_multiple(
    kernel: &'static str,
    buffer: &'static str,
    value: usize,
    unit: usize,
) -> Result<(), KernelError> {
    if value > 0 && value.is_multiple_of(unit) {
        return Ok(());
    }
    Err(shape_error(kernel, buffer, value.to_string(), format!("a positive multiple of {unit}")))
}

pub(super) fn shape_error(kernel: &'static str, buffer: &'static str, got: String, expected: String) -> KernelError {
    KernelError::Shape { kernel, buffer, got, expected }
}

/// A size as push constant or grid axis; sizes beyond `u32` cannot be allocated in the first place.
pub(super) fn as_u32(value: usize) -> u32 {
    u32::try_from(value).unwrap_or(u32::MAX)
}

/// A size as a signed push constant, see [`as_u32`].
pub(super) fn as_i32(value: usize) -> i32 {
    i32::try_from(value).unwrap_or(i32::MAX)
}
