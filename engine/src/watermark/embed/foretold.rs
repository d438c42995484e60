//! What the unmarked frames of training's clips are foretold to say.

use std::collections::HashMap;
use std::sync::Arc;

use guard4d_kernels::nn::axpy;
use guard4d_kernels::shape::ClipShape;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::fit_context::FitContext;
use super::pool::ClipPool;
use super::training_clip::TrainingClip;
use crate::error::EngineError;
use crate::watermark::extractor::content::{ContentModel, FittedContent, MOST_VIEWS, Thumbnailer};
use crate::watermark::extractor::weights::CLIP_FRAMES;

/// A content model and what it says of clips. Of clips that it was fitted to, it is what all other views say: a mark
/// that is trained beside anything surer would be read beside content that it never met.
#[derive(Debug)]
pub(super) struct Foretold {
    model: Arc<ContentModel>,
    thumbnailer: Thumbnailer,
    /// By the clips' numbers `[F, D]`.
    clips: HashMap<usize, Vec<f32>>,
}

impl Foretold {
    /// Fits a model to the features `[F, D]` of each unmarked clip that steps are taken on, which CLIP sees as `seen`.
    pub(super) fn fit(
        context: &mut FitContext<'_>,
        seen: ClipShape,
        content: &[Vec<f32>],
    ) -> Result<Self, EngineError> {
        let FitContext { device, pool, buffers, .. } = context;
        let mut thumbnailer = pool.with_room(|| Ok(Thumbnailer::new(device, seen)?))?;
        let used = content.len().min(MOST_VIEWS / CLIP_FRAMES);
        // Evenly over all of them.
        let numbers: Vec<usize> = (0..used).map(|i| i * content.len() / used).collect();
        let (mut thumbnails, mut features) = (Vec::new(), Vec::new());
        for &number in &numbers {
            let clip = pool.get(number, buffers)?;
            let mut rec = device.recorder()?;
            thumbnailer.record(&mut rec, &clip.resized)?;
            rec.submit()?;
            thumbnails.extend(thumbnailer.read()?);
            features.extend_from_slice(&content[number]);
        }
        let FittedContent { model, left_out } = ContentModel::fit(&thumbnails, &features)?;
        let of_each = left_out.chunks_exact(left_out.len() / used).map(<[f32]>::to_vec);
        Ok(Self { model: Arc::new(model), thumbnailer, clips: numbers.into_iter().zip(of_each).collect() })
    }

    /// What a model that is given says; of clips that it was fitted to it knows what they say.
    pub(super) fn by(device: &Device, seen: ClipShape, model: Arc<ContentModel>) -> Result<Self, EngineError> {
        Ok(Self { model, thumbnailer: Thumbnailer::new(device, seen)?, clips: HashMap::new() })
    }

    /// The model.
    pub(super) fn model(&self) -> Arc<ContentModel> {
        Arc::clone(&self.model)
    }

    /// [`Self::of_clip`] of one that it was fitted to.
    pub(super) fn known(&self, number: usize) -> Option<&[f32]> {
        self.clips.get(&number).map(Vec::as_slice)
    }

    /// How far the features of one of the clips are from the mean of all `[F, D]`, were it unmarked.
    pub(super) fn of_clip(
        &mut self,
        device: &Device,
        number: usize,
        clip: &TrainingClip,
    ) -> Result<&[f32], EngineError> {
        if !self.clips.contains_key(&number) {
            let told = self.of_frames(device, &clip.resized)?;
            self.clips.insert(number, told);
        }
        Ok(&self.clips[&number])
    }

    /// The same of any clip `[F,S,S,4]`.
    pub(super) fn of_frames(&mut self, device: &Device, clip: &Buffer<f32>) -> Result<Vec<f32>, EngineError> {
        let mut rec = device.recorder()?;
        self.thumbnailer.record(&mut rec, clip)?;
        rec.submit()?;
        Ok(self.model.foretell(&self.thumbnailer.read()?))
    }
}

/// What clips are foretold to say, taken off what they say.
pub(super) struct TakenOff {
    foretold: Foretold,
    /// What is foretold of the clip at hand `[F, D]`.
    told: Buffer<f32>,
    /// Its features without that `[F, D]`.
    freed: Buffer<f32>,
}

impl TakenOff {
    /// With memory of its own, besides what `pool` keeps, for features of `len` numbers.
    pub(super) fn new(
        device: &Device,
        pool: &mut ClipPool,
        foretold: Foretold,
        len: usize,
    ) -> Result<Self, EngineError> {
        let mut buffer = |name: &str| pool.with_room_beside_one(|| Ok(device.buffer(name, len)?));
        Ok(Self { told: buffer("loss.told")?, freed: buffer("loss.freed")?, foretold })
    }

    /// Gets ready for the features of this clip.
    pub(super) fn foretell(&mut self, device: &Device, number: usize, clip: &TrainingClip) -> Result<(), EngineError> {
        Ok(self.told.write(self.foretold.of_clip(device, number, clip)?)?)
    }

    /// Takes off what is foretold, for which gradients pass as they are.
    pub(super) fn free(&mut self, rec: &mut Recorder, features: &Buffer<f32>) -> Result<&Buffer<f32>, KernelError> {
        axpy::forward(rec, -1.0, features, &self.told, &mut self.freed)?;
        Ok(&self.freed)
    }
}
