//! A camera and a moment as the numbers that pictures depend on nearly one by one.
//!
//! Camera centres move pictures along bent valleys: a step aside and a turn cancel. Turns about what is looked at,
//! where that is seen, how large it appears, and the lens at that size do not.

use glam::{DMat3, DMat4, DQuat, DVec3};

use crate::scene::{Camera, FrameSize};

/// Number of parameters of a pose.
pub const PARAMETERS: usize = 8;
/// Those of where, size and lens in steps; see [`Pose::moved`].
pub const LENS: usize = 6;
/// See [`Pose::moved`].
pub const TIME: usize = 7;

/// Depth of a point that is looked at, at least, of the middle's.
const NEAREST: f64 = 0.05;
/// How much of a picture's width is a radius about what is before the camera.
const TAKEN_IN: f64 = 0.5;

/// What is looked at: the scene's middle and how large it is, or from within a scene what is before the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Middle {
    /// World units.
    pub point: DVec3,
    /// Radius of what is seen about it, world units.
    pub radius: f64,
}

/// From where and when a picture is taken. Lengths are in widths of the picture, so that its size in pixels is no part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// What the others are about.
    pub middle: Middle,
    /// World to camera.
    pub turn: DQuat,
    /// Where the middle is seen from the centre of the picture, right and down, in widths.
    pub shift: [f64; 2],
    /// Logarithm of how large the radius appears at the middle's depth, in widths.
    pub size: f64,
    /// Logarithm of the focal length, in widths.
    pub lens: f64,
    /// Moment, 0 to 1.
    pub time: f64,
}

impl Pose {
    /// The camera, of a picture with this shape.
    #[must_use]
    pub fn camera(&self, size: FrameSize) -> Camera {
        let width = f64::from(size.width());
        let focal = self.lens.exp();
        let translation = self.centre() - self.turn * self.middle.point;
        let world_to_camera = DMat4::from_rotation_translation(self.turn, translation).as_mat4();
        Camera::with_focal(world_to_camera, [focal * width, focal * width], size)
    }

    /// How far before the camera the middle is, world units.
    #[must_use]
    pub fn depth(&self) -> f64 {
        self.lens.exp() * self.middle.radius / self.size.exp()
    }

    /// The middle in camera space.
    fn centre(&self) -> DVec3 {
        let [across, down] = self.shift.map(|shift| shift / self.lens.exp());
        self.depth() * DVec3::new(across, down, 1.0)
    }

    /// That of a camera that stands somewhere: `turn` is from the world to the camera, the lens a logarithm of the
    /// focal length in widths, and time from 0 to 1. It is about what is one unit before the camera.
    #[must_use]
    pub fn standing(position: DVec3, turn: DQuat, lens: f64, time: f64) -> Self {
        let middle = Middle { point: position + turn.inverse() * DVec3::Z, radius: TAKEN_IN / lens.exp() };
        Self { middle, turn, shift: [0.0; 2], size: TAKEN_IN.ln(), lens, time }
    }

    /// The pose of a camera whose pixels are square and whose axis goes through the centre of the picture; none if the
    /// middle is behind it.
    #[must_use]
    pub fn of_camera(camera: &Camera, time: f32, middle: Middle) -> Option<Self> {
        let to_camera = camera.world_to_camera.as_dmat4();
        let turn = DQuat::from_mat3(&DMat3::from_mat4(to_camera)).normalize();
        let lens = (f64::from(camera.fx) / f64::from(camera.width)).ln();
        let here = Self::standing(camera.position().as_dvec3(), turn, lens, f64::from(time));
        let seen = to_camera.transform_point3(middle.point);
        (seen.z > 0.0).then(|| Self { middle, ..here }.with_centre(seen))
    }

    /// The same view with the middle here in camera space, before the camera.
    fn with_centre(self, seen: DVec3) -> Self {
        let focal = self.lens.exp();
        Self {
            shift: [focal * seen.x / seen.z, focal * seen.y / seen.z],
            size: (focal * self.middle.radius / seen.z).ln(),
            ..self
        }
    }

    /// The same view as numbers about another middle. One that is beside the camera or behind it is taken for one as
    /// far before it as any may be near: no picture shows both, and numbers are far apart.
    #[must_use]
    pub fn about(&self, middle: Middle) -> Self {
        if middle == self.middle {
            return *self;
        }
        let seen = self.turn * (middle.point - self.middle.point) + self.centre();
        let nearest = NEAREST * middle.radius;
        Self { middle, ..*self }.with_centre(DVec3::new(seen.x, seen.y, seen.z.max(nearest)))
    }

    /// The same view about what is so far before the camera, which takes in as much of it as the radius.
    #[must_use]
    pub fn about_depth(&self, depth: f64) -> Self {
        let point = self.middle.point + self.turn.inverse() * (DVec3::Z * depth - self.centre());
        let radius = depth * TAKEN_IN / self.lens.exp();
        self.about(Middle { point, radius })
    }

    /// Depth of a point, world units; negative behind the camera.
    #[must_use]
    pub fn depth_of(&self, point: DVec3) -> f64 {
        (self.turn * (point - self.middle.point) + self.centre()).z
    }

    /// The pose after a step: three angles about the middle in camera space (rad), right and down (widths), logarithms
    /// of size and lens, and time.
    #[must_use]
    pub fn moved(&self, step: &[f64; PARAMETERS]) -> Self {
        let [x, y, z, across, down, size, lens, time] = *step;
        Self {
            turn: (DQuat::from_scaled_axis(DVec3::new(x, y, z)) * self.turn).normalize(),
            shift: [self.shift[0] + across, self.shift[1] + down],
            size: self.size + size,
            lens: self.lens + lens,
            time: (self.time + time).clamp(0.0, 1.0),
            ..*self
        }
    }

    /// The step that leads from another pose to this one, about the other's middle.
    #[must_use]
    pub fn since(&self, other: &Self) -> [f64; PARAMETERS] {
        let here = self.about(other.middle);
        let turn = (self.turn * other.turn.inverse()).normalize();
        // The shorter way round.
        let turn = if turn.w < 0.0 { -turn } else { turn }.to_scaled_axis();
        let [across, down] = [0, 1].map(|i| here.shift[i] - other.shift[i]);
        let (size, lens, time) = (here.size - other.size, self.lens - other.lens, self.time - other.time);
        [turn.x, turn.y, turn.z, across, down, size, lens, time]
    }

    /// On the way to another pose, 0 here and 1 there.
    #[must_use]
    pub fn toward(&self, other: &Self, part: f64) -> Self {
        self.moved(&other.since(self).map(|step| part * step))
    }

    /// How the picture of a point moves with each parameter but time, right and down, in widths for each unit; none at
    /// or behind the camera.
    ///
    /// # Equation
    /// Of p in camera space and the middle at t: turns move p by e × (p − t), shifts by (d/f, 0, 0) and (0, d/f, 0),
    /// size by −t, and the lens by (0, 0, d), at the middle's depth d and the focal length f, besides u by itself.
    #[must_use]
    pub fn flow(&self, point: DVec3) -> Option<[[f64; 2]; TIME]> {
        let (focal, depth, centre) = (self.lens.exp(), self.depth(), self.centre());
        let about = self.turn * (point - self.middle.point);
        let seen = about + centre;
        if seen.z <= NEAREST * depth {
            return None;
        }
        let [u, v] = [focal * seen.x / seen.z, focal * seen.y / seen.z];
        let moved = |by: DVec3| [(focal * by.x - u * by.z) / seen.z, (focal * by.y - v * by.z) / seen.z];
        let [across, down] = [DVec3::X, DVec3::Y].map(|axis| moved(axis * (depth / focal)));
        let lens = moved(DVec3::Z * depth);
        let turned = |axis: DVec3| moved(axis.cross(about));
        Some([
            turned(DVec3::X),
            turned(DVec3::Y),
            turned(DVec3::Z),
            across,
            down,
            moved(-centre),
            [u + lens[0], v + lens[1]],
        ])
    }

    /// How far a change of each parameter moves the picture, roughly: in widths for each unit.
    #[must_use]
    pub fn reach(&self) -> [f64; PARAMETERS] {
        let radius = self.size.exp();
        // Half of the radius is where most splats are; a lens moves what is nearer or farther than the middle alone.
        let seen = 0.5 * radius;
        [seen, seen, seen, 1.0, 1.0, seen, 0.1 * seen, seen]
    }

    /// Roughly how far two poses' pictures are apart, px of a picture of this width.
    #[must_use]
    pub fn apart_px(&self, other: &Self, width: f64) -> f64 {
        let steps = self.since(other).into_iter().zip(other.reach());
        width * steps.map(|(step, reach)| (step * reach).powi(2)).sum::<f64>().sqrt()
    }
}
