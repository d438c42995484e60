//! Splat files of other tools: what they are is told by their content, never by their name alone.
//!
//! Each module reads one container into [`Gaussians`]. What such files store in whole numbers comes in as the value in
//! the middle of the step. [`glb`] and [`splatv`] also write new colours in place.

use std::fmt;
use std::path::Path;

use super::gaussians::{CHANNELS, Gaussians, SH_FLOATS, sh_bases};
use super::{bad_data, narrow};
use crate::error::EngineError;

mod archive;
mod bytes;
pub mod glb;
pub mod sog;
pub mod splat;
pub mod splatv;
pub mod spz;
mod steps;

use bytes::Bytes;

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// PLY with a property for each value, as trainers write it.
    Ply,
    /// PLY of packed splats in chunks (`SuperSplat`).
    CompressedPly,
    /// Rows of 32 bytes (antimatter15).
    Splat,
    /// Columns of packed values (Niantic Labs).
    Spz,
    /// Textures and codebooks in a ZIP archive (`PlayCanvas`).
    Sog,
    /// Moving splats as a texture (splaTV).
    Splatv,
    /// glTF binary with `KHR_gaussian_splatting`.
    Glb,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => "PLY",
            Self::CompressedPly => "compressed PLY",
            Self::Splat => ".splat",
            Self::Spz => "SPZ",
            Self::Sog => "SOG",
            Self::Splatv => ".splatv",
            Self::Glb => "glTF binary",
        })
    }
}

/// What a scene, or a moment of it, can be written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Export {
    /// Floats for every value, as trainers write them.
    Ply,
    /// glTF binary with `KHR_gaussian_splatting`; floats for every coefficient.
    Glb,
    /// Packed values: a colour has 255 steps, and so has every coefficient.
    Spz,
}

impl Export {
    const ALL: [Self; 3] = [Self::Ply, Self::Glb, Self::Spz];

    /// What a file of this name is to be.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for other extensions.
    pub fn of(path: &Path) -> Result<Self, EngineError> {
        let is_named = |export: &Self| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(export.extension()));
        Self::ALL.into_iter().find(is_named).ok_or_else(|| EngineError::Usage {
            what: "file to write".to_owned(),
            got: path.display().to_string(),
            expected: "a name that ends in .ply, .glb or .spz".to_owned(),
        })
    }

    /// Its extension.
    #[must_use]
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Glb => "glb",
            Self::Spz => "spz",
        }
    }

    /// Whether coefficients come through to the bit.
    #[must_use]
    pub const fn keeps_colours(self) -> bool {
        !matches!(self, Self::Spz)
    }

    /// The bytes of the file, which is to be at `path`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a scene that the format has no room for.
    pub fn encode(self, path: &Path, gaussians: &Gaussians) -> Result<Vec<u8>, EngineError> {
        match self {
            Self::Ply => Ok(super::ply::encode(gaussians)),
            Self::Glb => glb::encode(path, gaussians),
            Self::Spz => spz::encode(path, gaussians),
        }
    }
}

/// Names of what [`Format::recognise`] knows, for messages.
pub const KNOWN: &str = "PLY, compressed PLY, .splat, SPZ, SOG, .splatv or KHR_gaussian_splatting GLB";

const GZIP: &[u8] = &[0x1F, 0x8B];
const ZIP: &[u8] = b"PK\x03\x04";

impl Format {
    /// Tells what `bytes`, the content of the file at `path`, are. Only `.splat`, which has no mark, goes by its name.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for anything else.
    pub fn recognise(path: &Path, bytes: &[u8]) -> Result<Self, EngineError> {
        let is_named = |extension: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
        let starts = |mark: &[u8]| bytes.starts_with(mark);
        if starts(b"ply\n") || starts(b"ply\r\n") {
            return Ok(if super::ply::is_compressed(bytes) { Self::CompressedPly } else { Self::Ply });
        }
        match () {
            () if starts(GZIP) || starts(spz::MAGIC) => Ok(Self::Spz),
            () if starts(ZIP) => Ok(Self::Sog),
            () if starts(glb::MAGIC) => Ok(Self::Glb),
            () if starts(splatv::MAGIC) => Ok(Self::Splatv),
            () if is_named("splat") => Ok(Self::Splat),
            // Whatever is named so should be told what is wrong with its head.
            () if is_named("ply") => Ok(Self::Ply),
            () => {
                let start = &bytes[..bytes.len().min(4)];
                let got = if start.is_empty() { "an empty file".to_owned() } else { format!("bytes {start:02x?} …") };
                Err(bad_data(path, "start of file", got, KNOWN))
            }
        }
    }
}

/// Reads a file whose colours are not replaced in place: any [`Format`] but PLY, glTF and .splatv.
///
/// # Errors
/// [`EngineError::BadData`] naming the field that is wrong.
pub(super) fn import(path: &Path, format: Format, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    match format {
        Format::CompressedPly => super::ply::decode_compressed(path, bytes),
        Format::Splat => splat::decode(path, bytes),
        Format::Spz => spz::decode(path, bytes),
        Format::Sog => sog::decode(path, bytes),
        Format::Ply | Format::Splatv | Format::Glb => unreachable!("{format} files are opened by their own types"),
    }
}

/// Room for `splats` splats.
pub(super) fn with_capacity(splats: usize, sh_degree: u32) -> Gaussians {
    Gaussians {
        means: Vec::with_capacity(splats),
        quats: Vec::with_capacity(splats),
        scales: Vec::with_capacity(splats),
        opacities: Vec::with_capacity(splats),
        sh_coeffs: vec![0.0; splats * SH_FLOATS],
        sh_degree,
    }
}

/// Floats of SH behind the DC terms that a splat of this degree has.
pub(super) const fn rest_floats(sh_degree: u32) -> usize {
    (sh_bases(sh_degree) - 1) * CHANNELS
}

/// Logit of an opacity 0 to 1 that was stored in steps of 1/255. The ends, whose logit is infinite, are taken half a step
/// further in: below what is drawn at all (1/255), above what is drawn at most (0.99).
pub(super) fn logit(opacity: f32) -> f32 {
    const HALF_STEP: f64 = 0.5 / 255.0;
    let p = f64::from(opacity).clamp(HALF_STEP, 1.0 - HALF_STEP);
    narrow((p / (1.0 - p)).ln())
}

/// Logit of a byte.
pub(super) fn logit_of_byte(byte: u8) -> f32 {
    logit(f32::from(byte) / 255.0)
}

/// Natural logarithm of a standard deviation; 0, which flat splats have, becomes the least that is told from it.
pub(super) fn log_scale(scale: f32) -> f32 {
    const LEAST: f32 = 1e-12;
    if scale == 0.0 { LEAST.ln() } else { scale.ln() }
}

/// The quaternion w, x, y, z whose component `largest` was left out for being the largest and positive; `others` are the
/// remaining ones in order.
pub(super) fn with_largest(largest: usize, others: [f32; 3]) -> [f32; 4] {
    let squares: f32 = others.iter().map(|v| v * v).sum();
    let mut rest = others.into_iter();
    std::array::from_fn(|i| match i == largest {
        true => (1.0 - squares).max(0.0).sqrt(),
        false => rest.next().unwrap_or_default(),
    })
}
