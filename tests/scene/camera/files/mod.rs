//! Files of cameras, each in the words of its program.

mod camera_path;
mod colmap;
mod inria;
mod nerfies;
mod open;
mod transforms;

use std::path::Path;

use glam::{DVec3, Vec3};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::{Camera, CameraSet, FrameSize};
use serde_json::Value;
use tempfile::TempDir;

use super::POSE_TOLERANCE;
use crate::support::camera_writers::Shot;

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder can be made")
}

fn open(path: &Path) -> Result<CameraSet, EngineError> {
    CameraSet::open(path, FrameSize::DNERF)
}

fn parse(value: &Value) -> Result<CameraSet, EngineError> {
    CameraSet::parse(Path::new("cameras.json"), value.to_string().as_bytes(), FrameSize::DNERF)
}

/// Three cameras with lenses of their own.
fn shots() -> [Shot; 3] {
    let shot = |x: f64, focal: f64| Shot {
        focal: [focal, focal + 5.0],
        principal: [30.0, 25.0],
        ..Shot::looking(DVec3::new(x, -4.0, 1.0), DVec3::ZERO, focal, [64, 48])
    };
    [shot(0.0, 60.0), shot(1.0, 70.0), shot(2.0, 80.0)]
}

/// Asserts where a camera stands, where it looks, and its lens.
#[track_caller]
fn assert_is(camera: &Camera, shot: &Shot) {
    let position = shot.position.as_vec3();
    assert!((camera.position() - position).abs().max_element() <= POSE_TOLERANCE, "{}", camera.position());
    for (axis, want) in [(Vec3::X, shot.axes.x_axis), (Vec3::Y, shot.axes.y_axis), (Vec3::Z, shot.axes.z_axis)] {
        let got = camera.world_to_camera.transpose().transform_vector3(axis);
        assert!((got - want.as_vec3()).abs().max_element() <= POSE_TOLERANCE, "{got} is not {want}");
    }
    // Some formats keep a ratio of both focal lengths; one unit in the last place at 80 is 8e-6.
    let [fx, fy] = shot.focal.map(|focal| focal as f32);
    assert!((camera.fx - fx).abs() <= 8e-6 && (camera.fy - fy).abs() <= 8e-6, "{} {}", camera.fx, camera.fy);
    let [cx, cy] = shot.principal.map(|edge| edge as f32 - 0.5);
    assert_eq!((camera.cx, camera.cy), (cx, cy), "pixel centres instead of pixel edges");
    assert_eq!([camera.width, camera.height], shot.size, "image size");
}
