//! What a frame shows is found without a prior.

use glam::DVec3;
use guard4d_engine::locate::bank::{Bank, Edges, Guess};
use guard4d_engine::locate::pose::{Middle, Pose};
use guard4d_engine::locate::stage::{Canvas, Stage};
use guard4d_engine::locate::views::Vantage;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{FrameSize, Model, Motion};

use crate::support::gpu::device;

#[test]
fn a_frame_is_found_among_small_pictures_at_any_size_and_place() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let mut model = Model::open(scene.path()).expect("the scene opens");
    model.motion = Motion::Still;
    let mut stage = Stage::new(&gpu, &model, Vantage::Around.about()).expect("it fits");
    let bank = Bank::new(&mut stage, Vantage::Around).expect("it is drawn");
    let turn = glam::DQuat::from_rotation_x(2.2) * glam::DQuat::from_rotation_z(0.9);
    let truth = Pose { middle: stage.middle(), turn, shift: [0.15, -0.1], size: -1.6, lens: 0.2, time: 0.0 };
    let canvas = Canvas::small(FrameSize::new(160, 90).expect("a size"));
    let frame = stage.draw_pixels(&truth, canvas).expect("draws").thumbnail();
    let guesses = bank.guesses(&mut stage, &frame, Edges::AsTheyAre, 10).expect("it looks");
    let axis = |pose: &Pose| pose.turn.inverse() * DVec3::Z;
    // Pictures are 15 degrees apart, and at 24 pixels a neighbour may look as like; size within a step, place
    // within a pixel.
    let is_near = |pose: &Pose| {
        let [x, y] = [0, 1].map(|i| (pose.shift[i] - truth.shift[i]).abs());
        axis(pose).dot(axis(&truth)) > 20f64.to_radians().cos()
            && x < 0.05
            && y < 0.05
            && (pose.size - truth.size).abs() < 0.3
    };
    let found = guesses.iter().position(|guess| is_near(&guess.pose));
    assert!(found.is_some_and(|at| at < 3), "{found:?} of {guesses:?}");
    assert!(guesses.windows(2).all(|pair| pair[0].likeness >= pair[1].likeness), "best first");
    // In other colours of the same brightness it is less like all of them; without any it is still found, as a film may
    // be black and white.
    let mut in_colours = |of: f32| {
        let mut other = frame.clone();
        other.channels[1..].iter_mut().for_each(|channel| channel.values.iter_mut().for_each(|value| *value *= of));
        bank.guesses(&mut stage, &other, Edges::AsTheyAre, 10).expect("it looks")
    };
    let [other, without] = [in_colours(-1.0), in_colours(0.0)];
    let (own, other) = (guesses[0].likeness, other[0].likeness);
    assert!(other < 0.9 * own, "colours count: {own}, {other} in others");
    assert!(without.iter().any(|guess| is_near(&guess.pose)), "{without:?}");
}

#[test]
fn a_part_of_an_asset_that_fills_a_frame_is_found() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let mut model = Model::open(scene.path()).expect("the scene opens");
    model.motion = Motion::Still;
    let mut stage = Stage::new(&gpu, &model, Vantage::Around.about()).expect("it fits");
    let bank = Bank::new(&mut stage, Vantage::Around).expect("it is drawn");
    // A frame that is higher than wide, of which the asset's radius is two widths: nobody sees where it ends.
    for (shift, about_x) in [([0.3, -0.4], 2.2), ([-0.2, 0.6], 1.7)] {
        let turn = glam::DQuat::from_rotation_x(about_x) * glam::DQuat::from_rotation_z(0.9);
        let truth = Pose { middle: stage.middle(), turn, shift, size: 0.7, lens: 0.8, time: 0.0 };
        let canvas = Canvas::small(FrameSize::new(108, 192).expect("a size"));
        let frame = stage.draw_pixels(&truth, canvas).expect("draws").thumbnail();
        let guesses = bank.guesses(&mut stage, &frame, Edges::AsTheyAre, 8).expect("it looks");
        let axis = |pose: &Pose| pose.turn.inverse() * DVec3::Z;
        // As above, and places within a sixth of the radius, which is two widths.
        let is_near = |pose: &Pose| {
            let pose = pose.about(truth.middle);
            let [x, y] = [0, 1].map(|i| (pose.shift[i] - truth.shift[i]).abs());
            axis(&pose).dot(axis(&truth)) > 20f64.to_radians().cos()
                && x.max(y) < 0.3
                && (pose.size - truth.size).abs() < 0.3
        };
        let found = guesses.iter().position(|guess| is_near(&guess.pose));
        assert!(found.is_some_and(|at| at < 5), "{shift:?}: {found:?} of {guesses:?}");
    }
}

#[test]
fn what_is_beside_the_middle_of_a_picture_is_seen_from_another_side() {
    let turn = glam::DQuat::from_rotation_x(1.9) * glam::DQuat::from_rotation_z(0.4);
    let middle = Middle { point: DVec3::new(0.1, 0.2, 0.3), radius: 1.2 };
    let pose = Pose { middle, turn, shift: [0.3, -0.2], size: -1.0, lens: 0.1, time: 0.5 };
    let guess = Guess { pose, larger: 0.2, likeness: 0.7 };
    // From the camera to the middle, in the world: along the axis of the small picture, whatever the lens.
    let expected = guess.pose.turn.inverse() * DVec3::Z;
    for lens in [-0.4f64, 0.1, 1.2] {
        let through = guess.through(lens);
        let seen = DVec3::new(0.3 / lens.exp(), -0.2 / lens.exp(), 1.0).normalize();
        let along = through.turn.inverse() * seen;
        assert!((along - expected).length() < 1e-12, "{along} {expected}");
        assert_eq!((through.lens, through.shift, through.size), (lens, guess.pose.shift, guess.pose.size));
    }
    // Where the camera of the small picture stands, what is larger is so by the lens.
    let small = Pose { size: pose.size - guess.larger, ..pose };
    assert!((guess.through(guess.lens_from_there()).depth() - small.depth()).abs() < 1e-12);
}
