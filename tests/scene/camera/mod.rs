//! Cameras: their files, those made by rule, flights through them, and what they see.

mod cameras;
mod capture;
mod classes;
mod files;
mod flight;
mod look_at;
mod paths;

use glam::{DVec3, Vec3};
use guard4d_engine::scene::camera::paths::{Band, Lens, Orbit};
use guard4d_engine::scene::{FrameSize, LookAt};

/// Positions and matrices are f32 values near 4, inverted in f64: a few units in the last place.
const POSE_TOLERANCE: f32 = 2e-6;

fn size(width: u32, height: u32) -> FrameSize {
    FrameSize::new(width, height).expect("a small size")
}

fn lens() -> Lens {
    Lens { fov_x_rad: 0.69, size: size(64, 48) }
}

fn orbit(views: u32) -> Orbit {
    Orbit { views, elevation_deg: 30.0, look_at: LookAt::D_NERF, lens: lens() }
}

fn band() -> Band {
    Band {
        azimuth_deg: -180.0..=180.0,
        elevation_deg: 10.0..=60.0,
        distance: 0.75..=1.25,
        ..Band::around(LookAt::at(DVec3::new(0.5, -0.25, 1.0), 4.0), lens())
    }
}

fn assert_near(got: Vec3, want: Vec3, tolerance: f32) {
    assert!((got - want).abs().max_element() <= tolerance, "{got} is not {want}");
}
