//! Random views near the cameras of a capture.

use glam::{DMat3, DVec3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::cameras::{Camera, CameraSet};
use super::look_at::LookAt;
use super::paths::{between, named};
use crate::base::prf::uniform_below;
use crate::error::EngineError;

/// The cameras of a capture, and how far from them views are taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// Its cameras.
    pub cameras: Vec<Camera>,
    /// What they look at: views move around it.
    pub look_at: LookAt,
    /// Largest angle between a view and its camera as seen from there, degrees.
    pub jitter_deg: f64,
}

impl Capture {
    /// Draws `views` views: every camera comes once in a random order before one comes again.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for no views or cameras, or an impossible angle.
    ///
    /// # Determinism
    /// the same `seed` gives the same views, and a longer set starts with the shorter one
    pub fn sample(&self, views: u32, seed: u64) -> Result<CameraSet, EngineError> {
        let usage = |what: &str, got: String, expected: &str| {
            Err(EngineError::Usage { what: what.to_owned(), got, expected: expected.to_owned() })
        };
        if views == 0 || self.cameras.is_empty() {
            return usage("views", format!("{views} of {} cameras", self.cameras.len()), "at least 1 of 1");
        }
        if !(0.0..=90.0).contains(&self.jitter_deg) {
            return usage("jitter", self.jitter_deg.to_string(), "0 to 90 degrees");
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut waiting: Vec<usize> = Vec::new();
        Ok(named("capture", views, |_| {
            if waiting.is_empty() {
                waiting = (0..self.cameras.len()).collect();
            }
            let left = u32::try_from(waiting.len()).unwrap_or(u32::MAX);
            let camera = self.cameras[waiting.swap_remove(uniform_below(&mut rng, left) as usize)];
            camera.around(self.look_at.target, self.jitter(&mut rng))
        }))
    }

    /// A turn about a random axis.
    fn jitter(&self, rng: &mut ChaCha8Rng) -> DMat3 {
        let height = between(rng, -1.0, 1.0);
        let (sin, cos) = between(rng, 0.0, std::f64::consts::TAU).sin_cos();
        let level = (1.0 - height * height).sqrt();
        let angle = between(rng, 0.0, self.jitter_deg).to_radians();
        DMat3::from_axis_angle(DVec3::new(level * cos, level * sin, height), angle)
    }
}
