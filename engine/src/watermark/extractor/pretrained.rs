//! The pretrained extractor: made once from random scenes and random messages, then frozen, the same for all owners and
//! assets.

use std::path::Path;

use super::tmsd::TmsdWeights;
use crate::base::digest::Digest;
use crate::base::output::{AtomicFile, Existing};
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;
use crate::watermark::key::owner_key::Key;

/// `format` entry of a pretrained extractor's file.
const FORMAT: &str = "guard4d.general/1";
/// What errors call the one inside the program.
const BUILT_IN: &str = "the built-in pretrained extractor";

/// R, and the directions of CLIP's image space in which offsets move a clip behind it. Nothing of an owner or of an
/// owner's scene is in it.
#[derive(Clone, Debug, PartialEq)]
pub struct PretrainedExtractor {
    /// CLIP checkpoint that it was made for.
    pub clip: Digest,
    /// R; its colour map is the identity, for each asset brings its own.
    pub tmsd: TmsdWeights,
    /// Image directions `[D, B]`, the one that tells offsets from content best first.
    pub directions: Vec<f32>,
    /// `B`: bits of the longest message that it reads.
    pub most_bits: usize,
    /// Least variance that content counts as having along a direction of length 1, see [`super::scatter::Scatter`].
    pub least_content: f64,
    /// The command that made it.
    pub made_by: String,
}

impl PretrainedExtractor {
    /// The one inside the program, for the CLIP inside the program.
    ///
    /// # Errors
    /// [`EngineError::BadData`]; not with the file of this program.
    pub fn built_in() -> Result<Self, EngineError> {
        let bytes = include_bytes!("../../../assets/pretrained.safetensors");
        Self::of_file(&TensorFile::from_bytes(Path::new(BUILT_IN), bytes)?)
    }

    /// The one in a file, or without a file the built-in one.
    ///
    /// # Errors
    /// Those of [`PretrainedExtractor::read`].
    pub fn open(path: Option<&Path>) -> Result<Self, EngineError> {
        path.map_or_else(Self::built_in, Self::read)
    }

    /// Refuses a key of another CLIP checkpoint.
    pub(crate) fn check_key(&self, key: &Key) -> Result<(), EngineError> {
        if self.clip == key.clip {
            return Ok(());
        }
        Err(EngineError::Usage {
            what: "pretrained extractor".to_owned(),
            got: format!("one for the CLIP checkpoint {}", self.clip),
            expected: format!("one for {}, which the key was made with", key.clip),
        })
    }

    fn file(&self) -> TensorFile {
        let mut file = TensorFile::default();
        file.meta.insert("format".to_owned(), FORMAT.to_owned());
        file.meta.insert("clip".to_owned(), self.clip.to_string());
        file.meta.insert("made_by".to_owned(), self.made_by.clone());
        self.tmsd.store(&mut file);
        let shape = [self.directions.len() / self.most_bits.max(1), self.most_bits];
        let directions = Tensor::f32(&shape, self.directions.clone());
        file.tensors.insert("directions".to_owned(), directions);
        file.meta.insert("least_content".to_owned(), self.least_content.to_string());
        file
    }

    /// Hash of the file that [`PretrainedExtractor::write`] writes.
    ///
    /// # Errors
    /// When a tensor's shape does not fit its values.
    pub fn digest(&self) -> Result<Digest, EngineError> {
        Ok(Digest::of(&self.file().to_bytes()?))
    }

    /// Writes the extractor, whole or not at all.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] or [`EngineError::Io`] naming the file.
    pub fn write(&self, path: &Path, existing: Existing) -> Result<(), EngineError> {
        AtomicFile::write(path, existing, &self.file().to_bytes()?)
    }

    /// Reads an extractor.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming what does not fit.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        Self::of_file(&TensorFile::read(path)?)
    }

    fn of_file(file: &TensorFile) -> Result<Self, EngineError> {
        file.expect_text("format", FORMAT)?;
        let clip = file.text("clip")?;
        let clip = Digest::from_hex(clip).ok_or_else(|| file.bad("clip", clip, "a hash"))?;
        let tmsd = TmsdWeights::load(file)?.ok_or_else(|| file.bad("tmsd", "nothing", "a network"))?;
        let least = file.text("least_content")?;
        let least_content = least.parse().ok().filter(|least: &f64| least.is_finite() && *least >= 0.0);
        let least_content = least_content.ok_or_else(|| file.bad("least_content", least, "a number of at least 0"))?;
        let shape = file.get("directions")?.shape.clone();
        let [_, most_bits] = shape[..] else {
            return Err(file.bad("directions", &format!("{shape:?}"), "[features, bits]"));
        };
        let directions = file.finite("directions", &shape)?.to_vec();
        Ok(Self { clip, tmsd, directions, most_bits, least_content, made_by: file.text("made_by")?.to_owned() })
    }
}
