//! How much of a picture a splat may cover, which decides how far its colour moves.
//!
//! Errors of a splat are seen wherever it is, but its one sign is read once. So the asked fidelity buys more signs
//! where splats are small: large ones move less.

use crate::scene::camera::paths::USUAL_FOV_X_RAD;
use crate::scene::gaussians::opacity_of;
use crate::scene::{LookAt, Model};

/// Side of the picture, px, in which the asset is seen as by a usual camera.
const SIDE_PX: f64 = 400.0;
/// What a splat may cover there before it moves less, px: what codecs leave nothing of is no smaller. 1 is as good in
/// sharp films, and a tenth worse in bad ones.
const FREE_PX: f64 = 4.0;
/// Shares are rounded to this part, so that the last bit of another machine's exponential changes no copy.
const STEP: f64 = 1.0 / 1024.0;

/// What each splat's amplitudes are multiplied by, 0 to 1.
///
/// # Equation
/// (4 px / a)^¼ for more than 4 px, with a = 2π · opacity · σ₁σ₂, of its two larger standard deviations at the
/// asset's middle. What hides it is left out: this follows from the file alone.
pub(super) fn shares(model: &Model) -> Vec<f64> {
    let focal_px = SIDE_PX / (2.0 * (0.5 * USUAL_FOV_X_RAD).tan());
    let px_per_unit = focal_px / LookAt::of(model, USUAL_FOV_X_RAD).radius;
    let splats = model.gaussians.scales.iter().zip(&model.gaussians.opacities);
    let share = |(scales, logit): (&[f32; 3], &f32)| {
        let mut logs = scales.map(f64::from);
        logs.sort_by(f64::total_cmp);
        let covered = std::f64::consts::TAU * opacity_of(*logit) * (logs[1] + logs[2]).exp() * px_per_unit.powi(2);
        // What is no number covers nothing.
        let share = (FREE_PX / covered.max(FREE_PX)).sqrt().sqrt();
        (share / STEP).round() * STEP
    };
    splats.map(share).collect()
}
