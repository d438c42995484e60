//! Views near the cameras of a capture.

use glam::DVec3;
use guard4d_engine::scene::camera::capture::Capture;
use guard4d_engine::scene::{Camera, LookAt};

use super::orbit;
use crate::support::close::largest;

const TARGET: DVec3 = DVec3::new(0.2, -0.1, 0.3);

fn capture(jitter_deg: f64) -> Capture {
    let cameras = orbit(6).cameras().expect("cameras").views.into_iter().map(|view| view.camera).collect();
    Capture { cameras, look_at: LookAt::at(TARGET, 4.0), jitter_deg }
}

/// The angle between two cameras as seen from the target, degrees.
fn apart(a: &Camera, b: &Camera) -> f64 {
    let side = |camera: &Camera| camera.position().as_dvec3() - TARGET;
    side(a).angle_between(side(b)).to_degrees()
}

#[test]
fn every_camera_comes_once_before_one_comes_again() {
    let capture = capture(0.0);
    let views = capture.sample(18, 4).expect("views").views;
    for round in views.chunks(6) {
        for camera in &capture.cameras {
            // Without jitter a view is its camera, but for a product in f64 and its rounding.
            let same = round.iter().filter(|view| apart(&view.camera, camera) < 1e-3);
            assert_eq!(same.count(), 1, "each once");
        }
    }
    assert_eq!(views, capture.sample(18, 4).expect("views").views, "same seed, same views");
    assert_eq!(views[..5], capture.sample(5, 4).expect("views").views, "a longer set goes on");
    assert_ne!(views, capture.sample(18, 5).expect("views").views, "another seed, another order");
}

#[test]
fn views_move_around_the_target_and_see_it_where_their_camera_does() {
    let capture = capture(6.0);
    let views = capture.sample(60, 1).expect("views").views;
    let moved = views.iter().map(|view| {
        let near = |camera: &&Camera| apart(&view.camera, camera);
        let camera = capture.cameras.iter().min_by(|a, b| near(a).total_cmp(&near(b))).expect("six");
        let target = TARGET.as_vec3();
        let (seen, depth) = view.camera.project(target).expect("in front");
        let (wanted, far) = camera.project(target).expect("in front");
        // f32 matrices at a focal length of 89 px.
        assert!((seen - wanted).length() < 1e-3 && (depth - far).abs() < 1e-5, "{seen} instead of {wanted}");
        near(&camera)
    });
    let moved: Vec<f64> = moved.collect();
    assert!(largest(moved.iter().copied()) <= 6.001 && moved.iter().any(|angle| *angle > 3.0), "{moved:?}");
}

#[test]
fn what_gives_no_views_is_a_usage_error() {
    let none = Capture { cameras: Vec::new(), ..capture(1.0) };
    for (capture, views, word) in [(none, 3, "views"), (capture(1.0), 0, "views"), (capture(f64::NAN), 3, "jitter")] {
        let error = capture.sample(views, 0).expect_err(word);
        assert!(error.exit_code() == 2 && error.to_string().contains(word), "{error}");
    }
}
