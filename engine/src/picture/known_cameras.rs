//! Framing films whose cameras are known: the trained frame is cut out of each where it lies.

use guard4d_kernels::image::resize::ImageSize;

use super::foreground::NotFound;
use super::part::{Part, Window};
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::camera::paths::Lens;
use crate::scene::{Camera, FrameSize, LookAt};

/// A window that is as near to the whole frame as this is taken for it, in sides and as a logarithm: rounding of
/// cameras, and of films' sides to whole pixels.
const SAME: [f64; 2] = [0.005, 0.01];
/// Turns of fewer degrees are rounding.
const LEVEL_DEG: f64 = 0.05;

/// The cameras of a film, and what training's had been like.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownCameras {
    /// One for each frame in the film's order, or one for all.
    pub cameras: Vec<Camera>,
    /// What training looked at, and from how far.
    pub look_at: LookAt,
    /// What it looked through.
    pub lens: Lens,
}

impl KnownCameras {
    /// The parts of the `frames` frames of a film, all of one size.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for another number of cameras than of frames, and a size that no image has.
    pub fn parts(&self, frames: usize, size: ImageSize) -> Result<Vec<Part>, EngineError> {
        let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let frame = FrameSize::new(side(size.width), side(size.height))?;
        let one_each: Vec<&Camera> = match &self.cameras[..] {
            [all] => vec![all; frames],
            each if each.len() == frames => each.iter().collect(),
            others => {
                return Err(EngineError::Usage {
                    what: "cameras of the film".to_owned(),
                    got: others.len().to_string(),
                    expected: format!("{frames}, one for each frame that is read, or one for all"),
                });
            }
        };
        let whole = Window::whole(size);
        let part = |camera: &Camera| match self.window(&camera.resized(frame)) {
            None => Part::Fallback(NotFound::Nothing),
            Some(window) if window.turn_deg == 0.0 && window.is_near(whole, SAME) => Part::All,
            Some(window) => Part::Window(window),
        };
        Ok(one_each.into_iter().map(part).collect())
    }

    /// Where the frame of training lies that is taken from as far as it was, with the horizon level: a square of the
    /// world about what training looked at, seen face on. None if that is behind the camera.
    fn window(&self, camera: &Camera) -> Option<Window> {
        let LookAt { target, radius, up } = self.look_at;
        let (middle, depth) = camera.project(target.as_vec3())?;
        let half = radius * (self.lens.fov_x_rad / 2.0).tan();
        let shape = f64::from(self.lens.size.height()) / f64::from(self.lens.size.width());
        let across = |focal: f32| 2.0 * half * f64::from(focal) / f64::from(depth);
        let [right, down, forward] = camera.axes();
        // Straight above and below nothing is level, and the camera counts as it is.
        let level = forward.cross(up).try_normalize().unwrap_or(right);
        let turn_deg = (-level.dot(down)).atan2(level.dot(right)).to_degrees();
        Some(Window {
            // Pixel centres of cameras lie at whole numbers, edges of frames at halves.
            middle: [middle.x, middle.y].map(|at| f64::from(at) + 0.5),
            sides: [across(camera.fx), across(camera.fy) * shape],
            turn_deg: if turn_deg.abs() < LEVEL_DEG { 0.0 } else { turn_deg },
        })
        .filter(|window| window.sides.iter().all(|side| narrow(*side).is_normal()))
    }
}
