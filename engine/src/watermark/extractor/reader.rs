//! Reading clips: 8-bit frames in, features and logits out.

use std::sync::Arc;

use guard4d_kernels::{Buffer, Device};

use super::calibration::Calibration;
use super::content::{ContentModel, Thumbnailer, take_off};
use super::features::{FeatureExtractor, NORMALIZATION};
use super::preprocess::Preprocessor;
use super::weights::{CLIP_FRAMES, ExtractorWeights};
use crate::base::digest::Digest;
use crate::error::EngineError;
use crate::media::Frame;
use crate::networks::clip::{ClipModel, TowerPurpose};
use crate::picture::known_views::KnownViews;
use crate::picture::part::Part;
use crate::picture::undo_guess::UndoGuess;
use crate::watermark::key::decoder::{Decoder, DecoderPass};
use crate::watermark::key::owner_key::{Key, digest_of};

/// Most frames of one clip that [`FeatureStream`] takes, each counted as often as guesses are undone: twelve hours at
/// 24 in a second, of which the features take 2 GiB at CLIP's 512 numbers a frame.
pub const MAX_FRAMES: usize = 1 << 20;

/// What an extractor sees in frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClipFeatures {
    /// Image features `[n, D]`, without what is foretold of them.
    pub features: Vec<f32>,
    /// Logits of the key's decoder `[n, L]`.
    pub logits: Vec<f32>,
}

impl ClipFeatures {
    /// Appends what was seen in further frames.
    pub fn extend(&mut self, more: &Self) {
        self.features.extend_from_slice(&more.features);
        self.logits.extend_from_slice(&more.logits);
    }
}

/// What `key` makes of features that an extractor has seen already: logits `[n, L]`.
///
/// # Errors
/// When the device fails.
pub fn decode(
    device: &Device,
    key: &Key,
    calibration: &Calibration,
    features: &[f32],
) -> Result<Vec<f32>, EngineError> {
    let decoder = Decoder::new(device, &calibration.fold(&key.decoder, &key.codes, &key.text_mean))?;
    let mut pass = decoder.pass(device, features.len() / key.text_mean.len())?;
    let input = device.buffer_from("decode.features", features)?;
    let mut rec = device.recorder()?;
    decoder.forward(&mut rec, &input, &mut pass)?;
    rec.submit()?;
    Ok(pass.logits.read()?)
}

/// Hash over everything that turns 8-bit frames into logits: what happens to frames before CLIP, R, CLIP, calibration,
/// codes and decoder.
///
/// These are hashed as they are stored, not as [`Calibration::fold`] puts them together, whose last bits differ between
/// processors.
///
/// # Errors
/// When a tensor's shape does not fit its values.
pub fn digest(key: &Key, weights: &ExtractorWeights) -> Result<Digest, EngineError> {
    let mut file = weights.file(key);
    key.store_reading(&mut file);
    let mut note = |name: &str, text: String| file.meta.insert(name.to_owned(), text);
    note("preprocess", weights.preprocess());
    note("frames", CLIP_FRAMES.to_string());
    note("normalization", format!("{:?} {:?}", NORMALIZATION.mean, NORMALIZATION.std));
    Ok(Digest::of(&file.to_bytes()?))
}

/// A ready extractor that reads 8-bit frames.
#[derive(Debug)]
pub struct Reader {
    device: Device,
    features: FeatureExtractor,
    decoder: Decoder,
    pass: DecoderPass,
    resized: Buffer<f32>,
    bits: usize,
    known_views: Option<Arc<KnownViews>>,
    foreteller: Option<Foreteller>,
}

impl Reader {
    /// Puts an extractor on the device.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when key and checkpoint do not belong together; when memory runs out.
    pub fn new(device: &Device, clip: &ClipModel, key: &Key, weights: &ExtractorWeights) -> Result<Self, EngineError> {
        if key.clip != digest_of(clip) {
            return Err(EngineError::Usage {
                what: "CLIP checkpoint".to_owned(),
                got: digest_of(clip).to_string(),
                expected: format!("{}, which the key was made with", key.clip),
            });
        }
        let features = FeatureExtractor::new(device, clip, weights.tmsd.as_ref(), 1, TowerPurpose::Features)?;
        let decoder = Decoder::new(device, &weights.calibration.fold(&key.decoder, &key.codes, &key.text_mean))?;
        let by = |model: &Arc<ContentModel>| Foreteller::new(device, Arc::clone(model), &features);
        let foreteller = weights.content.as_ref().map(by).transpose()?;
        Ok(Self {
            pass: decoder.pass(device, CLIP_FRAMES)?,
            resized: device.buffer("reader.resized", features.clip_len())?,
            device: device.clone(),
            features,
            decoder,
            bits: key.bits(),
            known_views: weights.known_views.clone(),
            foreteller,
        })
    }

    /// Logits of every frame `[n, L]`.
    ///
    /// # Errors
    /// Those of [`Reader::look`].
    pub fn logits(&mut self, frames: &[Frame]) -> Result<Vec<f32>, EngineError> {
        Ok(self.look(frames)?.logits)
    }

    /// Features and logits of every frame, seen in clips of [`CLIP_FRAMES`]; a last, shorter clip repeats its last
    /// frame, and the repetitions are not counted.
    ///
    /// # Errors
    /// [`EngineError::Usage`] without a frame or with frames of different sizes; when the device fails.
    pub fn look(&mut self, frames: &[Frame]) -> Result<ClipFeatures, EngineError> {
        let Some(first) = frames.first() else {
            return Err(EngineError::Usage {
                what: "clip".to_owned(),
                got: "no frame".to_owned(),
                expected: "at least one frame".to_owned(),
            });
        };
        let mut preprocessor = Preprocessor::new(&self.device, first, self.features.shape())?;
        let mut clip_features = ClipFeatures::default();
        let parts = self.parts(frames);
        for (number, chunk) in frames.chunks(CLIP_FRAMES).enumerate() {
            preprocessor.load(chunk)?;
            preprocessor.cut(&parts[number * CLIP_FRAMES..][..chunk.len()])?;
            self.see(&mut preprocessor, chunk.len(), UndoGuess::NONE, &mut clip_features)?;
        }
        Ok(clip_features)
    }

    /// What films are framed by before they are read; none where frames are shown whole.
    #[must_use]
    pub fn known_views(&self) -> Option<Arc<KnownViews>> {
        self.known_views.clone()
    }

    /// What of each of these frames is shown: they are of one film and one size.
    #[must_use]
    pub fn parts(&self, frames: &[Frame]) -> Vec<Part> {
        self.known_views.as_ref().map_or_else(|| vec![Part::All; frames.len()], |views| views.parts(frames))
    }

    /// Looks at frames that come one after the other, of which it holds no more than [`CLIP_FRAMES`], as often as there
    /// are guesses of what was done to them, each time with that guess undone. `parts` says what of each is shown; of
    /// frames beyond its end, all is.
    #[must_use]
    pub fn stream(&mut self, guesses: &[UndoGuess], parts: Vec<Part>) -> FeatureStream<'_> {
        let clip_features = guesses.iter().map(|&guess| (guess, ClipFeatures::default())).collect();
        FeatureStream { reader: self, preprocessor: None, waiting: Vec::new(), parts: parts.into_iter(), clip_features }
    }

    /// Appends what the first `frames` of the clip that was taken in show.
    fn see(
        &mut self,
        preprocessor: &mut Preprocessor,
        frames: usize,
        guess: UndoGuess,
        clip_features: &mut ClipFeatures,
    ) -> Result<(), EngineError> {
        let mut rec = self.device.recorder()?;
        preprocessor.show(&mut rec, guess, &mut self.resized)?;
        self.features.forward(&mut rec, &[&self.resized])?;
        let seen = match &mut self.foreteller {
            Some(foreteller) => {
                foreteller.thumbnailer.record(&mut rec, &self.resized)?;
                rec.submit()?;
                foreteller.take_off(self.features.features())?;
                rec = self.device.recorder()?;
                &foreteller.freed
            }
            None => self.features.features(),
        };
        self.decoder.forward(&mut rec, seen, &mut self.pass)?;
        rec.submit()?;
        let width = seen.len() / CLIP_FRAMES;
        clip_features.features.extend(seen.read_range(0..frames * width)?);
        clip_features.logits.extend(self.pass.logits.read_range(0..frames * self.bits)?);
        Ok(())
    }
}

/// Takes off the features of frames what is foretold of them.
#[derive(Debug)]
struct Foreteller {
    model: Arc<ContentModel>,
    thumbnailer: Thumbnailer,
    /// Features without it `[F, D]`.
    freed: Buffer<f32>,
}

impl Foreteller {
    fn new(device: &Device, model: Arc<ContentModel>, features: &FeatureExtractor) -> Result<Self, EngineError> {
        let thumbnailer = Thumbnailer::new(device, features.shape())?;
        Ok(Self { model, thumbnailer, freed: device.buffer("reader.freed", features.features().len())? })
    }

    /// Of the clip whose thumbnails and features were computed last.
    fn take_off(&mut self, features: &Buffer<f32>) -> Result<(), EngineError> {
        let mut freed = features.read()?;
        take_off(&mut freed, &self.model.foretell(&self.thumbnailer.read()?));
        Ok(self.freed.write(&freed)?)
    }
}

/// Frames of one clip on their way through a [`Reader`]. It sees them as [`Reader::look`] does, but for guesses.
#[derive(Debug)]
pub struct FeatureStream<'a> {
    reader: &'a mut Reader,
    preprocessor: Option<Preprocessor>,
    waiting: Vec<Frame>,
    /// Of the frames to come.
    parts: std::vec::IntoIter<Part>,
    /// What is seen with each guess undone.
    clip_features: Vec<(UndoGuess, ClipFeatures)>,
}

impl FeatureStream<'_> {
    /// Takes the next frame.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a frame of another size than the first, or after [`MAX_FRAMES`]; when the device
    /// fails.
    pub fn push(&mut self, frame: Frame) -> Result<(), EngineError> {
        let seen =
            self.clip_features.first().map_or(0, |(_, clip_features)| clip_features.logits.len() / self.reader.bits);
        let most = MAX_FRAMES / self.clip_features.len().max(1);
        if seen + self.waiting.len() >= most {
            return Err(EngineError::Usage {
                what: "clip".to_owned(),
                got: format!("more than {most} frames"),
                expected:
                    "fewer: read one of several, limit their number, or guess fewer things that were done to them"
                        .to_owned(),
            });
        }
        self.waiting.push(frame);
        if self.waiting.len() == CLIP_FRAMES { self.see() } else { Ok(()) }
    }

    /// What was seen in all frames with each guess undone; nothing if there was no frame.
    ///
    /// # Errors
    /// Those of [`Self::push`].
    pub fn finish(mut self) -> Result<Vec<ClipFeatures>, EngineError> {
        if !self.waiting.is_empty() {
            self.see()?;
        }
        Ok(self.clip_features.into_iter().map(|(_, clip_features)| clip_features).collect())
    }

    fn see(&mut self) -> Result<(), EngineError> {
        let Self { reader, preprocessor, waiting, parts, clip_features } = self;
        let preprocessor = match preprocessor {
            Some(preprocessor) => preprocessor,
            None => preprocessor.insert(Preprocessor::new(&reader.device, &waiting[0], reader.features.shape())?),
        };
        preprocessor.load(waiting)?;
        preprocessor.cut(&waiting.iter().map(|_| parts.next().unwrap_or(Part::All)).collect::<Vec<_>>())?;
        for (guess, clip_features) in clip_features {
            reader.see(preprocessor, waiting.len(), *guess, clip_features)?;
        }
        waiting.clear();
        Ok(())
    }
}
