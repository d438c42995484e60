//! Cameras made by rule: on circles, and at random in a band.

use glam::{Vec2, Vec3};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::camera::paths::{Band, Lens, Orbit};
use guard4d_engine::scene::{CameraSet, FrameSize};

use super::{POSE_TOLERANCE, assert_near, band, lens, orbit};
use crate::support::close::largest;
use crate::support::shared;

#[test]
fn the_orbit_stands_where_blender_and_the_shipped_cameras_do() {
    let set = orbit(6).cameras().expect("a good orbit");
    assert_eq!(set.views.len(), 6);
    let first = set.views[0].camera;
    assert_near(first.position(), Vec3::new(0.0, -12.0_f32.sqrt(), 2.0), POSE_TOLERANCE);
    let Some(path) = shared("data/models/robot/transforms_test.json") else { return };
    let shipped = CameraSet::open(&path, lens().size).expect("shipped cameras");
    let difference = first.world_to_camera - shipped.views[0].camera.world_to_camera;
    let worst = largest(difference.to_cols_array().map(f32::abs));
    assert!(worst <= POSE_TOLERANCE && difference.is_finite(), "{difference}");
}

#[test]
fn orbits_keep_radius_horizon_and_spacing() {
    let target = Vec3::new(1.0, 2.0, 3.0);
    let set = Orbit { target, ..orbit(8) }.cameras().expect("a good orbit");
    for (index, view) in set.views.iter().enumerate() {
        let (pixel, depth) = view.camera.project(target).expect("the target is in front");
        // The target projects through f32 matrices at focal 89 px: rounding stays below 1e-3 px.
        assert!((pixel - Vec2::new(31.5, 23.5)).abs().max_element() < 1e-3, "{pixel}");
        assert!((depth - 4.0).abs() < 1e-5, "{depth}");
        let (above, _) = view.camera.project(target + Vec3::Z * 0.1).expect("in front");
        assert!((above.x - pixel.x).abs() < 1e-3 && above.y < pixel.y, "upright: {above}");
        let azimuth = (index as f32 * 45.0).to_radians();
        let side = view.camera.position() - target;
        let radius = 12.0_f32.sqrt();
        assert_near(side, Vec3::new(radius * azimuth.sin(), -radius * azimuth.cos(), 2.0), 1e-5);
    }
    for elevation_deg in [90.0, -90.0] {
        let pole = Orbit { elevation_deg, ..orbit(1) }.cameras().expect("straight above and below").views[0].camera;
        assert!(pole.world_to_camera.is_finite(), "the pole has a camera");
        assert!((pole.world_to_camera.determinant() - 1.0).abs() < 1e-6, "a rotation");
    }
}

#[test]
fn band_samples_are_reproducible_and_inside() {
    let band = band();
    let set = band.sample(40, 7).expect("a good band");
    assert_eq!(set, band.sample(40, 7).expect("a good band"), "same seed, same cameras");
    assert_ne!(set, band.sample(40, 8).expect("a good band"), "another seed, other cameras");
    assert_eq!(set.views[..9], band.sample(9, 7).expect("a good band").views, "a longer set goes on");
    for view in &set.views {
        let side = view.camera.position() - band.target;
        let elevation = (side.z / side.length()).asin().to_degrees();
        // Positions are rounded to f32.
        assert!((2.9999..=5.0001).contains(&side.length()), "{}", side.length());
        assert!((9.999..=60.001).contains(&elevation), "{elevation}");
    }
    let sides = set.views.iter().map(|view| view.camera.position().x > band.target.x);
    let right = sides.filter(|right| *right).count();
    assert!((8..=32).contains(&right), "both sides are visited: {right} of 40");
}

#[test]
fn impossible_paths_are_usage_errors() {
    let refuse = |result: Result<CameraSet, EngineError>, word: &str| {
        let error = result.expect_err(word);
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(word), "`{word}` is not in `{error}`");
    };
    refuse(orbit(0).cameras(), "views");
    refuse(Orbit { radius: 0.0, ..orbit(1) }.cameras(), "radius");
    refuse(Orbit { radius: f64::NAN, ..orbit(1) }.cameras(), "radius");
    refuse(Orbit { elevation_deg: 91.0, ..orbit(1) }.cameras(), "elevation");
    refuse(Orbit { target: Vec3::NAN, ..orbit(1) }.cameras(), "target");
    refuse(Orbit { lens: Lens { fov_x_rad: 3.2, ..lens() }, ..orbit(1) }.cameras(), "field of view");
    refuse(Band { radius: 5.0..=3.0, ..band() }.sample(1, 0), "radius");
    refuse(Band { azimuth_deg: 0.0..=720.0, ..band() }.sample(1, 0), "azimuth");
    assert_eq!(FrameSize::new(0, 5).expect_err("no width").exit_code(), 2);
}
