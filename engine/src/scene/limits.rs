//! Most of what a file may ask for. Each is far above what real files hold, so that a damaged or hostile one is told
//! apart before memory is taken for it.

use std::path::Path;

use crate::base::files::bad_data;
use crate::error::EngineError;

/// Most splats of a scene; the largest captures published have a tenth of that.
pub const MAX_SPLATS: usize = 1 << 26;

/// Fewest bytes that a splat takes in a compressed file. Real ones take 8 to 20.
pub const MIN_BYTES_PER_SPLAT: usize = 1;

/// Most pixels of a SOG texture for each splat. Textures are as wide as high, up to a row; small ones are rounded up.
pub const MAX_PIXELS_PER_SPLAT: usize = 2;

/// Pixels of a SOG texture that need no splats.
pub const MIN_MAX_PIXELS: usize = 1 << 14;

/// Most bytes of a SOG or glTF description; real ones have some 10 kB.
pub const MAX_JSON_BYTES: usize = 16 << 20;

/// Most moments of a sequence.
pub const MAX_MOMENTS: usize = 10_000;

/// Refuses a splat count that a file of `file_bytes` bytes cannot hold when each splat takes at least
/// `bytes_per_splat`.
///
/// # Errors
/// [`EngineError::BadData`] naming `field`.
pub(super) fn check_splats(
    path: &Path,
    field: &str,
    splats: usize,
    bytes_per_splat: usize,
    file_bytes: usize,
) -> Result<(), EngineError> {
    let room = file_bytes / bytes_per_splat;
    if (1..=room.min(MAX_SPLATS)).contains(&splats) {
        return Ok(());
    }
    let expected = format!("1 to {}, as {file_bytes} bytes have room for", room.min(MAX_SPLATS));
    Err(bad_data(path, field, splats, expected))
}
