//! Cameras made by rule: on circles, and at random in a band.

use glam::{DMat3, DVec3, Vec2, Vec3};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::camera::paths::{Band, Lens, Orbit, Straying};
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt};

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
    let set = Orbit { look_at: LookAt::at(target.as_dvec3(), 4.0), ..orbit(8) }.cameras().expect("a good orbit");
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
        let side = view.camera.position() - band.look_at.target.as_vec3();
        let elevation = (side.z / side.length()).asin().to_degrees();
        // Positions are rounded to f32.
        assert!((2.9999..=5.0001).contains(&side.length()), "{}", side.length());
        assert!((9.999..=60.001).contains(&elevation), "{elevation}");
    }
    let sides = set.views.iter().map(|view| view.camera.position().x > 0.5);
    let right = sides.filter(|right| *right).count();
    assert!((8..=32).contains(&right), "both sides are visited: {right} of 40");
}

#[test]
fn what_is_up_is_up_in_the_picture() {
    for up in [DVec3::Y, -DVec3::Y, DVec3::new(0.36, -0.48, 0.8), -DVec3::Z] {
        let look_at = LookAt { up, ..LookAt::at(DVec3::new(1.0, 2.0, 3.0), 4.0) };
        let cameras = Orbit { look_at, ..orbit(6) }.cameras().expect("a good orbit");
        for view in cameras.views {
            let target = look_at.target.as_vec3();
            let (middle, depth) = view.camera.project(target).expect("in front");
            let (above, _) = view.camera.project(target + 0.1 * up.as_vec3()).expect("in front");
            // f32 matrices at a focal length of 89 px.
            assert!((above.x - middle.x).abs() < 1e-3 && above.y < middle.y, "{up}: {above} above {middle}");
            assert!((depth - 4.0).abs() < 1e-5, "{up}: {depth}");
            let height = (view.camera.position() - target).as_dvec3().dot(up);
            assert!((height - 2.0).abs() < 1e-5, "{up}: 30 degrees above, {height}");
        }
    }
}

#[test]
fn cameras_stray_as_far_as_they_may_and_stay_where_they_are() {
    let band = band();
    let straight = band.sample(60, 3).expect("a good band");
    // Of one thing each: what is drawn for it moves the places of those to come.
    let strayed = |straying| Band { straying, ..band.clone() }.sample(60, 3).expect("a good band");
    assert_eq!(strayed(Straying::NONE), straight, "nothing strays");
    let target = band.look_at.target.as_vec3();
    let aims = strayed(Straying { aim_deg: 8.0, ..Straying::NONE }).views.into_iter().map(|view| {
        let side = (target - view.camera.position()).as_dvec3().normalize();
        side.angle_between(view.camera.axes()[2]).to_degrees()
    });
    let aims: Vec<f64> = aims.collect();
    // Angles of cameras in f32.
    assert!(largest(aims.iter().copied()) <= 8.001 && aims.iter().any(|aim| *aim > 6.0), "{aims:?}");
    let rolls = strayed(Straying { roll_deg: 20.0, ..Straying::NONE }).views.into_iter().map(|view| {
        let [right, down, _] = view.camera.axes();
        right.z.atan2(-down.z).to_degrees()
    });
    let rolls: Vec<f64> = rolls.collect();
    assert!(largest(rolls.iter().map(|roll| roll.abs())) <= 20.001, "{rolls:?}");
    assert!(rolls.iter().any(|roll| *roll > 15.0) && rolls.iter().any(|roll| *roll < -15.0), "{rolls:?}");
    let zooms = strayed(Straying { zoom: 0.5..=2.0, ..Straying::NONE }).views.into_iter();
    let zooms: Vec<f32> = zooms.map(|view| view.camera.fx / straight.views[0].camera.fx).collect();
    assert!(zooms.iter().all(|zoom| (0.4999..2.0001).contains(zoom)), "{zooms:?}");
    assert!(zooms.iter().any(|zoom| *zoom < 0.7) && zooms.iter().any(|zoom| *zoom > 1.7), "{zooms:?}");
    let turned = straight.views[0].camera.turned(DMat3::from_rotation_z(0.3));
    assert_near(turned.position(), straight.views[0].camera.position(), 1e-5);
}

#[test]
fn impossible_paths_are_usage_errors() {
    let refuse = |result: Result<CameraSet, EngineError>, word: &str| {
        let error = result.expect_err(word);
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(word), "`{word}` is not in `{error}`");
    };
    refuse(orbit(0).cameras(), "views");
    let at = |look_at| Orbit { look_at, ..orbit(1) }.cameras();
    refuse(at(LookAt { radius: 0.0, ..LookAt::D_NERF }), "radius");
    refuse(at(LookAt { radius: f64::NAN, ..LookAt::D_NERF }), "radius");
    refuse(Orbit { elevation_deg: 91.0, ..orbit(1) }.cameras(), "elevation");
    refuse(at(LookAt { target: DVec3::NAN, ..LookAt::D_NERF }), "target");
    refuse(at(LookAt { up: DVec3::ZERO, ..LookAt::D_NERF }), "up");
    refuse(Orbit { lens: Lens { fov_x_rad: 3.2, ..lens() }, ..orbit(1) }.cameras(), "field of view");
    refuse(Band { distance: 5.0..=3.0, ..band() }.sample(1, 0), "distance");
    refuse(Band { azimuth_deg: 0.0..=720.0, ..band() }.sample(1, 0), "azimuth");
    let straying = |straying| Band { straying, ..band() }.sample(1, 0);
    refuse(straying(Straying { aim_deg: 90.0, ..Straying::NONE }), "aim");
    refuse(straying(Straying { roll_deg: -1.0, ..Straying::NONE }), "roll");
    refuse(straying(Straying { zoom: 0.0..=1.0, ..Straying::NONE }), "zoom");
    assert_eq!(FrameSize::new(0, 5).expect_err("no width").exit_code(), 2);
}
