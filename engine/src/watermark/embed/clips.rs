//! Drawing and making the clips of an embedding.

use std::sync::{Arc, OnceLock};

use glam::{DMat3, DVec3, Mat4};
use guard4d_kernels::Device;
use guard4d_kernels::loss::ssim::{self, SsimReference, SsimScratch};
use rand_chacha::ChaCha20Rng;

use super::buffers::TrainingBuffers;
use super::config::EmbedConfig;
use super::draw::unit;
use super::training_clip::TrainingClip;
use crate::base::numbers::narrow;
use crate::base::prf::uniform_unit;
use crate::error::EngineError;
use crate::render::deform::DeformField;
use crate::scene::camera::paths::Band;
use crate::scene::{Camera, CameraSet, Model, View};
use crate::watermark::extractor::weights::CLIP_FRAMES;

/// Clips that share their times.
const CLIPS_PER_TIMES: usize = 16;

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
    let band = Band {
        azimuth_deg: 0.0..=360.0,
        elevation_deg: views.elevation_deg.0..=views.elevation_deg.1,
        radius: look_at.radius..=look_at.radius,
        target: look_at.target.as_vec3(),
        lens: views.lens()?,
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
        let turn = config.views.turn_deg.to_radians() * (2.0 * uniform_unit(rng) - 1.0);
        let turned = |i: usize| Turn { target: look_at.target, angle_rad: turn * i as f64 };
        drawn.push(times.iter().enumerate().map(|(i, &t)| (shot(views, i, turned(i)), t)).collect());
    }
    Ok(drawn)
}

/// How far a camera has gone round the vertical line, which is parallel to z, through the point that it looks at.
#[derive(Clone, Copy)]
struct Turn {
    target: DVec3,
    angle_rad: f64,
}

impl Turn {
    /// The turn of the world that a camera sees instead of its own.
    fn of_world(self) -> Mat4 {
        let turn = DMat3::from_rotation_z(self.angle_rad);
        let shift = (self.target - turn * self.target).as_vec3();
        // The rotation by itself is made in f32, as all cameras are; about the origin nothing else is left of the turn.
        Mat4 { w_axis: shift.extend(1.0), ..Mat4::from_rotation_z(narrow(self.angle_rad)) }
    }
}

/// Camera of frame `i`: a view of its own, or the only one turned.
fn shot(views: &[View], i: usize, turn: Turn) -> Camera {
    match views {
        [one] => Camera { world_to_camera: one.camera.world_to_camera * turn.of_world(), ..one.camera },
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
        let similarity = match config.objective.uses_ssim() {
            true => Some(SsimScratch::new(device, config.views.frame_size(), 1)?),
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

    /// Plans and renders one clip, for steps to be taken on or, without its moments, for evaluations. Works in buffers
    /// that are free between steps.
    pub(super) fn build(
        &mut self,
        shots: &[(Camera, f32)],
        buffers: &mut TrainingBuffers,
        is_trained_on: bool,
    ) -> Result<TrainingClip, EngineError> {
        let mut plans = Vec::with_capacity(shots.len());
        for (camera, time) in shots {
            let state = self.field.at(*time)?;
            plans.push(Arc::new(buffers.plan(&state, camera)?));
        }
        let (full, small) = buffers.clip_lens();
        let mut clip = TrainingClip {
            plans,
            reference: self.device.buffer("clip.reference", full)?,
            resized: self.device.buffer("clip.resized", small)?,
            moments: None,
            features: OnceLock::new(),
        };
        let mut rec = self.device.recorder()?;
        buffers.draw_unmarked(&mut rec, &mut clip)?;
        if let Some(scratch) = self.similarity.as_mut().filter(|_| is_trained_on) {
            let mut moments = SsimReference::new(&self.device, buffers.frame_size(), shots.len())?;
            ssim::prepare(&mut rec, &clip.reference, &mut moments, scratch)?;
            clip.moments = Some(moments);
        }
        rec.submit()?;
        Ok(clip)
    }
}
