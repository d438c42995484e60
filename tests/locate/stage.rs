//! Small pictures show what a film shows, made smaller.

use guard4d_engine::locate::gray::correlation;
use guard4d_engine::locate::pose::Pose;
use guard4d_engine::locate::stage::{About, Canvas, Stage};
use guard4d_engine::scene::{FrameSize, Model};

use crate::support::gpu::device;
use crate::support::shared;

/// Likeness of small pictures to the film's, made as small, for splats that are small in the film: 0.95 and 0.93. Drawn
/// as opaque as they are, as films are drawn, small pictures from another side had 0.41 and 0.57.
const ALIKE: f64 = 0.85;

#[test]
fn small_pictures_are_what_films_are_in_small() {
    let (Some(gpu), Some(file)) = (device(), shared("data/static/biker.spz")) else { return };
    let model = Model::open(&file).expect("it opens");
    let mut stage = Stage::new(&gpu, &model, About::Middle).expect("it fits");
    let turn = glam::DQuat::from_rotation_x(2.2) * glam::DQuat::from_rotation_z(0.9);
    let pose = Pose { middle: stage.middle(), turn, shift: [0.05, -0.02], size: -0.8, lens: 0.5, time: 0.0 };
    let film = FrameSize::new(480, 360).expect("a size");
    let shown = stage.draw(&pose, Canvas::as_film(film, film)).expect("draws").picture;
    // At a radius of 16 and 24 pixels, where splats are merged.
    for width in [36u32, 54] {
        let small = FrameSize::new(width, width * 3 / 4).expect("a size");
        let drawn = stage.draw(&pose, Canvas::smallest(small)).expect("draws").picture;
        let likeness = correlation(&drawn, &shown.resized(drawn.width, drawn.height));
        assert!(likeness > ALIKE, "{likeness} at {width} px");
    }
}
