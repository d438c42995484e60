//! `.splat` files: rows of 32 bytes without a head (antimatter15/splat, README).

use std::path::Path;

use super::bytes::f32_at;
use super::values::{log_scale, logit_of_byte, with_capacity};
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, Gaussians, SH_FLOATS, dc_of_colour};
use crate::scene::limits::check_splats;

/// Position and standard deviations as floats, then colour, opacity and rotation as bytes.
const ROW_BYTES: usize = 32;
const COLOUR: usize = 24;
const ROTATION: usize = 28;

/// Reads the splats. Colours have no SH behind the DC terms.
///
/// # Errors
/// [`EngineError::BadData`] when the length is no whole number of rows.
pub fn decode(path: &Path, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    if !bytes.len().is_multiple_of(ROW_BYTES) {
        let expected = format!("a multiple of {ROW_BYTES}, the bytes of a splat");
        return Err(bad_data(path, "length", bytes.len(), expected));
    }
    let count = bytes.len() / ROW_BYTES;
    check_splats(path, "splats", count, ROW_BYTES, bytes.len())?;
    let mut gaussians = with_capacity(count, 0);
    let rows = bytes.chunks_exact(ROW_BYTES).zip(gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS));
    for (row, sh_coeffs) in rows {
        gaussians.means.push(std::array::from_fn(|i| f32_at(row, i)));
        gaussians.scales.push(std::array::from_fn(|i| log_scale(f32_at(row, 3 + i))));
        for (coeff, byte) in sh_coeffs.iter_mut().zip(&row[COLOUR..COLOUR + CHANNELS]) {
            *coeff = dc_of_colour(f32::from(*byte) / 255.0);
        }
        gaussians.opacities.push(logit_of_byte(row[COLOUR + CHANNELS]));
        gaussians.quats.push(std::array::from_fn(|i| (f32::from(row[ROTATION + i]) - 128.0) / 128.0));
    }
    Ok(gaussians)
}
