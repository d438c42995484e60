//! Films that were taken inside of a scene are found near the cameras of its capture.

use std::path::Path;

use glam::Vec3;
use guard4d_engine::base::observer::Unobserved;
use guard4d_engine::locate::film::Locator;
use guard4d_engine::locate::picture::Picture;
use guard4d_engine::locate::views::Vantage;
use guard4d_engine::media::Frame;
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::scene::{Camera, FrameSize, Model};

use crate::support::gpu::{Gpu, device};
use crate::support::room::{Standing, capture, room};

const SIZE: (u32, u32) = (320, 200);

fn films(gpu: &Gpu, model: &Model, cameras: &[Camera]) -> Vec<Picture> {
    let mut renderer = SceneRenderer::new(gpu, &model.gaussians, &model.motion, model.background).expect("a renderer");
    let mut film = Vec::new();
    let shots = cameras.iter().map(|camera| (*camera, 0.0)).collect();
    let each = |_: usize, camera: &Camera, pixels: &[f32]| {
        film.push(Picture::of_frame(&Frame::from_rgba32f(camera.width, camera.height, pixels)?, camera.width));
        Ok(())
    };
    renderer.render_clips(&[shots], each).expect("films");
    film
}

#[test]
fn a_film_from_within_a_room_is_found_near_the_cameras_of_its_capture() {
    let Some(gpu) = device() else { return };
    let model = Model::of_splats(Path::new("room.ply"), &room(), [0.0; 3]).expect("a model");
    let size = FrameSize::new(SIZE.0, SIZE.1).expect("a size");
    let known: Vec<Camera> = capture().into_iter().map(|standing| standing.camera(size)).collect();
    let vantage = Vantage::of(&known);
    let mut locator = Locator::new(&gpu, &model, vantage).expect("it fits");
    // From where none of them stands, through another lens, and more than a quarter of a turn around.
    let at = |number: usize| {
        let along = number as f64;
        let looks_deg = [200.0 + 24.0 * along, 6.0 - 3.0 * along];
        Standing { place: [-0.5 + 0.12 * along, 0.1 - 0.05 * along], looks_deg, fov_deg: 52.0 }.camera(size)
    };
    let truth: Vec<Camera> = (0..5).map(at).collect();
    let track = locator.locate(&model, &films(&gpu, &model, &truth), &mut Unobserved).expect("it looks");
    for (number, (fit, truth)) in track.frames.iter().zip(&truth).enumerate() {
        let fit = fit.unwrap_or_else(|| panic!("frame {number} is not found: {:?}", track.guess));
        let found = fit.pose.camera(size);
        let apart = model.gaussians.means.iter().filter_map(|mean| {
            let point = Vec3::from(*mean);
            let (place, _) = truth.project(point)?;
            let is_seen = place.x >= 0.0 && place.x < 320.0 && place.y >= 0.0 && place.y < 200.0;
            is_seen.then_some(found.project(point)?.0.distance(place))
        });
        let mut apart: Vec<f32> = apart.collect();
        apart.sort_by(f32::total_cmp);
        // The bar of all films: half a pixel at the median.
        let median = apart[apart.len() / 2];
        assert!(median < 0.5, "frame {number}: {median} px, likeness {}", fit.correlation);
    }
    // What is seen from outside is something else to look for, and nothing without a camera.
    assert_ne!(locator.sought(), Vantage::Around.digest_of(&model));
    assert_eq!(Vantage::of(&[]), Vantage::Around);
}
