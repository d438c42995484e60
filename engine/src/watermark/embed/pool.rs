//! The clips of an embedding, as many of them at a time as memory has room for.
//!
//! A clip is constant, so that one that had to go is the same to the bit when it is made again: a budget costs time and
//! changes no result.

use std::collections::HashSet;
use std::sync::Arc;

use guard4d_kernels::Device;
use rand_chacha::rand_core::Rng;

use super::buffers::TrainingBuffers;
use super::clips::{ClipBuilder, ClipUse, Draws, field, shots};
use super::config::EmbedConfig;
use super::framed_views;
use super::training_clip::TrainingClip;
use crate::base::prf::{Prf, Purpose};
use crate::device::DeviceKind;
use crate::error::EngineError;
use crate::networks::lpips::LpipsFeatures;
use crate::picture::known_views::KnownViews;
use crate::render::SceneRenderer;
use crate::scene::{Camera, Model};

/// Most clips that an extractor is fitted to.
pub(super) const FITTED: usize = 360;
/// Most clips of these that are looked at for colours, copies and the zero.
const SAMPLED: usize = 144;
/// Most device bytes of clips where nobody asked for more: on a processor, whose memory others want, too.
const USUAL_KEPT_BYTES: u64 = 5 << 28;
/// The part of a card's free memory that clips may take, one in so many: two embeddings may share the card.
const SHARE_OF_CARD: u64 = 4;

/// Most device bytes of the clips that are in memory at one time, unless a single one is larger. The others are made
/// again when their turn comes, so that this decides about time and about nothing else.
///
/// A `budget` in bytes that was asked for is all theirs, as far as other buffers leave it. Without one it is 1.25 GiB,
/// and on a card a quarter of the `free` bytes where that is more.
#[must_use]
pub fn most_kept_bytes(kind: DeviceKind, budget: Option<u64>, free: Option<u64>) -> u64 {
    match (budget, kind, free) {
        (Some(bytes), ..) => bytes,
        (None, DeviceKind::Discrete, Some(free)) => USUAL_KEPT_BYTES.max(free / SHARE_OF_CARD),
        _ => USUAL_KEPT_BYTES,
    }
}

/// All clips of an embedding by number: first those that steps are taken on, then those that none is taken on.
pub(super) struct ClipPool {
    /// Camera and time of each frame of each clip.
    shots: Vec<Vec<(Camera, f32)>>,
    num_training: usize,
    /// How many of these steps are taken on for now.
    in_use: usize,
    /// What films are framed by.
    known_views: Option<Arc<KnownViews>>,
    builder: ClipBuilder,
    kept: Kept,
    /// See [`most_kept_bytes`].
    most_bytes: u64,
    made: usize,
}

/// Clips that are in memory, the least recently used first.
#[derive(Default)]
struct Kept(Vec<(usize, Arc<TrainingClip>)>);

impl Kept {
    fn take(&mut self, index: usize) -> Option<Arc<TrainingClip>> {
        let at = self.0.iter().position(|(i, _)| *i == index)?;
        Some(self.0.remove(at).1)
    }

    /// Does `work`; as long as it wants for memory and more than `least` clips are there, one goes and it is tried
    /// again.
    fn with_room<T>(
        &mut self,
        least: usize,
        mut work: impl FnMut() -> Result<T, EngineError>,
    ) -> Result<T, EngineError> {
        loop {
            let done = work();
            if self.0.len() <= least || !is_out_of_memory(&done) {
                return done;
            }
            self.0.remove(0);
        }
    }
}

/// Whether something failed for want of device memory, be it the budget's or the driver's.
pub(super) fn is_out_of_memory<T>(done: &Result<T, EngineError>) -> bool {
    matches!(done, Err(EngineError::Kernel(error)) if error.is_out_of_memory())
}

impl ClipPool {
    /// Draws random views over the whole motion. The held-out ones have a random stream of their own, so that the
    /// others are the same with and without them.
    pub(super) fn draw(device: &Device, model: &Model, prf: &Prf, config: &EmbedConfig) -> Result<Self, EngineError> {
        let mut rng = prf.stream(Purpose::Views, config.seed);
        let draws = Draws { clips: config.views.clips, seed: config.seed };
        let mut drawn = shots(config, model, draws, config.films(), &mut rng)?;
        let num_training = drawn.len();
        if config.held_out_clips() > 0 {
            let mut rng = prf.stream(Purpose::HeldOutViews, config.seed);
            let draws = Draws { clips: config.held_out_clips(), seed: rng.next_u64() };
            drawn.extend(shots(config, model, draws, true, &mut rng)?);
        }
        let mut renderer = SceneRenderer::of_field(device, field(device, model)?, model.background)?;
        let mut framed = framed_views::frame(&mut renderer, config, &drawn[..num_training]);
        while is_out_of_memory(&framed) && renderer.save_memory() {
            framed = framed_views::frame(&mut renderer, config, &drawn[..num_training]);
        }
        let known_views = framed?;
        let builder = ClipBuilder::new(device, renderer.into_field(), config)?;
        let in_use = (config.in_phase(0).views.clips as usize).min(num_training);
        let most_bytes = most_kept_bytes(device.info().kind, device.memory_budget(), device.free_memory());
        let kept = Kept::default();
        Ok(Self { shots: drawn, num_training, in_use, known_views, builder, kept, most_bytes, made: 0 })
    }

    /// What films are framed by, if they are.
    pub(super) fn known_views(&self) -> Option<Arc<KnownViews>> {
        self.known_views.clone()
    }

    /// Takes as many training clips into use, at most all. Those that are there are not made again.
    pub(super) fn use_training(&mut self, clips: usize) {
        self.in_use = clips.min(self.num_training);
    }

    /// Lets go of all clips, which have to be made anew for other bases.
    pub(super) fn forget_clips(&mut self) {
        self.kept.0.clear();
    }

    /// Leaves out training clips until at most `most` are there, evenly.
    pub(super) fn thin_out(&mut self, most: usize) {
        let (all, most) = (self.num_training, most.min(self.num_training));
        let held_out = self.shots.split_off(all);
        let mut index = 0;
        self.shots.retain(|_| {
            index += 1;
            index * most / all > (index - 1) * most / all
        });
        self.num_training = self.shots.len();
        self.in_use = self.in_use.min(self.num_training);
        self.shots.extend(held_out);
    }

    /// Number of clips.
    pub(super) fn len(&self) -> usize {
        self.shots.len()
    }

    /// Number of clips that are in memory.
    pub(super) fn in_memory(&self) -> usize {
        self.kept.0.len()
    }

    /// Device bytes of the clips that are in memory.
    pub(super) fn bytes(&self) -> u64 {
        self.kept.0.iter().map(|(_, clip)| clip.bytes()).sum()
    }

    /// Most device bytes of the clips that are in memory at one time.
    pub(super) fn most_bytes(&self) -> u64 {
        self.most_bytes
    }

    /// Device bytes of the asset's moments that are in memory.
    pub(super) fn moments_bytes(&self) -> u64 {
        self.builder.times_bytes()
    }

    /// Device bytes of as many, or of as many as are kept.
    pub(super) fn bytes_of_moments(&self, moments: usize) -> u64 {
        self.builder.bytes_of_times(moments)
    }

    /// Moments that the clips show.
    pub(super) fn num_moments(&self) -> usize {
        self.shots.iter().flatten().map(|(_, time)| time.to_bits()).collect::<HashSet<u32>>().len()
    }

    /// Device bytes of what LPIPS's network sees in them.
    pub(super) fn features_bytes(&self) -> u64 {
        self.kept.0.iter().filter_map(|(_, clip)| clip.features.get()).map(LpipsFeatures::bytes).sum()
    }

    /// Whether all clips in use are in memory, so that none is waiting for room.
    pub(super) fn holds_all(&self) -> bool {
        self.kept.0.len() >= self.training().len() + self.held_out().len()
    }

    /// Makes clips, the first of training first, until all that are in use are there or memory is full.
    pub(super) fn fill(&mut self, buffers: &mut TrainingBuffers) -> Result<(), EngineError> {
        for (before, index) in self.training().chain(self.held_out()).enumerate() {
            self.get(index, buffers)?;
            if self.kept.0.len() <= before {
                break;
            }
        }
        tracing::debug!(kept = self.kept.0.len(), of = self.shots.len(), "clips planned");
        Ok(())
    }

    /// One clip, made if it is not there.
    pub(super) fn get(
        &mut self,
        index: usize,
        buffers: &mut TrainingBuffers,
    ) -> Result<Arc<TrainingClip>, EngineError> {
        let clip = match self.kept.take(index) {
            Some(clip) => clip,
            None => {
                let clip = self.make(index, self.use_of(index), buffers)?;
                while !self.kept.0.is_empty() && self.bytes() + clip.bytes() > self.most_bytes {
                    self.kept.0.remove(0);
                }
                clip
            }
        };
        self.kept.0.push((index, Arc::clone(&clip)));
        Ok(clip)
    }

    /// The same for forward passes alone, of one that is not asked for again soon: no other has to go for it but where
    /// memory is short.
    pub(super) fn look(
        &mut self,
        index: usize,
        buffers: &mut TrainingBuffers,
    ) -> Result<Arc<TrainingClip>, EngineError> {
        if self.kept.0.iter().any(|(kept, _)| *kept == index) {
            return self.get(index, buffers);
        }
        // As large as the others are.
        let expected = self.bytes() / self.kept.0.len().max(1) as u64;
        let is_kept = self.bytes() + expected <= self.most_bytes;
        let clip = self.make(index, if is_kept { self.use_of(index) } else { ClipUse::Look }, buffers)?;
        if is_kept && self.bytes() + clip.bytes() <= self.most_bytes {
            self.kept.0.push((index, Arc::clone(&clip)));
        }
        Ok(clip)
    }

    /// What a clip is made for that stays.
    fn use_of(&self, index: usize) -> ClipUse {
        if index < self.num_training { ClipUse::Train } else { ClipUse::Measure }
    }

    fn make(
        &mut self,
        index: usize,
        used: ClipUse,
        buffers: &mut TrainingBuffers,
    ) -> Result<Arc<TrainingClip>, EngineError> {
        let Self { shots, builder, kept, .. } = self;
        let shots = &shots[index];
        let mut build = |builder: &mut ClipBuilder| kept.with_room(0, || builder.build(shots, buffers, used));
        let mut built = build(builder);
        while is_out_of_memory(&built) && builder.save_memory() {
            built = build(builder);
        }
        self.made += 1;
        Ok(Arc::new(built?))
    }

    /// Does work that takes memory to stay; clips make room for it, and what they have in common.
    pub(super) fn with_room<T>(&mut self, work: impl FnMut() -> Result<T, EngineError>) -> Result<T, EngineError> {
        self.with_room_beside(0, work)
    }

    /// The same, but one clip stays: without it no step can be taken.
    pub(super) fn with_room_beside_one<T>(
        &mut self,
        work: impl FnMut() -> Result<T, EngineError>,
    ) -> Result<T, EngineError> {
        self.with_room_beside(1, work)
    }

    /// What clips have in common goes last: it is small, and all of them would have to be moved anew.
    fn with_room_beside<T>(
        &mut self,
        least: usize,
        mut work: impl FnMut() -> Result<T, EngineError>,
    ) -> Result<T, EngineError> {
        let done = self.kept.with_room(least, &mut work);
        if is_out_of_memory(&done) && self.builder.forget_times() { work() } else { done }
    }

    /// Numbers of the clips that steps are taken on.
    pub(super) fn training(&self) -> std::ops::Range<usize> {
        0..self.in_use
    }

    /// The first of these, which an extractor is fitted to.
    pub(super) fn fitted(&self) -> std::ops::Range<usize> {
        0..self.in_use.min(FITTED)
    }

    /// The first of these, for what is tried on a few.
    pub(super) fn sampled(&self) -> std::ops::Range<usize> {
        0..self.in_use.min(SAMPLED)
    }

    /// Some clips, those first that are in memory: the others could push them out.
    pub(super) fn at_hand_first(&self, clips: std::ops::Range<usize>) -> Vec<usize> {
        let is_kept = |index: &usize| self.kept.0.iter().any(|(i, _)| i == index);
        let (mut first, rest): (Vec<_>, Vec<_>) = clips.partition(is_kept);
        first.extend(rest);
        first
    }

    /// Numbers of the clips that are measured and that no step is taken on; none when nobody asks for it.
    pub(super) fn held_out(&self) -> std::ops::Range<usize> {
        self.num_training..self.shots.len()
    }

    /// Cameras and times of some clips.
    pub(super) fn shots(&self, clips: std::ops::Range<usize>) -> impl Iterator<Item = &[(Camera, f32)]> {
        self.shots[clips].iter().map(Vec::as_slice)
    }

    /// Clips made so far, those made again among them.
    pub(super) fn made(&self) -> usize {
        self.made
    }
}
