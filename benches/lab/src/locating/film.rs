//! Films from cameras that nobody knows.

use glam::{DMat3, DVec2, DVec3};
use guard4d_engine::base::numbers::narrow;
use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose, uniform_unit};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::camera::paths::{Lens, Orbit, USUAL_FOV_X_RAD};
use guard4d_engine::scene::{Camera, FrameSize, LookAt, Model};

/// Elevations, degrees; distances, of the usual one; lenses, degrees; turns, degrees.
const ELEVATIONS: [f64; 2] = [-20.0, 80.0];
const DISTANCES: [f64; 2] = [0.6, 1.7];
const LENSES: [f64; 2] = [25.0, 75.0];
const ROLLS: [f64; 2] = [-10.0, 10.0];
/// How far beside the middle cameras aim, of the frame.
const ASIDE: f64 = 1.0 / 3.0;
/// Longer sides of frames, px.
const SIDES: [f64; 2] = [320.0, 720.0];
/// Shapes of frames.
const SHAPES: [[f64; 2]; 4] = [[16.0, 9.0], [4.0, 3.0], [1.0, 1.0], [9.0, 16.0]];
/// How fast time runs, of one pass in the film.
const SPEEDS: [f64; 2] = [0.25, 2.0];

/// Frames of a film.
pub const USUAL_FRAMES: u32 = 48;

/// The camera and the moment of each frame.
pub type Shots = Vec<(Camera, f32)>;

/// Film number `number` of a model; fewer frames than usual are the beginning of it.
///
/// # Errors
/// Never for films of a frame or more.
pub fn shots(model: &Model, number: u64, frames: u32) -> Result<Shots, EngineError> {
    let mut rng = Prf::new(&MasterSecret::from_bytes([77; 32])).stream(Purpose::HeldOutViews, number);
    let mut draw = |[low, high]: [f64; 2]| low + (high - low) * uniform_unit(&mut rng);
    let shape = SHAPES[index(draw([0.0, 4.0]))];
    let longer = draw(SIDES);
    let unit = longer / shape[0].max(shape[1]);
    let even = |side: f64| u32::try_from(2 * index(side * unit / 2.0)).unwrap_or(2).max(2);
    let size = FrameSize::new(even(shape[0]), even(shape[1]))?;
    // The lens is of the longer side.
    let fov = draw(LENSES).to_radians();
    let fov_x_rad = if shape[0] >= shape[1] { fov } else { 2.0 * ((fov / 2.0).tan() * shape[0] / shape[1]).atan() };
    let look_at = LookAt::of(model, USUAL_FOV_X_RAD);
    let moves = draw([0.0, 1.0]) < 0.7;
    let begun = [draw(ELEVATIONS), draw(DISTANCES), draw([0.0, 360.0]), draw(ROLLS)];
    let by = if moves {
        [draw([-15.0, 15.0]), draw([-0.15, 0.15]), draw([-60.0, 60.0]), draw([-3.0, 3.0])]
    } else {
        [0.0; 4]
    };
    let aside = [draw([-ASIDE, ASIDE]), draw([-ASIDE, ASIDE])];
    let (speed, from, backward) = (draw(SPEEDS), draw([0.0, 1.0]), draw([0.0, 1.0]) < 0.3);
    let lens = Lens { fov_x_rad, size };
    let mut all = Vec::new();
    for frame in 0..frames {
        let part = f64::from(frame) / f64::from(frames.max(USUAL_FRAMES) - 1);
        let [elevation, distance, azimuth, roll] = std::array::from_fn(|i| begun[i] + part * by[i]);
        let elevation_deg = elevation.clamp(ELEVATIONS[0], ELEVATIONS[1]);
        let turned = turned_about(look_at, azimuth);
        let look_at = LookAt { radius: look_at.radius * distance.clamp(DISTANCES[0], DISTANCES[1]), ..look_at };
        let camera = Orbit { views: 1, elevation_deg, look_at, lens }.cameras()?.views.remove(0).camera;
        let camera = camera.around(look_at.target, turned);
        // Aimed beside the middle: turned so that it is seen that far from the centre.
        let [x, y] = [0, 1].map(|i| (2.0 * aside[i] * (fov_x_rad / 2.0).tan() * [1.0, shape[1] / shape[0]][i]).atan());
        let aim = DMat3::from_rotation_y(x) * DMat3::from_rotation_x(-y);
        let camera = camera.turned(DMat3::from_rotation_z(roll.to_radians()) * aim);
        let time = from + speed * part * if backward { -1.0 } else { 1.0 };
        // There and back again.
        let time = 1.0 - (time.rem_euclid(2.0) - 1.0).abs();
        all.push((camera, narrow(time)));
    }
    Ok(all)
}

fn turned_about(look_at: LookAt, degrees: f64) -> DMat3 {
    DMat3::from_axis_angle(look_at.up, degrees.to_radians())
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small positive numbers")]
fn index(number: f64) -> usize {
    number as usize
}

/// Where a point is seen, for errors in pixels.
#[must_use]
pub fn seen(camera: &Camera, point: DVec3) -> Option<DVec2> {
    let (pixel, _) = camera.project(point.as_vec3())?;
    let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < camera.width as f32 && pixel.y < camera.height as f32;
    inside.then(|| pixel.as_dvec2())
}
