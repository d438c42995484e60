//! `.splat` files: rows of 32 bytes without a head (antimatter15/splat, README).

use std::path::{Path, PathBuf};

use super::bytes::f32_at;
use super::steps::nearest_byte;
use super::values::{coeffs_of_colours, log_scale, logit_of_byte, with_capacity};
use crate::base::files::bad_data;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, Gaussians, SH_FLOATS, Y0, check_coeffs, dc_of_colour};
use crate::scene::limits::check_splats;

/// Position and standard deviations as floats, then colour, opacity and rotation as bytes.
const ROW_BYTES: usize = 32;
const COLOUR: usize = 24;
const ROTATION: usize = 28;

/// A file whose base colours can be replaced, rounded to the nearest of its steps: an offset of less than half a step
/// from one of them is lost. All other bytes stay as read.
#[derive(Clone, Debug)]
pub struct SplatFile {
    path: PathBuf,
    bytes: Vec<u8>,
}

impl SplatFile {
    /// Takes over `bytes`, which came from `path`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when the length is no whole number of rows.
    pub fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, EngineError> {
        check_length(path, &bytes)?;
        Ok(Self { path: path.to_path_buf(), bytes })
    }

    /// The splats, those with values that are not finite among them.
    #[must_use]
    pub fn decode(&self) -> Gaussians {
        gaussians_of(&self.bytes)
    }

    /// Where the bytes came from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file's bytes as read.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Number of splats.
    #[must_use]
    pub fn splats(&self) -> usize {
        self.bytes.len() / ROW_BYTES
    }

    /// The colour bytes of the splats `rows`, or of all, as words.
    #[must_use]
    pub fn words(&self, rows: Option<&[u32]>) -> Vec<u32> {
        let count = rows.map_or(self.splats(), <[u32]>::len);
        let colours = (0..count).flat_map(|index| &self.bytes[place(rows, index)..][..CHANNELS]);
        colours.map(|byte| u32::from(*byte)).collect()
    }

    /// The words that DC terms are stored as: the nearest colours.
    ///
    /// # Shapes
    /// in `sh_coeffs` \[rows,16,3\] coefficient-major
    ///
    /// # Errors
    /// [`EngineError::Usage`] for coefficients that do not fit.
    pub fn words_of(&self, rows: Option<&[u32]>, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        check_coeffs(rows.map_or(self.splats(), <[u32]>::len), 0, sh_coeffs)?;
        let word = |dc: &f32| nearest_byte(narrow(255.0 * (0.5 + Y0 * f64::from(*dc)))).into();
        Ok(sh_coeffs.chunks_exact(SH_FLOATS).flat_map(|splat| splat[..CHANNELS].iter().map(word)).collect())
    }

    /// The coefficients that words are read as.
    ///
    /// # Shapes
    /// out \[rows,16,3\] coefficient-major
    #[must_use]
    pub fn coeffs_of(words: &[u32]) -> Vec<f32> {
        coeffs_of_colours(words)
    }

    /// The file with other words in the places of [`SplatFile::words`].
    #[must_use]
    pub fn with_words(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        for (index, splat) in words.chunks_exact(CHANNELS).enumerate() {
            for (byte, word) in bytes[place(rows, index)..].iter_mut().zip(splat) {
                *byte = word.to_le_bytes()[0];
            }
        }
        bytes
    }
}

/// Where the colour of the `index`-th of `rows` is.
fn place(rows: Option<&[u32]>, index: usize) -> usize {
    ROW_BYTES * rows.map_or(index, |rows| rows[index] as usize) + COLOUR
}

/// Reads the splats. Colours have no SH behind the DC terms.
///
/// # Errors
/// Those of [`SplatFile::parse`].
pub fn decode(path: &Path, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    check_length(path, bytes)?;
    Ok(gaussians_of(bytes))
}

fn check_length(path: &Path, bytes: &[u8]) -> Result<(), EngineError> {
    if !bytes.len().is_multiple_of(ROW_BYTES) {
        let expected = format!("a multiple of {ROW_BYTES}, the bytes of a splat");
        return Err(bad_data(path, "length", bytes.len(), expected));
    }
    check_splats(path, "splats", bytes.len() / ROW_BYTES, ROW_BYTES, bytes.len())
}

fn gaussians_of(bytes: &[u8]) -> Gaussians {
    let mut gaussians = with_capacity(bytes.len() / ROW_BYTES, 0);
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
    gaussians
}
