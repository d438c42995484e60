//! A file of splats as it lies on disk, and the way of new colours into a copy of it.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::formats::glb::GlbFile;
use super::formats::sog::SogFile;
use super::formats::splat::SplatFile;
use super::formats::splatv::SplatvFile;
use super::formats::spz::SpzFile;
use super::gaussians::{CHANNELS, Gaussians};
use super::trajectories::Trajectories;
use crate::base::files::{bad_data, read_file};
use crate::error::EngineError;
use crate::scene::formats::{Format, import};
use crate::scene::ply::{CompressedPlyFile, PlyFile, encode};

/// Splats with the file that they came from.
#[derive(Clone, Debug)]
pub struct SplatSource {
    file: File,
    /// What the file was before it came in, when that is another format.
    format: Format,
    /// Rows of the file that are used, ascending, when that is not all of them.
    kept: Option<Vec<u32>>,
}

/// Files whose colours are replaced in place.
#[derive(Clone, Debug)]
enum File {
    Ply(Box<PlyFile>),
    Glb(GlbFile),
    Splatv(SplatvFile),
    Spz(Box<SpzFile>),
    Splat(SplatFile),
    CompressedPly(Box<CompressedPlyFile>),
    Sog(Box<SogFile>),
}

impl File {
    /// Reads a file of a format that is written in kind only when asked for, and its splats.
    fn rounding(path: &Path, format: Format, bytes: Vec<u8>) -> Result<(Self, Gaussians), EngineError> {
        Ok(match format {
            Format::Spz => {
                let file = SpzFile::parse(path, &bytes)?;
                let gaussians = file.decode();
                (Self::Spz(Box::new(file)), gaussians)
            }
            Format::Splat => {
                let file = SplatFile::parse(path, bytes)?;
                let gaussians = file.decode();
                (Self::Splat(file), gaussians)
            }
            Format::CompressedPly => {
                let file = CompressedPlyFile::parse(path, bytes)?;
                let gaussians = file.decode();
                (Self::CompressedPly(Box::new(file)), gaussians)
            }
            Format::Sog => {
                let file = SogFile::parse(path, bytes)?;
                let gaussians = file.decode();
                (Self::Sog(Box::new(file)), gaussians)
            }
            Format::Ply | Format::Splatv | Format::Glb => unreachable!("{format} files are always written in kind"),
        })
    }
}

/// What a file held.
#[derive(Clone, Debug)]
pub(super) struct Opened {
    pub(super) source: SplatSource,
    pub(super) gaussians: Gaussians,
    pub(super) trajectories: Option<Trajectories>,
    pub(super) warnings: Vec<String>,
}

impl SplatSource {
    /// Reads the file at `path`. Splats that cannot be drawn ([`Gaussians::is_sound`]) are left out, and counted in
    /// a warning; a copy with new colours has them untouched.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`]; [`EngineError::BadData`] naming the field that is wrong, or
    /// when no splat is left.
    pub(super) fn open(path: &Path) -> Result<Opened, EngineError> {
        Self::parse(path, read_file(path, "a file of Gaussian splats")?)
    }

    /// Reads a file whose copies are to be of its own format, also where that rounds colours: SPZ, SOG, compressed PLY
    /// and .splat. Others are read as ever.
    ///
    /// # Errors
    /// As [`SplatSource::open`].
    pub(super) fn open_in_kind(path: &Path) -> Result<Opened, EngineError> {
        Self::parse_as(path, read_file(path, "a file of Gaussian splats")?, true)
    }

    /// Takes over `bytes`, which came from `path`.
    ///
    /// # Errors
    /// As [`SplatSource::open`].
    pub(super) fn parse(path: &Path, bytes: Vec<u8>) -> Result<Opened, EngineError> {
        Self::parse_as(path, bytes, false)
    }

    fn parse_as(path: &Path, bytes: Vec<u8>, in_kind: bool) -> Result<Opened, EngineError> {
        let format = Format::recognise(path, &bytes)?;
        let mut warnings = Vec::new();
        let (file, gaussians, trajectories) = match format {
            Format::Ply => {
                let file = PlyFile::parse(path, bytes)?;
                let (gaussians, trajectories) = (file.decode()?, file.trajectories()?);
                (File::Ply(Box::new(file)), gaussians, trajectories)
            }
            Format::Glb => {
                let file = GlbFile::parse(path, bytes)?;
                warnings.extend_from_slice(file.warnings());
                let gaussians = file.decode()?;
                (File::Glb(file), gaussians, None)
            }
            Format::Splatv => {
                let file = SplatvFile::parse(path, bytes)?;
                let (gaussians, trajectories) = file.decode();
                (File::Splatv(file), gaussians, Some(trajectories))
            }
            _ if in_kind => {
                let (file, gaussians) = File::rounding(path, format, bytes)?;
                (file, gaussians, None)
            }
            _ => {
                let gaussians = import(path, format, &bytes)?;
                let file = PlyFile::parse(&as_ply(path), encode(&gaussians))?;
                warnings.push(format!("{}: {format} keeps colours coarsely; a copy is written as PLY", path.display()));
                (File::Ply(Box::new(file)), gaussians, None)
            }
        };
        let mut opened = Opened { source: Self { file, format, kept: None }, gaussians, trajectories, warnings };
        opened.leave_out_broken(path)?;
        Ok(opened)
    }

    /// The format of the file that was read.
    #[must_use]
    pub const fn format(&self) -> Format {
        self.format
    }

    /// Whether copies are written in another format than was read.
    #[must_use]
    pub const fn is_imported(&self) -> bool {
        matches!(self.file, File::Ply(_)) && !matches!(self.format, Format::Ply)
    }

    /// What the file says about itself: comments, makers and rights.
    #[must_use]
    pub fn comments(&self) -> &[String] {
        match &self.file {
            File::Ply(file) => file.comments(),
            File::Glb(file) => file.comments(),
            File::CompressedPly(file) => file.comments(),
            File::Splatv(_) | File::Spz(_) | File::Splat(_) | File::Sog(_) => &[],
        }
    }

    /// Where the file is; for one of a format that is not written, where a PLY of it would be.
    #[must_use]
    pub fn path(&self) -> &Path {
        match &self.file {
            File::Ply(file) => file.path(),
            File::Glb(file) => file.path(),
            File::Splatv(file) => file.path(),
            File::Spz(file) => file.path(),
            File::Splat(file) => file.path(),
            File::CompressedPly(file) => file.path(),
            File::Sog(file) => file.path(),
        }
    }

    /// The bytes that a copy with the same colours has.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        match &self.file {
            File::Ply(file) => file.bytes(),
            File::Glb(file) => file.bytes(),
            File::Splatv(file) => file.bytes(),
            File::Spz(file) => file.bytes(),
            File::Splat(file) => file.bytes(),
            File::CompressedPly(file) => file.bytes(),
            File::Sog(file) => file.bytes(),
        }
    }

    /// Rows of the file.
    #[must_use]
    pub fn rows(&self) -> usize {
        match &self.file {
            File::Ply(file) => file.len(),
            File::Glb(file) => file.splats(),
            File::Splatv(file) => file.splats(),
            File::Spz(file) => file.splats(),
            File::Splat(file) => file.splats(),
            File::CompressedPly(file) => file.splats(),
            File::Sog(file) => file.splats(),
        }
    }

    /// Whether the same rows are used as of another file.
    pub(super) fn has_rows_of(&self, other: &Self) -> bool {
        self.kept == other.kept
    }

    /// Whether colours are stored as plain RGB, so that an offset acts on these.
    #[must_use]
    pub fn is_rgb(&self) -> bool {
        match &self.file {
            File::Ply(file) => file.is_rgb(),
            File::Glb(_) | File::Spz(_) | File::Splat(_) | File::CompressedPly(_) | File::Sog(_) => false,
            File::Splatv(_) => true,
        }
    }

    /// The words that hold the colours.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for files that cannot be written in place: ASCII ones and those with doubles.
    pub fn words(&self) -> Result<Vec<u32>, EngineError> {
        let rows = self.kept.as_deref();
        match &self.file {
            File::Ply(file) => file.words(rows),
            File::Glb(file) => Ok(file.words(rows)),
            File::Splatv(file) => Ok(file.words(rows)),
            File::Spz(file) => Ok(file.words(rows)),
            File::Splat(file) => Ok(file.words(rows)),
            File::CompressedPly(file) => Ok(file.words(rows)),
            File::Sog(file) => Ok(file.words(rows)),
        }
    }

    /// How many words [`SplatSource::words`] has, without reading them.
    ///
    /// # Errors
    /// As [`SplatSource::words`].
    pub fn num_words(&self) -> Result<usize, EngineError> {
        let rows = self.kept.as_ref().map_or(self.rows(), Vec::len);
        match &self.file {
            File::Ply(file) => Ok(rows * file.words_per_splat()?),
            File::Glb(file) => Ok(file.num_words(self.kept.as_deref())),
            File::Splatv(_) | File::Splat(_) | File::CompressedPly(_) | File::Sog(_) => Ok(rows * CHANNELS),
            File::Spz(file) => Ok(rows * file.words_per_splat()),
        }
    }

    /// The words that coefficients are stored as.
    ///
    /// # Shapes
    /// in `sh_coeffs` \[N,16,3\] coefficient-major
    ///
    /// # Errors
    /// As [`SplatSource::words`]; [`EngineError::Usage`] for coefficients that do not fit the file.
    pub fn words_of(&self, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        let rows = self.kept.as_deref();
        match &self.file {
            File::Ply(file) => file.words_of(rows, sh_coeffs),
            File::Glb(file) => file.words_of(rows, sh_coeffs),
            File::Splatv(file) => file.words_of(rows, sh_coeffs),
            File::Spz(file) => file.words_of(rows, sh_coeffs),
            File::Splat(file) => file.words_of(rows, sh_coeffs),
            File::CompressedPly(file) => file.words_of(rows, sh_coeffs),
            File::Sog(file) => file.words_of(rows, sh_coeffs),
        }
    }

    /// The coefficients that words are read as: those that were stored, as far as the file has room for them.
    ///
    /// # Shapes
    /// out \[N,16,3\]
    #[must_use]
    pub fn coeffs_of(&self, words: &[u32]) -> Vec<f32> {
        match &self.file {
            File::Ply(file) => file.coeffs_of(words),
            File::Glb(file) => file.coeffs_of(self.kept.as_deref(), words),
            File::Splatv(_) => SplatvFile::coeffs_of(words),
            File::Spz(file) => file.coeffs_of(words),
            File::Splat(_) => SplatFile::coeffs_of(words),
            File::CompressedPly(file) => file.coeffs_of(self.kept.as_deref(), words),
            File::Sog(file) => file.coeffs_of(self.kept.as_deref(), words),
        }
    }

    /// The file with other words for its colours; every other byte stays as read.
    #[must_use]
    pub fn with_words(&self, words: &[u32]) -> Vec<u8> {
        let rows = self.kept.as_deref();
        match &self.file {
            File::Ply(file) => file.with_words(rows, words),
            File::Glb(file) => file.with_words(rows, words),
            File::Splatv(file) => file.with_words(rows, words),
            File::Spz(file) => file.with_words(rows, words),
            File::Splat(file) => file.with_words(rows, words),
            File::CompressedPly(file) => file.with_words(rows, words),
            File::Sog(file) => file.with_words(rows, words),
        }
    }
}

impl Opened {
    fn leave_out_broken(&mut self, path: &Path) -> Result<(), EngineError> {
        let gaussians = &self.gaussians;
        let moves_soundly = |row: usize| self.trajectories.as_ref().is_none_or(|paths| paths.is_finite(row));
        let keep: Vec<bool> =
            (0..gaussians.len()).into_par_iter().map(|row| gaussians.is_sound(row) && moves_soundly(row)).collect();
        let kept = keep.iter().filter(|&&keep| keep).count();
        let broken = keep.len() - kept;
        if broken == 0 {
            return Ok(());
        }
        if kept == 0 {
            return Err(bad_data(
                path,
                "splats",
                format!("{broken}, all with values that are not finite"),
                "some to draw",
            ));
        }
        let splats = if broken == 1 { "splat" } else { "splats" };
        let share = format!("{broken} {splats} of {}", keep.len());
        self.warnings.push(format!("{}: {share} left out for values that are not finite", path.display()));
        let rows = (0_u32..).zip(&keep).filter(|(_, keep)| **keep).map(|(row, _)| row);
        self.source.kept = Some(rows.collect());
        self.gaussians.retain(&keep);
        if let Some(paths) = &mut self.trajectories {
            paths.retain(&keep);
        }
        Ok(())
    }
}

/// `name.ply` for `name.spz` and `name.compressed.ply`.
fn as_ply(path: &Path) -> PathBuf {
    let stem = path.with_extension("");
    let is_compressed = stem.extension().is_some_and(|e| e.eq_ignore_ascii_case("compressed"));
    if is_compressed { stem.with_extension("ply") } else { path.with_extension("ply") }
}
