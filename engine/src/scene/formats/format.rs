//! Which format a splat file has: that is told by its content, never by its name alone.
//!
//! What such files store in whole numbers comes in as the value in the middle of the step.

use std::fmt;
use std::path::Path;

use super::bytes::GZIP;
use super::{glb, sog, splat, splatv, spz};
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::gaussians::Gaussians;
use crate::scene::ply;

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
            Self::Ply => Ok(ply::encode(gaussians)),
            Self::Glb => glb::encode(path, gaussians),
            Self::Spz => spz::encode(path, gaussians),
        }
    }
}

/// Names of what [`Format::recognise`] knows, for messages.
pub const KNOWN: &str = "PLY, compressed PLY, .splat, SPZ, SOG, .splatv or KHR_gaussian_splatting GLB";

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
            return Ok(if ply::is_compressed(bytes) { Self::CompressedPly } else { Self::Ply });
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
pub(in crate::scene) fn import(path: &Path, format: Format, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    match format {
        Format::CompressedPly => ply::decode_compressed(path, bytes),
        Format::Splat => splat::decode(path, bytes),
        Format::Spz => spz::decode(path, bytes),
        Format::Sog => sog::decode(path, bytes),
        Format::Ply | Format::Splatv | Format::Glb => unreachable!("{format} files are opened by their own types"),
    }
}
