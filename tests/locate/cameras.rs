//! What was found of some frames becomes a camera for each, and guesses say that they are.

use glam::{DQuat, DVec3, Vec3};
use guard4d_engine::locate::align::Fit;
use guard4d_engine::locate::film::Track;
use guard4d_engine::locate::pose::{Middle, Pose};
use guard4d_engine::locate::reading::Reading;
use guard4d_engine::media::framing::Rect;
use guard4d_engine::scene::{CameraSet, FrameSize};

const MIDDLE: Middle = Middle { point: DVec3::new(0.1, 0.2, -0.3), radius: 1.5 };
const SIZE: (u32, u32) = (320, 240);

fn fit(angle: f64, time: f64) -> Fit {
    let turn = DQuat::from_rotation_x(2.0) * DQuat::from_rotation_z(angle);
    let pose = Pose { middle: MIDDLE, turn, shift: [0.05, -0.02], size: -1.0, lens: 0.3, time };
    Fit { pose, cost: 1e-4, correlation: 0.9, lens_weight: 0.0, tied: 1.0 }
}

fn reading(frames: usize, every: usize, picture: Rect) -> Reading {
    let size = FrameSize::new(SIZE.0, SIZE.1).expect("a size");
    Reading { pictures: Vec::new(), every, frames, size, picture }
}

const WHOLE: Rect = Rect { x: 0, y: 0, width: SIZE.0, height: SIZE.1 };

fn cameras(track: &Track, reading: &Reading) -> CameraSet {
    track.cameras(reading).expect("sizes are sound").expect("something is known")
}

#[test]
fn frames_that_were_not_looked_at_are_between_those_that_were_and_are_guesses() {
    // Pictures of frames 0, 2, 4 and 6; the third was not found, and a cut is before the last.
    let frames = vec![Some(fit(0.2, 0.1)), Some(fit(0.4, 0.3)), None, Some(fit(1.4, 0.8))];
    let track = Track { frames, shots: vec![0..3, 3..4], is_mirrored: false, ..Track::default() };
    let set = cameras(&track, &reading(8, 2, WHOLE));
    assert!(set.in_sequence);
    let located: Vec<bool> = set.views.iter().map(|view| view.located).collect();
    assert_eq!(located, [true, false, true, false, false, false, true, false]);
    assert_eq!(set.film().iter().filter(|shot| shot.is_some()).count(), 3, "what is no guess");
    let times: Vec<f32> = set.views.iter().map(|view| view.times[0]).collect();
    // Numbers of 32 bits.
    let expected = [0.1, 0.2, 0.3, 0.3, 0.3, 0.3, 0.8, 0.8];
    assert!(times.iter().zip(expected).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-6), "{times:?}");
    let halfway = Pose { time: 0.2, ..fit(0.3, 0.0).pose }.camera(FrameSize::new(320, 240).expect("a size"));
    let point = Vec3::new(0.4, -0.3, 0.2);
    let apart = |a: &guard4d_engine::scene::Camera, b: &guard4d_engine::scene::Camera| {
        a.project(point).expect("in front").0.distance(b.project(point).expect("in front").0)
    };
    // Sub-pixel by far; numbers of 32 bits at some hundred pixels.
    assert!(apart(&set.views[1].camera, &halfway) < 1e-3, "half of the turn");
    assert!(apart(&set.views[0].camera, &set.views[6].camera) > 10.0, "other frames are elsewhere");
}

#[test]
fn bars_and_mirrors_are_in_the_cameras() {
    let track = |is_mirrored| Track {
        frames: vec![Some(fit(0.2, 0.1))],
        shots: std::iter::once(0..1).collect(),
        is_mirrored,
        ..Track::default()
    };
    let inside = Rect { x: 0, y: 30, width: 320, height: 180 };
    let plain = cameras(&track(false), &reading(1, 1, inside)).views[0].camera;
    let mirrored = cameras(&track(true), &reading(1, 1, inside)).views[0].camera;
    let part = fit(0.2, 0.1).pose.camera(FrameSize::new(320, 180).expect("a size"));
    let seen = |camera: &guard4d_engine::scene::Camera| camera.project(Vec3::new(0.4, -0.3, 0.2)).expect("in front").0;
    // Numbers of 32 bits at some hundred pixels.
    assert!((seen(&plain) - seen(&part) - glam::Vec2::new(0.0, 30.0)).length() < 1e-3, "below the bar");
    assert_eq!((plain.width, plain.height, plain.is_mirrored()), (320, 240, false));
    assert!(mirrored.is_mirrored());
    assert!(
        (seen(&mirrored).x - (319.0 - seen(&plain).x)).abs() < 1e-3
            && (seen(&mirrored).y - seen(&plain).y).abs() < 1e-3
    );
    // Files say both.
    let set = cameras(&track(true), &reading(1, 1, inside));
    let back = CameraSet::parse(std::path::Path::new("film.json"), &set.film_json(), FrameSize::DNERF).expect("a file");
    assert!((seen(&back.views[0].camera) - seen(&mirrored)).length() < 1e-3);
    assert!(back.views[0].camera.is_mirrored() && back.views[0].located);
}

#[test]
fn what_was_not_found_is_a_guess_in_all_frames() {
    let track = Track {
        frames: vec![None, None],
        shots: std::iter::once(0..2).collect(),
        guess: Some(fit(0.2, 0.1)),
        ..Track::default()
    };
    let set = cameras(&track, &reading(2, 1, WHOLE));
    assert!(set.film().iter().all(Option::is_none) && !track.is_found());
    let back = CameraSet::parse(std::path::Path::new("film.json"), &set.film_json(), FrameSize::DNERF).expect("a file");
    assert!(back.film().iter().all(Option::is_none), "files say so, too");
    let nothing = Track { guess: None, ..track };
    assert_eq!(nothing.cameras(&reading(2, 1, WHOLE)).expect("sizes are sound"), None);
}
