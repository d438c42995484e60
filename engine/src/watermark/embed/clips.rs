//! Clips of an embedding: what of a view and its frames never changes while colours do.

use std::sync::{Arc, OnceLock};

use glam::Mat4;
use guard4d_kernels::image::quantize;
use guard4d_kernels::image::resize;
use guard4d_kernels::loss::ssim::{self, SsimReference, SsimScratch};
use guard4d_kernels::{Buffer, Device};
use rand_chacha::ChaCha20Rng;

use super::config::EmbedConfig;
use super::step::Stage;
use super::unit;
use crate::deform::DeformField;
use crate::error::EngineError;
use crate::lpips::LpipsFeatures;
use crate::render::{FramePlan, OffsetBases, Prune};
use crate::scene::camera_paths::{Band, Lens};
use crate::scene::{Camera, CameraSet, Model, View};
use crate::watermark::extractor::CLIP_FRAMES;
use crate::watermark::prf::uniform_unit;

/// Clips that share their times.
const CLIPS_PER_TIMES: usize = 16;

/// [`CLIP_FRAMES`] frames that are trained on, or measured, together.
#[derive(Debug)]
pub(super) struct TrainingClip {
    pub(super) plans: Vec<Arc<FramePlan>>,
    /// Unmarked frames `[F,H,W,4]`, rounded to 8 bits as a video holds them.
    pub(super) reference: Buffer<f32>,
    /// The same at CLIP's size.
    pub(super) resized: Buffer<f32>,
    /// Reference moments for SSIM, when it is part of the loss.
    pub(super) moments: Option<SsimReference>,
    /// What LPIPS's network sees in the unmarked frames, once a step has computed it where there is room to keep it.
    pub(super) features: OnceLock<LpipsFeatures>,
}

impl TrainingClip {
    /// Device bytes, but for LPIPS's features; the scene's coefficients are shared and not counted.
    pub(super) fn bytes(&self) -> u64 {
        let plans: usize = self.plans.iter().map(|plan| plan.bytes()).sum();
        let frames = size_of::<f32>() * (self.reference.len() + self.resized.len());
        (plans + frames + self.moments.as_ref().map_or(0, SsimReference::bytes)) as u64
    }
}

/// Cameras and times of clips. Those that `films` are of one camera each, as what leaks is.
///
/// A clip of `joint` is one camera that turns at its own pace, because its R learns how neighbouring frames belong
/// together; so is one of the multi-frame baseline. Without temporal weights to train, each frame gets a view of its own: one step then sees eight views
/// instead of one.
pub(super) fn shots(
    config: &EmbedConfig,
    (clips, seed): (u32, u64),
    films: bool,
    rng: &mut ChaCha20Rng,
) -> Result<Vec<Vec<(Camera, f32)>>, EngineError> {
    let size = crate::scene::ImageSize::new(config.size_px.0, config.size_px.1)?;
    let band = Band {
        azimuth_deg: 0.0..=360.0,
        elevation_deg: config.elevation_deg.0..=config.elevation_deg.1,
        radius: config.vantage.radius..=config.vantage.radius,
        target: config.vantage.target.as_vec3(),
        lens: Lens { fov_x_rad: config.fov_deg.to_radians(), size },
    };
    let frames = u32::try_from(CLIP_FRAMES).expect("a clip is a handful of frames");
    let per_clip = if films { 1 } else { CLIP_FRAMES };
    let cameras: CameraSet = match per_clip {
        1 => band.sample(clips, seed)?,
        _ => band.sample(clips * frames, seed)?,
    };
    // A few clips share each set of times, so that the deformation is evaluated once for them.
    let mut times = [0.0; CLIP_FRAMES];
    let mut drawn = Vec::with_capacity(clips as usize);
    for (number, views) in cameras.views.chunks(per_clip).enumerate() {
        if number % CLIPS_PER_TIMES == 0 {
            let shift = unit(rng);
            times = std::array::from_fn(|i| (i as f32 + shift) / CLIP_FRAMES as f32);
        }
        let turn = config.turn_deg.to_radians() * (2.0 * uniform_unit(rng) - 1.0);
        drawn.push(times.iter().enumerate().map(|(i, &t)| (shot(views, i, turn), t)).collect());
    }
    Ok(drawn)
}

/// Camera of frame `i`: a view of its own, or the only one turned `i` times.
#[allow(clippy::cast_possible_truncation, reason = "cameras are single precision")]
fn shot(views: &[View], i: usize, turn_rad: f64) -> Camera {
    match views {
        [one] => {
            let turn = Mat4::from_rotation_z((turn_rad * i as f64) as f32);
            Camera { world_to_camera: one.camera.world_to_camera * turn, ..one.camera }
        }
        several => several[i].camera,
    }
}

/// Makes clips.
pub(super) struct ClipBuilder {
    device: Device,
    field: DeformField,
    /// Working memory for [`TrainingClip::moments`], when they are wanted.
    similarity: Option<SsimScratch>,
}

impl ClipBuilder {
    pub(super) fn new(device: &Device, model: &Model, config: &EmbedConfig) -> Result<Self, EngineError> {
        let field = DeformField::new(device, &model.gaussians, &model.motion)?;
        let similarity = match config.uses_ssim() {
            true => Some(SsimScratch::new(device, config.frame_size(), 1)?),
            false => None,
        };
        Ok(Self { device: device.clone(), field: field.with_cached_times(CLIP_FRAMES), similarity })
    }

    /// Gives back the memory of what clips with the same times have in common.
    pub(super) fn forget_times(&mut self) {
        self.field.forget_times();
    }

    /// Works from now on in as little memory as can be; whether that is less than before.
    pub(super) fn save_memory(&mut self) -> bool {
        self.field.limit_cached_times(1)
    }

    /// Plans and renders one clip, for steps to be taken on or, without its moments, for measuring. Works in buffers of
    /// the stage that are free between steps.
    pub(super) fn build(
        &mut self,
        shots: &[(Camera, f32)],
        stage: &mut Stage,
        is_trained_on: bool,
    ) -> Result<TrainingClip, EngineError> {
        let mut plans = Vec::with_capacity(shots.len());
        for (camera, time) in shots {
            let state = self.field.at(*time)?;
            let plan = stage.renderer.plan(&state, camera, Prune::Remove)?;
            plans.push(Arc::new(match stage.bases {
                OffsetBases::Dc => stage.renderer.fix_view(plan)?,
                OffsetBases::All => plan,
            }));
        }
        let mut reference = self.device.buffer("clip.reference", stage.raw.len())?;
        let mut resized = self.device.buffer("clip.resized", stage.resized.len())?;
        let mut rec = self.device.recorder()?;
        stage.renderer.forward_clip(&mut rec, &plans, None, stage.background, &mut stage.raw)?;
        quantize::forward(&mut rec, &stage.raw, &mut reference)?;
        resize::forward(&mut rec, &stage.resize, &reference, &mut resized, &mut stage.resize_scratch)?;
        let moments = match self.similarity.as_mut().filter(|_| is_trained_on) {
            Some(scratch) => {
                let mut moments = SsimReference::new(&self.device, stage.resize.from, shots.len())?;
                ssim::prepare(&mut rec, &reference, &mut moments, scratch)?;
                Some(moments)
            }
            None => None,
        };
        rec.submit()?;
        Ok(TrainingClip { plans, reference, resized, moments, features: OnceLock::new() })
    }
}
