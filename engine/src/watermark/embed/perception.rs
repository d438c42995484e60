//! LPIPS in a training step. What its network sees in a clip's unmarked frames is kept where whole frames are compared
//! and memory has room: it takes several times the memory of the clip itself, so that no clip goes for it.

use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::buffers::MarkedFrames;
use super::config::EmbedConfig;
use super::pool::ClipPool;
use super::training_clip::TrainingClip;
use crate::error::EngineError;
use crate::networks::lpips::{Lpips, LpipsFeatures, LpipsGradient, LpipsPass, Pair, Reference};
use crate::watermark::extractor::weights::CLIP_FRAMES;

/// Bytes of all that is kept where no memory budget says how much there may be.
const UNASKED_BYTES: u64 = 1 << 30;

/// The network with room for the part of a clip that a step compares.
pub(super) struct Perception {
    net: Lpips,
    pass: LpipsPass,
    frame: ImageSize,
    /// Factor on the gradient of a step that compares: for all those until the next one.
    weight: f32,
    /// Whether there may be room to keep anything: not for parts of frames, and not once it was refused.
    keeps: bool,
    /// Room for what the next step's clip leaves, where nothing is known of it yet.
    room: Option<LpipsFeatures>,
}

impl Perception {
    /// `None` when LPIPS is no part of the loss.
    pub(super) fn new(device: &Device, config: &EmbedConfig) -> Result<Option<Self>, EngineError> {
        let Some(term) = config.objective.trained_lpips() else { return Ok(None) };
        let net = Lpips::new(device, term.network.get()?, term.input)?;
        let frame = config.views.frame_size();
        let pass = net.pass(term.part_of(frame), CLIP_FRAMES)?;
        Ok(Some(Self {
            net,
            pass,
            frame,
            weight: term.lambda * term.every as f32,
            keeps: term.crop_px.is_none(),
            room: None,
        }))
    }

    /// Device bytes of what may be kept of so many clips, each as large as the next: as many of them as there is room
    /// for where there is no budget.
    pub(super) fn kept_bytes(&self, clips: usize) -> u64 {
        let each = self.pass.features_bytes();
        if self.keeps { each * (clips as u64).min(UNASKED_BYTES / each.max(1)) } else { 0 }
    }

    /// Makes room for what the network sees in a clip, between steps, if nothing is known of it yet and nothing else
    /// needs that memory.
    pub(super) fn make_room(
        &mut self,
        device: &Device,
        pool: &ClipPool,
        clip: &TrainingClip,
    ) -> Result<(), EngineError> {
        self.room = None;
        if !self.keeps || clip.features.get().is_some() || !pool.holds_all() {
            return Ok(());
        }
        if device.memory_budget().is_none() && pool.features_bytes() + self.pass.features_bytes() > UNASKED_BYTES {
            return Ok(());
        }
        match self.net.features(&self.pass) {
            Err(error) if error.is_out_of_memory() => self.keeps = false,
            room => self.room = Some(room?),
        }
        Ok(())
    }

    /// Gives a clip what the step that is done has left in the room for it.
    pub(super) fn remember(&mut self, clip: &TrainingClip) {
        if let Some(room) = self.room.take() {
            clip.features.get_or_init(|| room);
        }
    }

    /// Compares the part from `corner` on, and adds its gradient.
    pub(super) fn step(
        &mut self,
        rec: &mut Recorder,
        marked: MarkedFrames<'_>,
        clip: &TrainingClip,
        corner: [usize; 2],
    ) -> Result<(), KernelError> {
        let pair = Pair { image: marked.frames, reference: marked.unmarked, full: self.frame, corner };
        let known = match (clip.features.get(), &mut self.room) {
            (Some(features), _) => Reference::Kept(features),
            (None, Some(room)) => Reference::Keep(room),
            (None, None) => Reference::Unknown,
        };
        let gradient = LpipsGradient { v_image: marked.gradient, weight: self.weight };
        self.net.step_with(rec, &mut self.pass, &pair, known, Some(gradient))
    }

    /// What a step leaves for [`Perception::score`].
    pub(super) fn values(&self) -> &Buffer<f32> {
        self.pass.values()
    }

    /// The distance that `values` say.
    #[allow(clippy::cast_possible_truncation, reason = "as the other losses")]
    pub(super) fn score(&self, values: &[f32]) -> f32 {
        self.pass.score(values).total() as f32
    }
}
