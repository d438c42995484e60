//! Clips of an embedding, for training and held out: what of a view and its frames never changes while colours do.

use std::sync::Arc;

use glam::Mat4;
use guard4d_kernels::image::quantize;
use guard4d_kernels::image::resize::{self, ResizePlan};
use guard4d_kernels::loss::ssim::{self, SsimReference, SsimScratch};
use guard4d_kernels::{Buffer, Device};
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::Rng;

use super::config::EmbedConfig;
use super::step::Stage;
use super::{Subject, unit};
use crate::deform::DeformField;
use crate::error::EngineError;
use crate::render::{FramePlan, Prune, Renderer};
use crate::scene::camera_paths::{Band, Lens};
use crate::scene::{Camera, CameraSet, View};
use crate::watermark::evidence::ExtractorMode;
use crate::watermark::extractor::CLIP_FRAMES;
use crate::watermark::prf::{Purpose as Stream, uniform_unit};

/// Clips that share their times.
const CLIPS_PER_TIMES: usize = 16;
/// Clips that are measured and never trained on; two keep a measurement every 25 steps below 5 % of the time.
const HELD_OUT_CLIPS: u32 = 2;

/// [`CLIP_FRAMES`] frames that are trained on, or measured, together.
#[derive(Debug)]
pub(super) struct TrainingClip {
    /// Camera and time of each frame.
    pub(super) shots: Vec<(Camera, f32)>,
    pub(super) plans: Vec<Arc<FramePlan>>,
    /// Unmarked frames `[F,H,W,4]`, rounded to 8 bits as a video holds them.
    pub(super) reference: Buffer<f32>,
    /// The same at CLIP's size.
    pub(super) resized: Buffer<f32>,
    /// Reference moments for SSIM, when it is part of the loss.
    pub(super) moments: Option<SsimReference>,
}

/// All clips of an embedding.
pub(super) struct Clips {
    /// What steps are taken on.
    pub(super) training: Vec<TrainingClip>,
    /// What no step is taken on; none when nobody asks for it.
    pub(super) held_out: Vec<TrainingClip>,
}

impl Clips {
    /// Random views over the whole motion. The held-out ones have a random stream of their own, so that the others
    /// are the same with and without them.
    pub(super) fn plan(subject: &Subject<'_>, config: &EmbedConfig, stage: &mut Stage) -> Result<Self, EngineError> {
        let Subject { device, model, key, .. } = *subject;
        let mut field = DeformField::new(device, &model.gaussians, model.deformation.as_ref())?;
        let similarity = match config.uses_ssim() {
            true => Some(SsimScratch::new(device, config.frame_size(), 1)?),
            false => None,
        };
        let mut builder = ClipBuilder {
            device,
            field: &mut field,
            renderer: &mut stage.renderer,
            resize: &stage.resize,
            background: stage.background,
            similarity,
        };
        let prf = key.prf();
        let mut rng = prf.stream(Stream::Views, config.seed);
        let training = builder.build_all(shots(config, (config.views, config.seed), &mut rng)?)?;
        // They are measured, not differentiated.
        builder.similarity = None;
        let mut rng = prf.stream(Stream::HeldOutViews, config.seed);
        let held_out = match config.held_out_every {
            0 => Vec::new(),
            _ => {
                let cameras = (HELD_OUT_CLIPS, rng.next_u64());
                builder.build_all(shots(config, cameras, &mut rng)?)?
            }
        };
        Ok(Self { training, held_out })
    }
}

/// Cameras and times of clips.
///
/// A clip of `joint` is one camera that turns at its own pace, because its R learns how neighbouring frames belong
/// together. Without temporal weights to train, each frame gets a view of its own: one step then sees eight views
/// instead of one.
fn shots(
    config: &EmbedConfig,
    (clips, seed): (u32, u64),
    rng: &mut ChaCha20Rng,
) -> Result<Vec<Vec<(Camera, f32)>>, EngineError> {
    let size = crate::scene::ImageSize::new(config.size_px.0, config.size_px.1)?;
    let band = Band {
        azimuth_deg: 0.0..=360.0,
        elevation_deg: config.elevation_deg.0..=config.elevation_deg.1,
        radius: config.radius..=config.radius,
        target: glam::Vec3::ZERO,
        lens: Lens { fov_x_rad: config.fov_deg.to_radians(), size },
    };
    let frames = u32::try_from(CLIP_FRAMES).expect("a clip is a handful of frames");
    let per_clip = if config.mode == ExtractorMode::Joint { 1 } else { CLIP_FRAMES };
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

/// What building a clip needs.
struct ClipBuilder<'a> {
    device: &'a Device,
    field: &'a mut DeformField,
    renderer: &'a mut Renderer,
    resize: &'a ResizePlan,
    background: [f32; 3],
    /// Working memory for [`TrainingClip::moments`], when they are wanted.
    similarity: Option<SsimScratch>,
}

impl ClipBuilder<'_> {
    fn build_all(&mut self, clips: Vec<Vec<(Camera, f32)>>) -> Result<Vec<TrainingClip>, EngineError> {
        clips.into_iter().map(|shots| self.build(shots)).collect()
    }

    /// Plans and renders one clip.
    fn build(&mut self, shots: Vec<(Camera, f32)>) -> Result<TrainingClip, EngineError> {
        let mut plans = Vec::with_capacity(shots.len());
        for (camera, time) in &shots {
            let state = self.field.at(*time)?;
            plans.push(Arc::new(self.renderer.plan(&state, camera, Prune::Remove)?));
        }
        let frames = shots.len();
        let (from, to) = (self.resize.from, self.resize.to);
        let full = frames * from.height * from.width * 4;
        let mut raw = self.device.buffer("clip.raw", full)?;
        let mut reference = self.device.buffer("clip.reference", full)?;
        let mut resized = self.device.buffer("clip.resized", frames * to.height * to.width * 4)?;
        let mut scratch = self.resize.scratch(self.device, frames)?;
        let mut rec = self.device.recorder()?;
        self.renderer.forward_clip(&mut rec, &plans, None, self.background, &mut raw)?;
        quantize::forward(&mut rec, &raw, &mut reference)?;
        resize::forward(&mut rec, self.resize, &reference, &mut resized, &mut scratch)?;
        let moments = match &mut self.similarity {
            Some(scratch) => {
                let mut moments = SsimReference::new(self.device, from, frames)?;
                ssim::prepare(&mut rec, &reference, &mut moments, scratch)?;
                Some(moments)
            }
            None => None,
        };
        rec.submit()?;
        Ok(TrainingClip { shots, plans, reference, resized, moments })
    }
}
