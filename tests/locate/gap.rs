//! What is found from either side is in one place, and that is seen where it is not.

use guard4d_engine::locate::align::Fit;
use guard4d_engine::locate::film::Track;
use guard4d_engine::locate::gap::gap_px;
use guard4d_engine::locate::picture::Picture;
use guard4d_engine::locate::pose::{PARAMETERS, Pose};
use guard4d_engine::locate::stage::{About, Canvas, Stage};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{FrameSize, Model, Motion};

use crate::support::gpu::device;

const WIDTH_PX: u32 = 240;

/// A turn and a shift of so much from one frame to the next.
fn step(number: usize, angle: f64, shift: f64) -> [f64; PARAMETERS] {
    let mut step = [0.0; PARAMETERS];
    step[1] = angle * number as f64;
    step[3] = shift * number as f64;
    step
}

fn track(poses: &[Pose], is_mirrored: bool) -> Track {
    let fit = |pose: &Pose| Some(Fit { pose: *pose, cost: 0.0, correlation: 1.0, lens_weight: 0.0, tied: 1.0 });
    let all = 0..poses.len();
    Track { frames: poses.iter().map(fit).collect(), shots: vec![all], is_mirrored, ..Track::default() }
}

#[test]
fn frames_are_found_in_one_place_from_either_side_or_it_is_seen() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let mut model = Model::open(scene.path()).expect("the scene opens");
    model.motion = Motion::Still;
    let mut stage = Stage::new(&gpu, &model, About::Middle).expect("it fits");
    let turn = glam::DQuat::from_rotation_x(2.2) * glam::DQuat::from_rotation_z(0.9);
    let first = Pose { middle: stage.middle(), turn, shift: [0.05, -0.02], size: -1.2, lens: 0.2, time: 0.0 };
    let truth: Vec<Pose> = (0..5).map(|number| first.moved(&step(number, 0.02, 0.003))).collect();
    let size = FrameSize::new(WIDTH_PX, 180).expect("a size");
    let mut frames = Vec::new();
    for pose in &truth {
        let pixels = stage.draw_pixels(pose, Canvas::as_film(size, size)).expect("draws");
        frames.push(Picture { gray: pixels.drawn().picture, thumbnail: pixels.thumbnail() });
    }
    let mut gap = |frames: &[Picture], track: &Track| gap_px(&mut stage, frames, track).expect("it looks");

    let found = gap(&frames, &track(&truth, false)).expect("three frames have two behind them");
    // Steps end where they move nothing by a hundredth of a pixel.
    assert!(found < 0.05, "true cameras are {found} px apart");
    let mirrored: Vec<Picture> = frames.iter().map(Picture::mirrored).collect();
    let same = gap(&mirrored, &track(&truth, true)).expect("the same film");
    assert!((same - found).abs() < 1e-6, "in a mirror {same}, {found} without");

    // Cameras that are beside the true ones are led back.
    let beside: Vec<Pose> = truth.iter().map(|pose| pose.moved(&step(1, 0.0, 0.01))).collect();
    let expected = beside[1].apart_px(&truth[1], f64::from(WIDTH_PX));
    let seen = gap(&frames, &track(&beside, false)).expect("as many frames");
    assert!((seen - expected).abs() < 0.2 && expected > 2.0, "{seen} px seen of {expected}");

    assert_eq!(gap(&frames[..2], &track(&truth[..2], false)), None, "nothing leads back from two frames");
    assert_eq!(gap(&[], &Track::default()), None);
}
