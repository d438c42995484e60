//! Sizes that cross the border between host and shader.
//!
//! Shape letters, used everywhere: `N` splats, `I` intersections, `H W` pixels, `F` frames,
//! `K` inner dimension or SH bases, `B T C` batch, tokens, channels, `L` message bits.

use crate::KernelError;

/// A length as shaders take it.
///
/// # Panics
/// Never for lengths of buffers: a device binds less than 2³² elements.
#[must_use]
pub fn dim(n: usize) -> u32 {
    u32::try_from(n).expect("device buffers hold fewer than 2^32 elements")
}

/// Refuses a buffer that is too short.
pub(crate) fn require_len(
    kernel: &'static str,
    buffer: &'static str,
    got: usize,
    at_least: usize,
) -> Result<(), KernelError> {
    if got >= at_least {
        return Ok(());
    }
    Err(KernelError::Shape { kernel, buffer, got: format!("[{got}]"), expected: format!("[{at_least}] or more") })
}
