//! What the unmarked frames of training's clips are foretold to say.

use std::collections::HashMap;
use std::sync::Arc;

use guard4d_kernels::nn::axpy;
use guard4d_kernels::shape::ClipShape;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::buffers::TrainingBuffers;
use super::pool::ClipPool;
use super::training_clip::TrainingClip;
use crate::error::EngineError;
use crate::watermark::extractor::content::{ContentModel, FittedContent, MOST_VIEWS, THUMBNAIL_LEN, Thumbnailer};
use crate::watermark::extractor::weights::CLIP_FRAMES;

/// What an unmarked clip says, and what it looks like.
#[derive(Clone, Default)]
pub(super) struct ClipContent {
    /// `[F, D]`
    pub(super) features: Vec<f32>,
    /// `[F, T, T, 3]`; empty where nobody asks.
    pub(super) thumbnails: Vec<f32>,
}

/// A content model and what it says of clips. Of clips that it was fitted to, it is what all other views say: a mark
/// that is trained beside anything surer would be read beside content that it never met.
#[derive(Debug)]
pub(super) struct Foretold {
    model: Arc<ContentModel>,
    /// What it says of each view that it was fitted to, left out `[M, D]`.
    left_out: Vec<f32>,
    thumbnailer: Thumbnailer,
    /// By the clips' numbers `[F, D]`.
    clips: HashMap<usize, Vec<f32>>,
}

impl Foretold {
    /// Fits a model to unmarked clips that steps are taken on.
    pub(super) fn fit(thumbnailer: Thumbnailer, content: &[ClipContent]) -> Result<Self, EngineError> {
        let used = content.len().min(MOST_VIEWS / CLIP_FRAMES);
        // Evenly over all of them.
        let numbers: Vec<usize> = (0..used).map(|i| i * content.len() / used).collect();
        let of_these = || numbers.iter().map(|number| &content[*number]);
        let thumbnails: Vec<f32> = of_these().flat_map(|clip| clip.thumbnails.iter().copied()).collect();
        let features: Vec<f32> = of_these().flat_map(|clip| clip.features.iter().copied()).collect();
        let FittedContent { model, left_out } = ContentModel::fit(&thumbnails, &features)?;
        let mut fitted = Self { model: Arc::new(model), left_out, thumbnailer, clips: HashMap::new() };
        fitted.clips = content.iter().map(|clip| fitted.told(&clip.thumbnails)).enumerate().collect();
        Ok(fitted)
    }

    /// What a model that is given says.
    pub(super) fn by(device: &Device, seen: ClipShape, model: Arc<ContentModel>) -> Result<Self, EngineError> {
        let left_out = model.left_out()?;
        Ok(Self { model, left_out, thumbnailer: Thumbnailer::new(device, seen)?, clips: HashMap::new() })
    }

    /// The model.
    pub(super) fn model(&self) -> Arc<ContentModel> {
        Arc::clone(&self.model)
    }

    /// [`Self::of_clip`] of one that it was fitted with.
    pub(super) fn known(&self, number: usize) -> Option<&[f32]> {
        self.clips.get(&number).map(Vec::as_slice)
    }

    /// How far the features of one of the clips are from the mean of all `[F, D]`, were it unmarked.
    pub(super) fn of_clip(
        &mut self,
        device: &Device,
        buffers: &mut TrainingBuffers,
        number: usize,
        clip: &TrainingClip,
    ) -> Result<&[f32], EngineError> {
        if !self.clips.contains_key(&number) {
            let mut rec = device.recorder()?;
            buffers.clean_control(&mut rec, clip)?;
            rec.submit()?;
            let told = self.of_frames(device, buffers.control())?;
            self.clips.insert(number, told);
        }
        Ok(&self.clips[&number])
    }

    /// The same of any clip `[F,S,S,4]`.
    pub(super) fn of_frames(&mut self, device: &Device, clip: &Buffer<f32>) -> Result<Vec<f32>, EngineError> {
        let mut rec = device.recorder()?;
        self.thumbnailer.record(&mut rec, clip)?;
        rec.submit()?;
        Ok(self.told(&self.thumbnailer.read()?))
    }

    /// The same of what clips look like `[F, T, T, 3]`.
    fn told(&self, thumbnails: &[f32]) -> Vec<f32> {
        let width = self.left_out.len() / self.model.views();
        let of_one = |thumbnail| match self.model.view_of(thumbnail) {
            Some(view) => self.left_out[view * width..][..width].to_vec(),
            None => self.model.foretell(thumbnail),
        };
        thumbnails.chunks_exact(THUMBNAIL_LEN).flat_map(of_one).collect()
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
    pub(super) fn foretell(
        &mut self,
        device: &Device,
        buffers: &mut TrainingBuffers,
        number: usize,
        clip: &TrainingClip,
    ) -> Result<(), EngineError> {
        Ok(self.told.write(self.foretold.of_clip(device, buffers, number, clip)?)?)
    }

    /// Takes off what is foretold, for which gradients pass as they are.
    pub(super) fn free(&mut self, rec: &mut Recorder, features: &Buffer<f32>) -> Result<&Buffer<f32>, KernelError> {
        axpy::forward(rec, -1.0, features, &self.told, &mut self.freed)?;
        Ok(&self.freed)
    }
}
