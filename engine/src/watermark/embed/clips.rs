//! Drawing and making the clips of an embedding.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use glam::DMat3;
use guard4d_kernels::Device;
use guard4d_kernels::loss::ssim::{self, SsimReference, SsimScratch};
use guard4d_kernels::splat::tile_bin::Prune;
use rand_chacha::ChaCha20Rng;

use super::buffers::TrainingBuffers;
use super::config::EmbedConfig;
use super::draw::unit;
use super::training_clip::TrainingClip;
use crate::base::prf::uniform_unit;
use crate::error::EngineError;
use crate::render::deform::DeformField;
use crate::scene::{Camera, LookAt, Model, View};
use crate::watermark::extractor::weights::CLIP_FRAMES;

/// Most device bytes of a moving asset's moments that are kept beyond those of one clip. To move the splats of a frame
/// takes three times as long as to plan it (robot), and clips share their moments.
const MOST_MOMENTS_BYTES: usize = 512 << 20;
/// Clips that share their times.
const CLIPS_PER_TIMES: usize = 16;

/// The scene, of which moments are kept that frames have in common.
pub(super) fn field(device: &Device, model: &Model) -> Result<DeformField, EngineError> {
    let field = DeformField::new(device, &model.gaussians, &model.motion)?;
    Ok(field.with_cached_bytes(CLIP_FRAMES, MOST_MOMENTS_BYTES))
}

/// How many cameras, and the seed that they are drawn with.
#[derive(Clone, Copy)]
pub(super) struct Draws {
    pub(super) clips: u32,
    pub(super) seed: u64,
}

/// Cameras and times of clips. Those that `films` are of one camera each, as what leaks is.
///
/// A clip of `joint` is one camera that turns at its own pace, because its R learns how neighbouring frames belong
/// together; so is one of the multi-frame baseline. Without temporal weights to train, each frame gets a view of its
/// own: one step then sees eight views instead of one.
pub(super) fn shots(
    config: &EmbedConfig,
    model: &Model,
    draws: Draws,
    films: bool,
    rng: &mut ChaCha20Rng,
) -> Result<Vec<Vec<(Camera, f32)>>, EngineError> {
    let (views, Draws { clips, seed }) = (&config.views, draws);
    let look_at = views.look_at(model);
    let frames = u32::try_from(CLIP_FRAMES).expect("a clip is a handful of frames");
    let per_clip = if films { 1 } else { CLIP_FRAMES };
    let cameras = views.sample(look_at, if films { clips } else { clips * frames }, seed)?;
    // A few clips share each set of times, so that the deformation is evaluated once for them.
    let mut times = [0.0; CLIP_FRAMES];
    let mut drawn = Vec::with_capacity(clips as usize);
    for (number, views) in cameras.views.chunks(per_clip).enumerate() {
        if number % CLIPS_PER_TIMES == 0 {
            let shift = unit(rng);
            times = std::array::from_fn(|i| (i as f32 + shift) / CLIP_FRAMES as f32);
        }
        let turn = config.views.turn_deg.to_radians() * (2.0 * uniform_unit(rng) - 1.0);
        let turned = |i: usize| Turn { look_at, angle_rad: turn * i as f64 };
        drawn.push(times.iter().enumerate().map(|(i, &t)| (shot(views, i, turned(i)), t)).collect());
    }
    Ok(drawn)
}

/// How far a camera has gone round the vertical line through the point that it looks at.
#[derive(Clone, Copy)]
struct Turn {
    look_at: LookAt,
    angle_rad: f64,
}

/// Camera of frame `i`: a view of its own, or the only one turned.
fn shot(views: &[View], i: usize, turn: Turn) -> Camera {
    match views {
        [one] => one.camera.around(turn.look_at.target, DMat3::from_axis_angle(turn.look_at.up, turn.angle_rad)),
        several => several[i].camera,
    }
}

/// What a clip is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ClipUse {
    /// Steps, which go back through it.
    Train,
    /// To be measured again and again.
    Measure,
    /// To be looked at a few times: pairs that change no pixel may stay in its lists.
    Look,
}

/// Makes clips.
pub(super) struct ClipBuilder {
    device: Device,
    field: DeformField,
    /// Working memory for [`TrainingClip::moments`], when they are wanted.
    similarity: Option<SsimScratch>,
}

impl ClipBuilder {
    /// Makes clips of the scene in `field`.
    pub(super) fn new(device: &Device, field: DeformField, config: &EmbedConfig) -> Result<Self, EngineError> {
        let similarity = match config.objective.uses_ssim() {
            true => Some(SsimScratch::new(device, config.views.frame_size(), 1)?),
            false => None,
        };
        Ok(Self { device: device.clone(), field, similarity })
    }

    /// Gives back the memory of what clips with the same times have in common; whether that was some.
    pub(super) fn forget_times(&mut self) -> bool {
        self.field.forget_times()
    }

    /// Device bytes of what clips with the same times have in common, if that are so many times.
    pub(super) fn bytes_of_times(&self, times: usize) -> u64 {
        let one = self.field.cached_bytes() / self.field.num_cached().max(1);
        (one * times.min(CLIP_FRAMES.max(MOST_MOMENTS_BYTES / one.max(1)))) as u64
    }

    /// Device bytes of the same now.
    pub(super) fn times_bytes(&self) -> u64 {
        self.field.cached_bytes() as u64
    }

    /// Works from now on in as little memory as can be; whether that is less than before.
    pub(super) fn save_memory(&mut self) -> bool {
        self.field.save_memory()
    }

    /// Plans and renders one clip; only one to train on has moments. Works in buffers that are free between steps.
    pub(super) fn build(
        &mut self,
        shots: &[(Camera, f32)],
        buffers: &mut TrainingBuffers,
        used: ClipUse,
    ) -> Result<TrainingClip, EngineError> {
        let prune = if used == ClipUse::Look { Prune::Keep } else { Prune::Remove };
        let mut plans = Vec::with_capacity(shots.len());
        let (started, mut deforming) = (Instant::now(), Duration::ZERO);
        for (camera, time) in shots {
            let moved = Instant::now();
            let state = self.field.at(*time)?;
            deforming += moved.elapsed();
            plans.push(Arc::new(buffers.plan(&state, camera, prune)?));
        }
        let planned = started.elapsed();
        let mut clip = TrainingClip {
            plans,
            unmarked: self.device.buffer("clip.unmarked", buffers.num_pixels())?,
            moments: None,
            features: OnceLock::new(),
        };
        let mut rec = self.device.recorder()?;
        buffers.draw_unmarked(&mut rec, &mut clip)?;
        if let Some(scratch) = self.similarity.as_mut().filter(|_| used == ClipUse::Train) {
            let mut moments = SsimReference::new(&self.device, buffers.frame_size(), shots.len())?;
            ssim::prepare(&mut rec, buffers.unmarked(), &mut moments, scratch)?;
            clip.moments = Some(moments);
        }
        rec.submit()?;
        let [deform_ms, all_ms] = [deforming, started.elapsed()].map(|time| time.as_millis());
        let plan_ms = (planned - deforming).as_millis();
        tracing::debug!(?used, deform_ms, plan_ms, all_ms, bytes = clip.bytes(), "clip made");
        Ok(clip)
    }
}
