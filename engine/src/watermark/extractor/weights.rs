//! What of an extractor belongs to one asset, its file, and what every extractor does alike.

use std::path::Path;
use std::sync::Arc;

use serde::Serialize;

use super::calibration::Calibration;
use super::content::ContentModel;
use super::rotation::KeyRotation;
use super::tmsd::TmsdWeights;
use crate::base::digest::Digest;
use crate::base::matrix::share_apart;
use crate::base::output::{AtomicFile, Existing};
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;
use crate::picture::known_views::{KnownViews, MOST_VIEWS, PLACEMENT_LEN, THUMBNAIL_LEN};
use crate::watermark::key::owner_key::Key;

/// `format` entry of an extractor file.
const FORMAT: &str = "guard4d.extractor/1";
/// Tensors of what tells where in a frame the asset is.
const THUMBNAILS: &str = "known_views.thumbnails";
const PLACEMENTS: &str = "known_views.placements";

/// Frames that the extractor sees at once (Guard4D Sec. 4: clips of eight frames).
pub const CLIP_FRAMES: usize = 8;

/// What happens to a frame before R, for receipts.
pub const PREPROCESS: &str = "resize: bilinear, antialiased, align_corners; squashed to CLIP's size; rgb in [0, 1]";

/// [`PREPROCESS`] of frames that are cut before.
const CUT: &str = "cut to the window that the 4 known views nearest to each frame say, mean of 97 frames";

/// The parts of an extractor that belong to one asset; private.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtractorWeights {
    /// How R was made.
    pub mode: ExtractorMode,
    /// R; `None` is the identity.
    pub tmsd: Option<TmsdWeights>,
    /// Map between image and text features.
    pub calibration: Calibration,
    /// Rotation that mixes the calibration's directions; its number is all that an extractor that is blind to the
    /// message can have of it.
    pub key_rotation: KeyRotation,
    /// What tells where in a frame the asset is, before all this; none where frames are shown whole.
    pub known_views: Option<Arc<KnownViews>>,
    /// What is taken off the features of each frame; nothing but the calibration's mean where there is none.
    pub content: Option<Arc<ContentModel>>,
}

impl ExtractorWeights {
    /// What happens to a frame before R, for receipts.
    #[must_use]
    pub fn preprocess(&self) -> String {
        match self.known_views {
            None => PREPROCESS.to_owned(),
            Some(_) => format!("{CUT}; {PREPROCESS}"),
        }
    }

    pub(super) fn file(&self, key: &Key) -> TensorFile {
        let mut file = TensorFile::default();
        let mode = serde_json::to_value(self.mode).ok().and_then(|v| v.as_str().map(str::to_owned));
        file.meta.insert("format".to_owned(), FORMAT.to_owned());
        file.meta.insert("mode".to_owned(), mode.expect("modes serialise as words"));
        file.meta.insert("key_id".to_owned(), key.prf().key_id().to_string());
        file.meta.insert("clip".to_owned(), key.clip.to_string());
        self.key_rotation.store(&mut file);
        if let Some(views) = &self.known_views {
            let thumbnails = Tensor::f32(&[views.len(), THUMBNAIL_LEN], views.thumbnails.clone());
            file.tensors.insert(THUMBNAILS.to_owned(), thumbnails);
            let placements = Tensor::f32(&[views.len(), PLACEMENT_LEN], views.placements.clone());
            file.tensors.insert(PLACEMENTS.to_owned(), placements);
        }
        if let Some(content) = &self.content {
            content.store(&mut file);
        }
        self.calibration.store(&mut file, key.bits());
        if let Some(tmsd) = &self.tmsd {
            tmsd.store(&mut file);
        }
        file
    }

    /// Hash of the file that [`ExtractorWeights::write`] writes.
    ///
    /// # Errors
    /// When a tensor's shape does not fit its values.
    pub fn digest(&self, key: &Key) -> Result<Digest, EngineError> {
        Ok(Digest::of(&self.file(key).to_bytes()?))
    }

    /// Writes the extractor, whole or not at all.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] or [`EngineError::Io`] naming the file.
    pub fn write(&self, path: &Path, key: &Key, existing: Existing) -> Result<(), EngineError> {
        AtomicFile::write_private(path, existing, &self.file(key).to_bytes()?)
    }

    /// Reads an extractor that belongs to `key`. A file that calls itself blind to the message is refused if its R does
    /// what only a trained network does: it may have been trained to say the message.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming what does not fit.
    pub fn read(path: &Path, key: &Key) -> Result<Self, EngineError> {
        let file = TensorFile::read(path)?;
        file.expect_text("format", FORMAT)?;
        file.expect_text("key_id", &key.prf().key_id().to_string())?;
        file.expect_text("clip", &key.clip.to_string())?;
        let word = file.text("mode")?;
        let mode = serde_json::from_value(word.into()).map_err(|e| EngineError::BadData {
            path: path.to_owned(),
            field: "mode".to_owned(),
            got: e.to_string(),
            expected: "none, blind, pretrained or joint".to_owned(),
        })?;
        let tmsd = TmsdWeights::load(&file)?;
        check_blindness(&file, mode, tmsd.as_ref())?;
        let calibration = Calibration::load(&file, key.text_mean.len(), key.bits())?;
        let content = ContentModel::load(&file, key.text_mean.len())?.map(Arc::new);
        let (key_rotation, known_views) = (KeyRotation::load(&file)?, known_views(&file)?);
        Ok(Self { mode, tmsd, calibration, key_rotation, known_views, content })
    }
}

/// How far one extractor is from another in each part that is fitted to an asset, as a share of the other's size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Deviation {
    /// Of the colour map; 0 where neither has one.
    pub colour_map: f64,
    /// Of the mean image feature.
    pub mean_image: f64,
    /// Of the directions.
    pub directions: f64,
    /// Of the mean logits.
    pub mean_logits: f64,
    /// Of the known views; 0 where neither has any.
    pub known_views: f64,
    /// Of what is foretold; 0 where neither foretells anything.
    pub content: f64,
}

impl ExtractorWeights {
    /// How far this is from `other` of the same shape. NaN or infinite for another shape, and for values that are no
    /// numbers.
    #[must_use]
    pub fn deviation(&self, other: &Self) -> Deviation {
        let (own, known) = (&self.calibration, &other.calibration);
        let map = |weights: &Self| weights.tmsd.as_ref().map(|tmsd| tmsd.colour_map.as_flattened().to_vec());
        Deviation {
            colour_map: of_both(&map(self), &map(other), |own, known| share_apart(own, known)),
            mean_image: share_apart(&own.mean_image, &known.mean_image),
            directions: share_apart(&own.directions, &known.directions),
            mean_logits: share_apart(&own.mean_logits, &known.mean_logits),
            known_views: of_both(&self.known_views, &other.known_views, |own, known| own.share_apart(known)),
            content: of_both(&self.content, &other.content, |own, known| own.share_apart(known)),
        }
    }

    /// How many numbers of it were fitted to the asset, and so could have been anything for whoever does not fit again.
    #[must_use]
    pub fn free_numbers(&self, knows_directions: bool) -> usize {
        let Calibration { mean_image, directions, mean_logits } = &self.calibration;
        // Known directions leave their common scale.
        let directions = if knows_directions { 1 } else { directions.len() };
        let colours = self.tmsd.as_ref().map_or(0, |tmsd| tmsd.colour_map.as_flattened().len());
        let views = self.known_views.as_ref().map_or(0, |views| views.thumbnails.len() + views.placements.len());
        let content = self.content.as_ref().map_or(0, |content| content.numbers());
        mean_image.len() + directions + mean_logits.len() + colours + views + content
    }
}

/// How far a part of one extractor is from that of another: infinite where only one of them has it.
fn of_both<T>(own: &Option<T>, known: &Option<T>, apart: impl Fn(&T, &T) -> f64) -> f64 {
    match (own, known) {
        (Some(own), Some(known)) => apart(own, known),
        (None, None) => 0.0,
        _ => f64::INFINITY,
    }
}

fn known_views(file: &TensorFile) -> Result<Option<Arc<KnownViews>>, EngineError> {
    let Some(tensor) = file.tensors.get(PLACEMENTS) else { return Ok(None) };
    let views = tensor.shape.first().copied().unwrap_or(0);
    if !(1..=MOST_VIEWS).contains(&views) {
        return Err(file.bad(PLACEMENTS, &format!("{views} views"), &format!("1 to {MOST_VIEWS}")));
    }
    let thumbnails = file.finite(THUMBNAILS, &[views, THUMBNAIL_LEN])?.to_vec();
    let placements = file.finite(PLACEMENTS, &[views, PLACEMENT_LEN])?.to_vec();
    Ok(Some(Arc::new(KnownViews { thumbnails, placements })))
}

/// Refuses an R that its mode cannot have.
fn check_blindness(file: &TensorFile, mode: ExtractorMode, tmsd: Option<&TmsdWeights>) -> Result<(), EngineError> {
    let Some(tmsd) = tmsd else { return Ok(()) };
    let (got, expected) = match mode {
        ExtractorMode::Joint => return Ok(()),
        ExtractorMode::None => ("R", "none in an extractor of mode `none`".to_owned()),
        // A pretrained network would have to be a known one; so far there is none.
        ExtractorMode::Blind | ExtractorMode::Pretrained if tmsd.is_trained() => {
            let expected = format!("a colour map alone in an extractor of mode `{mode}`, which never saw a message");
            ("a trained network", expected)
        }
        ExtractorMode::Blind | ExtractorMode::Pretrained => return Ok(()),
    };
    Err(file.bad("tmsd", got, &expected))
}
