//! The views that flags ask for.

use std::path::Path;

use guard4d_engine::error::EngineError;
use guard4d_engine::scene::camera::flight::Ends;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt, Model};
use guard4d_engine::watermark::embed::TrainingViews;

use crate::commands::embed::job::EvaluationSettings;
use crate::flags::views::EvaluationViews;

/// Views when neither a camera file nor a number is given.
const DEFAULT_ORBIT: u32 = 6;

/// Where views come from, and what they are like.
struct Filming<'a> {
    cameras: Option<&'a Path>,
    interpolate: Option<u32>,
    closed: bool,
    orbit: Option<u32>,
    elevation_deg: f64,
    look_at: LookAt,
    fov_deg: f64,
    frames: u32,
    /// Width and height in px of what has no size of its own.
    size: (u32, u32),
    /// What cameras show is scaled to this.
    scaled_to: Option<(u32, u32)>,
}

/// Cameras from a file or folder, a flight through them, or an orbit around the model.
pub(crate) fn cameras(args: &EvaluationViews, model: &Model) -> Result<CameraSet, EngineError> {
    let fov_deg = f64::from(args.fov);
    let LookAt { target, radius, up } = LookAt::of(model, fov_deg.to_radians());
    filmed(&Filming {
        cameras: args.cameras.as_deref(),
        interpolate: args.interpolate,
        closed: args.closed,
        orbit: args.orbit,
        elevation_deg: f64::from(args.elevation),
        look_at: LookAt {
            target: args.target.unwrap_or(target),
            radius: args.radius.unwrap_or(radius),
            up: args.up.unwrap_or(up),
        },
        fov_deg,
        frames: args.frames,
        size: args.size(),
        scaled_to: args.size,
    })
}

/// The same, where an embedding is measured: an orbit is around what training looks at.
pub(crate) fn evaluation_cameras(
    settings: &EvaluationSettings,
    training: &TrainingViews,
    model: &Model,
) -> Result<CameraSet, EngineError> {
    filmed(&Filming {
        cameras: settings.cameras.as_deref(),
        interpolate: settings.interpolate,
        closed: settings.closed,
        orbit: settings.orbit,
        elevation_deg: f64::from(settings.elevation),
        look_at: training.look_at(model),
        fov_deg: training.fov_deg,
        frames: settings.frames,
        size: training.size_px,
        scaled_to: settings.frame_px,
    })
}

fn filmed(filming: &Filming<'_>) -> Result<CameraSet, EngineError> {
    let size_of = |(width, height): (u32, u32)| FrameSize::new(width, height);
    let size = size_of(filming.size)?;
    let times = even_times(filming.frames);
    if let Some(path) = filming.cameras {
        let mut set = CameraSet::open(path, size)?;
        if let Some(size) = filming.scaled_to {
            set = set.resized(size_of(size)?);
        }
        if let Some(frames) = filming.interpolate {
            return set.flight(frames, if filming.closed { Ends::Closed } else { Ends::Open });
        }
        for view in &mut set.views {
            if view.times.is_empty() {
                view.times.clone_from(&times);
            }
        }
        return Ok(set);
    }
    let orbit = Orbit {
        views: filming.orbit.unwrap_or(DEFAULT_ORBIT),
        elevation_deg: filming.elevation_deg,
        look_at: filming.look_at,
        lens: Lens { fov_x_rad: filming.fov_deg.to_radians(), size },
    };
    Ok(orbit.cameras()?.at_times(&times))
}

/// `n` times from 0 to 1, both ends included.
pub(crate) fn even_times(n: u32) -> Vec<f32> {
    let last = n.saturating_sub(1).max(1) as f32;
    (0..n).map(|i| i as f32 / last).collect()
}
