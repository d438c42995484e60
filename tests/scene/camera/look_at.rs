//! What the cameras of a capture look at.

use glam::{DMat3, DVec3};
use guard4d_engine::scene::camera::paths::{Band, Orbit};
use guard4d_engine::scene::{Camera, LookAt};

use super::{lens, orbit};

/// Cameras are in f32, at coordinates of up to 10.
const ROUNDING: f64 = 1e-5;

fn cameras(look_at: LookAt) -> Vec<Camera> {
    let band = Band { elevation_deg: 10.0..=50.0, ..Band::around(look_at, lens()) };
    band.sample(40, 5).expect("a good band").views.into_iter().map(|view| view.camera).collect()
}

#[test]
fn a_capture_that_goes_around_a_point_is_found_to_look_at_it() {
    for up in [DVec3::Z, DVec3::new(0.0, -1.0, 0.0), DVec3::new(0.6, 0.0, 0.8)] {
        let wanted = LookAt { up, ..LookAt::at(DVec3::new(4.0, -7.0, 2.0), 3.0) };
        let LookAt { target, radius, up: found } = LookAt::of_cameras(&cameras(wanted)).expect("they cross");
        assert!(target.distance(wanted.target) < ROUNDING, "{target}");
        assert!((radius - 3.0).abs() < ROUNDING, "{radius}");
        // Forty random azimuths are not quite even.
        assert!(found.angle_between(up).to_degrees() < 10.0 && found.is_normalized(), "{found} instead of {up}");
    }
}

#[test]
fn cameras_that_tell_nothing_are_told_from_those_that_do() {
    assert_eq!(LookAt::of_cameras(&[]), None, "no camera");
    let one = orbit(1).cameras().expect("a camera").views[0].camera;
    assert_eq!(LookAt::of_cameras(&[one]), None, "one axis");
    let beside = one.around(DVec3::new(900.0, 0.0, 0.0), DMat3::from_rotation_z(1e-3));
    assert_eq!(LookAt::of_cameras(&[one, beside]), None, "axes that are as good as parallel");
    // Half of them upside down: nothing is up, and the z axis will do.
    let ring = Orbit { elevation_deg: 0.0, ..orbit(8) }.cameras().expect("cameras").views;
    let half = |(i, camera): (usize, Camera)| match i % 2 {
        0 => camera,
        _ => camera.turned(DMat3::from_rotation_z(std::f64::consts::PI)),
    };
    let mixed: Vec<Camera> = ring.into_iter().map(|view| view.camera).enumerate().map(half).collect();
    assert_eq!(LookAt::of_cameras(&mixed).expect("they cross").up, DVec3::Z);
}
