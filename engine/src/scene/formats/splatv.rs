//! `.splatv` files (antimatter15/splaTV): moving splats as one texture of half floats, made from `SpacetimeGaussians`.

use std::path::{Path, PathBuf};

use half::f16;
use serde::Deserialize;

use super::bytes::{Bytes, f32_at};
use super::steps::dithered_byte;
use super::values::{coeffs_of_colours, log_scale, logit_of_byte, with_capacity};
use crate::base::files::bad_data;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, Gaussians, SH_FLOATS, Y0, check_coeffs, dc_of_colour};
use crate::scene::limits::{MAX_JSON_BYTES, check_splats};
use crate::scene::trajectories::{MOTION_FLOATS, Trajectories};

/// First four bytes: 0x674b, little-endian.
pub(super) const MAGIC: &[u8] = &[0x4B, 0x67, 0, 0];

/// Words of 32 bits for each splat: position, rotation, standard deviations, colour and opacity, then motion, turning
/// and time. Half floats stand two in a word.
const ROW_BYTES: usize = 64;
const ROTATION: usize = 12;
const SCALES: usize = 20;
const COLOUR: usize = 28;
const MOTION: usize = 32;
const OMEGA: usize = 52;
const TIME: usize = 60;

/// An entry of the description; others than the splats say nothing that is needed.
#[derive(Deserialize)]
struct Part {
    #[serde(rename = "type")]
    kind: String,
    size: usize,
}

/// A file of moving splats whose colours can be replaced.
#[derive(Clone, Debug)]
pub struct SplatvFile {
    path: PathBuf,
    bytes: Vec<u8>,
    /// Where the first splat is.
    start: usize,
    splats: usize,
}

impl SplatvFile {
    /// Takes over `bytes`, which came from `path`. Files may be shorter than their description says, as some converters
    /// write them: then they hold fewer splats.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a description that is none.
    pub fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, EngineError> {
        let mut rest = Bytes::new(path, &bytes);
        if rest.array::<4>("mark")? != *MAGIC {
            return Err(bad_data(path, "mark", "other bytes", "a .splatv file"));
        }
        let length = rest.count("length of the description")?;
        if length > MAX_JSON_BYTES {
            return Err(bad_data(path, "length of the description", length, format!("at most {MAX_JSON_BYTES}")));
        }
        let json = rest.take("description", length)?;
        let parts: Vec<Part> = crate::base::json::parse(path, "description", json, "a .splatv description")?;
        let start = 2 * size_of::<u32>() + length;
        let first = parts.first().filter(|part| part.kind == "splat");
        let declared = first.ok_or_else(|| bad_data(path, "description", "no splats first", "type `splat`"))?.size;
        let rows = declared.min(bytes.len() - start) / ROW_BYTES;
        // Zeros at the end fill up the last row of the texture.
        let is_used = |row: &[u8]| row.iter().any(|&byte| byte != 0);
        let splats = bytes[start..start + ROW_BYTES * rows].chunks_exact(ROW_BYTES).rposition(is_used);
        let splats = splats.map_or(0, |last| last + 1);
        check_splats(path, "splats", splats, ROW_BYTES, bytes.len())?;
        Ok(Self { path: path.to_path_buf(), bytes, start, splats })
    }

    /// The file's bytes as read.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Where the bytes came from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The splats, those with values that are not finite among them, and how they move.
    #[must_use]
    pub fn decode(&self) -> (Gaussians, Trajectories) {
        let mut gaussians = with_capacity(self.splats, 0);
        let mut paths = Trajectories::default();
        let rows = self.bytes[self.start..].chunks_exact(ROW_BYTES);
        for (row, sh_coeffs) in rows.zip(gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS)) {
            let half = |at: usize, i: usize| f16::from_le_bytes([row[at + 2 * i], row[at + 2 * i + 1]]).to_f32();
            gaussians.means.push(std::array::from_fn(|axis| f32_at(row, axis)));
            gaussians.quats.push(std::array::from_fn(|i| half(ROTATION, i)));
            gaussians.scales.push(std::array::from_fn(|i| log_scale(half(SCALES, i))));
            for (coeff, byte) in sh_coeffs.iter_mut().zip(&row[COLOUR..COLOUR + CHANNELS]) {
                *coeff = dc_of_colour(f32::from(*byte) / 255.0);
            }
            gaussians.opacities.push(logit_of_byte(row[COLOUR + CHANNELS]));
            paths.motion.push(std::array::from_fn::<_, MOTION_FLOATS, _>(|i| half(MOTION, i)));
            paths.omega.push(std::array::from_fn(|i| half(OMEGA, i)));
            paths.centres.push(half(TIME, 0));
            // Durations beyond the largest half float are those of splats that never fade.
            let duration = half(TIME, 1);
            let duration = if duration == f32::INFINITY { f16::MAX.to_f32() } else { duration };
            paths.log_durations.push(log_scale(duration));
        }
        (gaussians, paths)
    }

    /// The colour bytes of the splats `rows`, or of all, as words.
    #[must_use]
    pub fn words(&self, rows: Option<&[u32]>) -> Vec<u32> {
        let count = rows.map_or(self.splats, <[u32]>::len);
        let colours = (0..count).flat_map(|index| &self.bytes[self.place(rows, index)..][..CHANNELS]);
        colours.map(|byte| u32::from(*byte)).collect()
    }

    /// The words that DC terms `[rows,16,3]` are stored as, dithered between the two nearest colours.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for coefficients that do not fit.
    pub fn words_of(&self, rows: Option<&[u32]>, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        check_coeffs(rows.map_or(self.splats, <[u32]>::len), 0, sh_coeffs)?;
        let steps = |dc: f32| narrow(255.0 * (0.5 + Y0 * f64::from(dc)));
        let splats = sh_coeffs.chunks_exact(SH_FLOATS).enumerate();
        Ok(splats.flat_map(|(row, c)| (0..CHANNELS).map(move |i| dithered_byte(steps(c[i]), row, i).into())).collect())
    }

    /// The file with other words in the places of [`SplatvFile::words`].
    #[must_use]
    pub fn with_words(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        for (index, splat) in words.chunks_exact(CHANNELS).enumerate() {
            let at = self.place(rows, index);
            for (byte, word) in bytes[at..at + CHANNELS].iter_mut().zip(splat) {
                *byte = word.to_le_bytes()[0];
            }
        }
        bytes
    }

    /// The coefficients `[rows,16,3]` that words are read as.
    #[must_use]
    pub fn coeffs_of(words: &[u32]) -> Vec<f32> {
        coeffs_of_colours(words)
    }

    /// Number of splats.
    #[must_use]
    pub fn splats(&self) -> usize {
        self.splats
    }

    /// Where the colour of the `index`-th of `rows` is.
    fn place(&self, rows: Option<&[u32]>, index: usize) -> usize {
        self.start + ROW_BYTES * rows.map_or(index, |rows| rows[index] as usize) + COLOUR
    }
}
