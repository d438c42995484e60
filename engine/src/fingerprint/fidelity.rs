//! How strong a stamp may be: measured on views from all around, not assumed.

use guard4d_kernels::Device;

use super::issue::Issue;
use crate::error::EngineError;
use crate::media::Frame;
use crate::picture::metrics::{Picture, PsnrSummary, SquaredError};
use crate::render::SceneRenderer;
use crate::scene::camera::paths::{Lens, Orbit, USUAL_FOV_X_RAD};
use crate::scene::{Camera, FrameSize, LookAt, Model};

/// PSNR of a copy that is asked for unless something else is, dB.
pub const DEFAULT_PSNR_DB: f64 = 49.0;

/// Elevations that the views stand on, degrees, and how many on each.
const ELEVATIONS_DEG: [f64; 3] = [-20.0, 30.0, 60.0];
const VIEWS: u32 = 4;
const SIDE_PX: u32 = 400;
/// Times that a strength is measured and set right: colours that have no room for more make it less than proportional.
const ROUNDS: usize = 3;
/// Strength at most, where hardly anything is seen of the asset: four times the usual amplitudes.
const STRONGEST: f64 = 4.0;
/// The copy that is measured and given to nobody.
pub(super) const TRIAL_COPY: u64 = u64::MAX;

/// The strength with which copies of an issue differ from its model by `psnr_db` on views from all around.
///
/// # Errors
/// [`EngineError::Usage`] for a PSNR that is no positive number, and for a model of which no change is seen; when
/// memory runs out or the device fails.
pub fn strength_for(device: &Device, issue: Issue<'_>, psnr_db: f64) -> Result<f64, EngineError> {
    let original = issue.model().gaussians.sh_coeffs.clone();
    strength_onto(device, issue, &original, psnr_db)?.ok_or_else(|| EngineError::Usage {
        what: "model to stamp".to_owned(),
        got: "no change of any base colour is seen from anywhere around it".to_owned(),
        expected: "one whose splats are seen, with colours that can be moved".to_owned(),
    })
}

/// The strength with which stamps add errors of `psnr_db` to what coefficients show that differ from the model's
/// already; none where no change is seen.
///
/// # Errors
/// [`EngineError::Usage`] for a PSNR that is no positive number; when memory runs out or the device fails.
pub fn strength_onto(
    device: &Device,
    issue: Issue<'_>,
    sh_coeffs: &[f32],
    psnr_db: f64,
) -> Result<Option<f64>, EngineError> {
    if !(psnr_db.is_finite() && psnr_db > 0.0) {
        return Err(EngineError::Usage {
            what: "PSNR of copies".to_owned(),
            got: psnr_db.to_string(),
            expected: "a positive number of dB".to_owned(),
        });
    }
    let model = issue.model();
    let shots = views(model)?;
    let clean = pictures(device, model, &model.gaussians.sh_coeffs, &shots)?;
    let error_of = |sh_coeffs: &[f32]| mean_error(&clean, &pictures(device, model, sh_coeffs, &shots)?);
    let before = error_of(sh_coeffs)?;
    let asked = 10f64.powf(-0.1 * psnr_db);
    let (mut issue, mut strength) = (issue, 1.0);
    for _ in 0..ROUNDS {
        issue = issue.with_strength(strength);
        let added = error_of(&issue.stamp_onto(sh_coeffs.to_vec(), TRIAL_COPY))? - before;
        if added <= 0.0 {
            return Ok(None);
        }
        // Errors grow with the square of what is added.
        strength = (strength * (asked / added).sqrt()).min(STRONGEST);
    }
    Ok(Some(strength))
}

/// Mean square of the differences of pictures.
fn mean_error(clean: &[Frame], marked: &[Frame]) -> Result<f64, EngineError> {
    let error = |(a, b): (&Frame, &Frame)| SquaredError::between(&Picture::from_frame(a), &Picture::from_frame(b));
    let errors = clean.iter().zip(marked).map(error).collect::<Result<Vec<_>, _>>()?;
    Ok(PsnrSummary::of(&errors).map_or(0.0, |psnr| 10f64.powf(-0.1 * psnr.pooled_db.0)))
}

/// Views from all around, spread over the motion.
fn views(model: &Model) -> Result<Vec<(Camera, f32)>, EngineError> {
    let lens = Lens { fov_x_rad: USUAL_FOV_X_RAD, size: FrameSize::new(SIDE_PX, SIDE_PX)? };
    let look_at = LookAt::of(model, USUAL_FOV_X_RAD);
    let mut cameras = Vec::new();
    for elevation_deg in ELEVATIONS_DEG {
        let orbit = Orbit { views: VIEWS, elevation_deg, look_at, lens };
        cameras.extend(orbit.cameras()?.views.into_iter().map(|view| view.camera));
    }
    let count = cameras.len() as f32;
    Ok(cameras.into_iter().zip(0u8..).map(|(camera, i)| (camera, (f32::from(i) + 0.5) / count)).collect())
}

/// What the model looks like with these coefficients, in 8 bits, as films show it.
fn pictures(
    device: &Device,
    model: &Model,
    sh_coeffs: &[f32],
    shots: &[(Camera, f32)],
) -> Result<Vec<Frame>, EngineError> {
    let mut gaussians = model.gaussians.clone();
    gaussians.sh_coeffs.copy_from_slice(sh_coeffs);
    let mut renderer = SceneRenderer::new(device, &gaussians, &model.motion, model.background)?;
    let mut pictures = Vec::new();
    renderer.render_clips(&[shots.to_vec()], |_, camera, pixels| {
        pictures.push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
        Ok(())
    })?;
    Ok(pictures)
}
