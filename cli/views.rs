//! The views that flags ask for.

use guard4d_engine::EngineError;
use guard4d_engine::scene::camera_paths::{Lens, Orbit};
use guard4d_engine::scene::{CameraSet, ImageSize};

use crate::args::ViewArgs;

/// Views when neither a camera file nor a number is given.
const DEFAULT_ORBIT: u32 = 6;

/// Cameras from a file, or an orbit around the scene's origin.
pub(crate) fn cameras(args: &ViewArgs) -> Result<CameraSet, EngineError> {
    let size = ImageSize::new(args.size.0, args.size.1)?;
    let times = even_times(args.frames);
    if let Some(path) = &args.cameras {
        let mut set = CameraSet::open(path, size)?;
        for view in &mut set.views {
            if view.times.is_empty() {
                view.times.clone_from(&times);
            }
        }
        return Ok(set);
    }
    let orbit = Orbit {
        views: args.orbit.unwrap_or(DEFAULT_ORBIT),
        elevation_deg: f64::from(args.elevation),
        radius: f64::from(args.radius),
        target: glam::Vec3::ZERO,
        lens: Lens { fov_x_rad: f64::from(args.fov).to_radians(), size },
    };
    Ok(orbit.cameras()?.at_times(&times))
}

/// `n` times from 0 to 1, both ends included.
pub(crate) fn even_times(n: u32) -> Vec<f32> {
    let last = n.saturating_sub(1).max(1) as f32;
    (0..n).map(|i| i as f32 / last).collect()
}
