//! Flights: frames that meet their cameras, what lies between, and what is refused.

use glam::{Mat3, Vec3};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::camera::flight::Ends;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::{Camera, CameraSet, FrameSize, LookAt};

use crate::support::close::largest;

/// Poses pass through f64 from f32 numbers near 4 and back: a few units in the last place.
const POSE_TOLERANCE: f32 = 2e-6;

fn size() -> FrameSize {
    FrameSize::new(64, 48).expect("a small size")
}

fn ring(views: u32) -> CameraSet {
    let lens = Lens { fov_x_rad: 0.69, size: size() };
    Orbit { views, elevation_deg: 20.0, look_at: LookAt::D_NERF, lens }.cameras().expect("a good orbit")
}

#[track_caller]
fn assert_same(got: &Camera, want: &Camera) {
    let worst = largest((got.world_to_camera - want.world_to_camera).to_cols_array().map(f32::abs));
    assert!(worst <= POSE_TOLERANCE && got.world_to_camera.is_finite(), "{got:?} is not {want:?}");
    assert_eq!((got.fx, got.fy, got.cx, got.cy), (want.fx, want.fy, want.cx, want.cy), "lens");
    assert_eq!((got.width, got.height), (want.width, want.height), "size");
}

#[test]
fn an_open_flight_meets_every_camera_from_first_to_last() {
    let set = ring(4);
    let flight = set.flight(7, Ends::Open).expect("a good flight");
    assert!(flight.in_sequence, "the frames of one film");
    let times: Vec<f32> = flight.entries().map(|(_, _, time)| time).collect();
    // Sixths, rounded once.
    assert_eq!(times, [0.0, 1.0 / 6.0, 2.0 / 6.0, 0.5, 4.0 / 6.0, 5.0 / 6.0, 1.0]);
    for (view, met) in set.views.iter().zip([0, 2, 4, 6]) {
        assert_same(&flight.views[met].camera, &view.camera);
    }
    let clips = flight.clips();
    assert_eq!((clips.len(), clips[0].len()), (1, 7), "one clip of all frames");
}

#[test]
fn a_closed_flight_comes_back_without_repeating_its_first_frame() {
    let set = ring(4);
    let flight = set.flight(8, Ends::Closed).expect("a good flight");
    for (view, met) in set.views.iter().zip([0, 2, 4, 6]) {
        assert_same(&flight.views[met].camera, &view.camera);
    }
    let positions: Vec<Vec3> = flight.views.iter().map(|view| view.camera.position()).collect();
    let steps: Vec<f32> = (0..8).map(|i| positions[i].distance(positions[(i + 1) % 8])).collect();
    for step in &steps {
        // All legs of a ring are alike, also the one that closes it; positions near 4 are rounded to f32.
        assert!((step - steps[0]).abs() < 1e-5, "{steps:?}");
    }
    assert_eq!(flight.views[7].times, [1.0], "time runs to the end all the same");
}

/// Catmull-Rom through equal steps on a line is that line at one speed; by hand at a corner.
#[test]
fn centres_follow_a_catmull_rom_spline() {
    let at = |x: f32, y: f32| {
        let mut view = ring(1).views[0].clone();
        view.camera.world_to_camera = glam::Mat4::from_translation(-Vec3::new(x, y, 0.0));
        view
    };
    let along = |views: &[[f32; 2]], frames| {
        let set = CameraSet { views: views.iter().map(|[x, y]| at(*x, *y)).collect(), in_sequence: false };
        let flight = set.flight(frames, Ends::Open).expect("a good flight");
        flight.views.iter().map(|view| view.camera.position()).collect::<Vec<_>>()
    };
    for (number, position) in along(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], 9).into_iter().enumerate() {
        let want = Vec3::X * (number as f32 / 4.0);
        assert!(position.distance(want) <= POSE_TOLERANCE, "{position} is not {want}");
    }
    // (-a + 9 b + 9 c - d) / 16 in the middle of a leg, with a = 2 b - c behind the open end.
    let corner = along(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], 7);
    assert!(corner[1].distance(Vec3::new(9.0 / 16.0, -1.0 / 16.0, 0.0)) <= POSE_TOLERANCE, "{}", corner[1]);
    assert!(corner[3].distance(Vec3::new(18.0 / 16.0, 0.5, 0.0)) <= POSE_TOLERANCE, "{}", corner[3]);
}

#[test]
fn orientation_turns_evenly_the_shorter_way_and_lenses_change_linearly() {
    let turned = |degrees: f32, focal: f32| {
        let mut view = ring(1).views[0].clone();
        let rotation = Mat3::from_rotation_z(degrees.to_radians());
        let (fx, fy, cx, cy) = (focal, 2.0 * focal, focal / 4.0, focal / 8.0);
        let camera = Camera { world_to_camera: glam::Mat4::from_mat3(rotation), fx, fy, cx, cy, ..view.camera };
        view.camera = camera;
        view
    };
    let set = CameraSet { views: vec![turned(170.0, 40.0), turned(-130.0, 80.0)], in_sequence: false };
    let flight = set.flight(5, Ends::Open).expect("a good flight");
    for (number, view) in flight.views.iter().enumerate() {
        let share = number as f32 / 4.0;
        let want = turned(170.0 + 60.0 * share, 40.0 + 40.0 * share).camera;
        assert_same(&view.camera, &want);
    }
}

#[test]
fn one_camera_stands_still_while_time_runs() {
    let set = ring(1);
    for ends in [Ends::Open, Ends::Closed] {
        let flight = set.flight(3, ends).expect("a good flight");
        let times: Vec<f32> = flight.entries().map(|(_, _, time)| time).collect();
        assert_eq!(times, [0.0, 0.5, 1.0]);
        for view in &flight.views {
            assert_same(&view.camera, &set.views[0].camera);
        }
        assert_eq!(ring(3).flight(1, ends).expect("a good flight").views[0].times, [0.0], "a single frame");
    }
}

#[test]
fn impossible_flights_are_usage_errors() {
    let refuse = |result: Result<CameraSet, EngineError>, word: &str| {
        let error = result.expect_err(word);
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(word), "`{word}` is not in `{error}`");
    };
    refuse(ring(3).flight(0, Ends::Open), "frames of a flight: 0");
    refuse(ring(3).flight(86_401, Ends::Open), "1 to 86400");
    refuse(CameraSet::default().flight(3, Ends::Closed), "cameras of a flight: none");
    let mut mixed = ring(3);
    mixed.views[2].camera = mixed.views[2].camera.resized(FrameSize::new(32, 48).expect("a small size"));
    refuse(mixed.flight(3, Ends::Open), "64x48 and, of `orbit_002`, 32x48");
}
