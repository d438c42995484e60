//! Cameras as the training code of INRIA writes them.

use glam::{Vec2, Vec3};
use guard4d_engine::scene::{CameraSet, FrameSize};

use crate::support::shared;

#[test]
fn inria_and_dnerf_files_of_one_kind_agree_on_axes() {
    let Some(path) = shared("data/pth/deformable_standup_run256/cameras.json") else { return };
    let set = CameraSet::open(&path, FrameSize::DNERF).expect("an INRIA file");
    assert_eq!(set.views.len(), 170);
    for view in &set.views {
        let camera = &view.camera;
        assert!((camera.fx - 1111.111).abs() < 1e-3, "{}: {}", view.name, camera.fx);
        let (centre, depth) = camera.project(Vec3::ZERO).expect("the origin is in front");
        // D-NeRF cameras aim at the origin from radius 4.03 (formats: t.x, t.y below 2e-7); 1e-3 px of rounding.
        assert!((centre - Vec2::splat(399.5)).abs().max_element() < 1e-2, "{}: {centre}", view.name);
        assert!((depth - 4.031).abs() < 1e-2, "{}: {depth}", view.name);
    }
}
