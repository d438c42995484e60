//! Flights: clips by a camera that moves smoothly from view to view.

use glam::{DMat3, DQuat, DVec3};

use super::cameras::{Camera, CameraSet, FrameSize, View, invert_rigid};
use crate::base::numbers::narrow;
use crate::error::EngineError;

/// Most frames of a flight: an hour at 24 frames per second.
const MAX_FRAMES: u32 = 60 * 60 * 24;

/// What comes behind the last camera of a flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ends {
    /// Nothing: the first frame is the first camera's, the last frame the last one's.
    Open,
    /// The first camera again: the clip can be repeated without a jump, its first frame is not shown twice.
    Closed,
}

/// A camera in f64.
#[derive(Clone, Copy)]
struct Stop {
    /// Camera to world.
    rotation: DQuat,
    position: DVec3,
    /// fx, fy, cx, cy.
    lens: [f64; 4],
}

impl CameraSet {
    /// A clip of `frames` frames through this set's cameras in their order, while time runs from 0 to 1.
    ///
    /// Each leg from a camera to the next takes the same number of frames. The camera's centre follows a uniform
    /// Catmull-Rom spline (E. Catmull and R. Rom, "A Class of Local Interpolating Splines", 1974), which goes through
    /// every centre without a kink; open ends are straight. Orientations turn by the shorter way at a constant rate on
    /// each leg (slerp), focal lengths and the principal point change linearly.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for no frames or more than 86400, for no cameras, and for cameras of several image sizes.
    pub fn flight(&self, frames: u32, ends: Ends) -> Result<Self, EngineError> {
        let usage = |what: &str, got: String, expected: String| {
            Err(EngineError::Usage { what: what.to_owned(), got, expected })
        };
        if !(1..=MAX_FRAMES).contains(&frames) {
            return usage("frames of a flight", frames.to_string(), format!("1 to {MAX_FRAMES}"));
        }
        let Some(first) = self.views.first().map(|view| view.camera) else {
            return usage("cameras of a flight", "none".to_owned(), "at least one".to_owned());
        };
        if let Some(other) =
            self.views.iter().find(|v| (v.camera.width, v.camera.height) != (first.width, first.height))
        {
            let size = |camera: &Camera| format!("{}x{}", camera.width, camera.height);
            let got = format!("{} and, of `{}`, {}", size(&first), other.name, size(&other.camera));
            return usage("image sizes of a flight", got, "one for all cameras".to_owned());
        }
        let size = FrameSize::new(first.width, first.height)?;
        let stops = padded(&self.views, ends);
        let (legs, divisor) = match ends {
            Ends::Open => (self.views.len() - 1, frames.saturating_sub(1).max(1) as usize),
            Ends::Closed => (self.views.len(), frames as usize),
        };
        let end = f64::from(frames.saturating_sub(1).max(1));
        let views = (0..frames).map(|frame| {
            // In whole numbers, so that a frame that meets a camera meets it exactly.
            let along = frame as usize * legs;
            let part = (along % divisor) as f64 / divisor as f64;
            let camera = between(&stops[along / divisor..], part, size);
            View {
                name: format!("flight_{frame:05}"),
                camera,
                times: vec![narrow(f64::from(frame) / end)],
                located: true,
            }
        });
        Ok(Self { views: views.collect(), in_sequence: true })
    }
}

/// The stops at `views` with one before and two behind them, so that four surround every leg.
fn padded(views: &[View], ends: Ends) -> Vec<Stop> {
    let inner: Vec<Stop> = views.iter().map(|view| Stop::of(&view.camera)).collect();
    let at = |index: usize| inner[index % inner.len()];
    let count = inner.len();
    let (before, behind) = match ends {
        Ends::Closed => (at(count - 1), [at(0), at(1)]),
        Ends::Open => {
            // A lone camera is its own neighbour.
            let straight_on = |end: Stop, next: Stop| Stop { position: 2.0 * end.position - next.position, ..end };
            (straight_on(at(0), at(1)), [straight_on(at(count - 1), at(2 * count - 2)); 2])
        }
    };
    [before].into_iter().chain(inner.iter().copied()).chain(behind).collect()
}

/// The camera that is `part` (0 to 1) of the way from the second of `stops` to the third.
fn between(stops: &[Stop], part: f64, size: FrameSize) -> Camera {
    let (from, to) = (stops[1], stops[2]);
    let [a, b, c, d] = std::array::from_fn(|i| stops[i].position);
    let position =
        b + 0.5 * part * ((c - a) + part * ((2.0 * a - 5.0 * b + 4.0 * c - d) + part * (3.0 * b - a - 3.0 * c + d)));
    let rotation = DMat3::from_quat(from.rotation.slerp(to.rotation, part).normalize());
    let [fx, fy, cx, cy] = std::array::from_fn(|i| from.lens[i] + (to.lens[i] - from.lens[i]) * part);
    let camera = Camera::with_focal(invert_rigid(rotation, position), [fx, fy], size);
    Camera { cx: narrow(cx), cy: narrow(cy), ..camera }
}

impl Stop {
    fn of(camera: &Camera) -> Self {
        let world_to_camera = camera.world_to_camera.as_dmat4();
        let rotation = DMat3::from_mat4(world_to_camera).transpose();
        let position = -(rotation * world_to_camera.w_axis.truncate());
        let lens = [camera.fx, camera.fy, camera.cx, camera.cy].map(f64::from);
        Self { rotation: DQuat::from_mat3(&rotation).normalize(), position, lens }
    }
}
