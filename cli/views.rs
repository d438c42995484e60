//! The views that flags ask for.

use guard4d_engine::EngineError;
use guard4d_engine::scene::camera_flight::Ends;
use guard4d_engine::scene::camera_paths::{Lens, Orbit};
use guard4d_engine::scene::{CameraSet, ImageSize, Model, Vantage};

use crate::args::ViewArgs;

/// Views when neither a camera file nor a number is given.
const DEFAULT_ORBIT: u32 = 6;

/// Where flags look at a model from, or what suits it.
pub(crate) fn vantage(args: &ViewArgs, model: &Model) -> Vantage {
    let Vantage { target, radius } = Vantage::of(model, f64::from(args.fov).to_radians());
    Vantage { target: args.target.unwrap_or(target), radius: args.radius.unwrap_or(radius) }
}

/// Cameras from a file or folder, a flight through them, or an orbit around the model.
pub(crate) fn cameras(args: &ViewArgs, model: &Model) -> Result<CameraSet, EngineError> {
    let (width, height) = args.size();
    let size = ImageSize::new(width, height)?;
    let times = even_times(args.frames);
    if let Some(path) = &args.cameras {
        let mut set = CameraSet::open(path, size)?;
        if args.size.is_some() {
            set = set.resized(size);
        }
        if let Some(frames) = args.interpolate {
            return set.flight(frames, if args.closed { Ends::Closed } else { Ends::Open });
        }
        for view in &mut set.views {
            if view.times.is_empty() {
                view.times.clone_from(&times);
            }
        }
        return Ok(set);
    }
    let Vantage { target, radius } = vantage(args, model);
    let orbit = Orbit {
        views: args.orbit.unwrap_or(DEFAULT_ORBIT),
        elevation_deg: f64::from(args.elevation),
        radius,
        target: target.as_vec3(),
        lens: Lens { fov_x_rad: f64::from(args.fov).to_radians(), size },
    };
    Ok(orbit.cameras()?.at_times(&times))
}

/// `n` times from 0 to 1, both ends included.
pub(crate) fn even_times(n: u32) -> Vec<f32> {
    let last = n.saturating_sub(1).max(1) as f32;
    (0..n).map(|i| i as f32 / last).collect()
}
