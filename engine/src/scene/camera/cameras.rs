//! Pinhole cameras and the sets of (camera, time) entries that clips are rendered from.

use glam::{DMat3, DMat4, DVec3, Mat3, Mat4, Vec2, Vec3};

use crate::base::numbers::narrow;
use crate::error::EngineError;

/// Largest image side that is believed.
const MAX_SIDE: u32 = 1 << 14;

/// Width and height of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameSize {
    width: u32,
    height: u32,
}

impl FrameSize {
    /// The size that D-NeRF scenes are rendered at when nothing else is said.
    pub const DNERF: Self = Self { width: 800, height: 800 };

    /// Checks both sides.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if a side is 0 or above 16384.
    pub fn new(width: u32, height: u32) -> Result<Self, EngineError> {
        if (1..=MAX_SIDE).contains(&width) && (1..=MAX_SIDE).contains(&height) {
            return Ok(Self { width, height });
        }
        Err(EngineError::Usage {
            what: "image size".to_owned(),
            got: format!("{width}x{height}"),
            expected: format!("sides of 1 to {MAX_SIDE} px"),
        })
    }

    /// Width in px.
    #[must_use]
    pub fn width(self) -> u32 {
        self.width
    }

    /// Height in px.
    #[must_use]
    pub fn height(self) -> u32 {
        self.height
    }
}

/// A pinhole camera, OpenCV axes: x right, y down, z forward.
///
/// Pixel centres lie at whole numbers, so the optical axis of a symmetric camera is at ((W-1)/2, (H-1)/2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Rigid transform from world to camera space, with a reflection where pictures are mirrored.
    pub world_to_camera: Mat4,
    /// Focal length along x, px.
    pub fx: f32,
    /// Focal length along y, px.
    pub fy: f32,
    /// Principal point x, px.
    pub cx: f32,
    /// Principal point y, px.
    pub cy: f32,
    /// Image width, px.
    pub width: u32,
    /// Image height, px.
    pub height: u32,
}

impl Camera {
    /// A symmetric camera with square pixels and horizontal field of view `fov_x_rad`.
    #[must_use]
    pub fn with_fov(world_to_camera: Mat4, fov_x_rad: f64, size: FrameSize) -> Self {
        let focal = f64::from(size.width) / (2.0 * (fov_x_rad / 2.0).tan());
        Self::with_focal(world_to_camera, [focal, focal], size)
    }

    /// A symmetric camera with focal lengths `[fx, fy]` in px.
    #[must_use]
    pub fn with_focal(world_to_camera: Mat4, focal: [f64; 2], size: FrameSize) -> Self {
        Self {
            world_to_camera,
            fx: narrow(focal[0]),
            fy: narrow(focal[1]),
            cx: narrow((f64::from(size.width) - 1.0) / 2.0),
            cy: narrow((f64::from(size.height) - 1.0) / 2.0),
            width: size.width,
            height: size.height,
        }
    }

    /// Camera centre in world space.
    #[must_use]
    pub fn position(&self) -> Vec3 {
        let rotation = Mat3::from_mat4(self.world_to_camera);
        -(rotation.transpose() * self.world_to_camera.w_axis.truncate())
    }

    /// The camera's axes in world space: right, down, forward.
    #[must_use]
    pub fn axes(&self) -> [DVec3; 3] {
        let rotation = Mat3::from_mat4(self.world_to_camera).as_dmat3().transpose();
        [rotation.x_axis, rotation.y_axis, rotation.z_axis]
    }

    /// The camera turned about its centre by `turn`, a rotation of camera space.
    #[must_use]
    pub fn turned(self, turn: DMat3) -> Self {
        Self { world_to_camera: (DMat4::from_mat3(turn) * self.world_to_camera.as_dmat4()).as_mat4(), ..self }
    }

    /// The camera as it sees the world after that was turned about `point` by `turn`.
    #[must_use]
    pub fn around(self, point: DVec3, turn: DMat3) -> Self {
        let world = DMat4::from_mat3_translation(turn, point - turn * point);
        Self { world_to_camera: (self.world_to_camera.as_dmat4() * world).as_mat4(), ..self }
    }

    /// The camera whose pictures are these with left and right exchanged: its world is mirrored, not turned.
    #[must_use]
    pub fn mirrored(self) -> Self {
        let mirror = DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        let world_to_camera = (mirror * self.world_to_camera.as_dmat4()).as_mat4();
        Self { world_to_camera, cx: narrow(f64::from(self.width) - 1.0 - f64::from(self.cx)), ..self }
    }

    /// Whether it shows the world as in a mirror.
    #[must_use]
    pub fn is_mirrored(&self) -> bool {
        self.world_to_camera.determinant() < 0.0
    }

    /// tan(FovX / 2), which bounds the splat Jacobian.
    #[must_use]
    pub fn tan_fovx(&self) -> f32 {
        narrow(f64::from(self.width)) / (2.0 * self.fx)
    }

    /// tan(FovY / 2).
    #[must_use]
    pub fn tan_fovy(&self) -> f32 {
        narrow(f64::from(self.height)) / (2.0 * self.fy)
    }

    /// Pixel position and depth of a world point; `None` at or behind the camera plane.
    #[must_use]
    pub fn project(&self, point: Vec3) -> Option<(Vec2, f32)> {
        let view = self.world_to_camera.transform_point3(point);
        let pixel = Vec2::new(self.fx * view.x / view.z + self.cx, self.fy * view.y / view.z + self.cy);
        (view.z > 0.0).then_some((pixel, view.z))
    }

    /// The same view at another image size; focal lengths and principal point scale with it.
    #[must_use]
    pub fn resized(&self, size: FrameSize) -> Self {
        let scale_x = narrow(f64::from(size.width) / f64::from(self.width));
        let scale_y = narrow(f64::from(size.height) / f64::from(self.height));
        Self {
            world_to_camera: self.world_to_camera,
            fx: self.fx * scale_x,
            fy: self.fy * scale_y,
            cx: (self.cx + 0.5) * scale_x - 0.5,
            cy: (self.cy + 0.5) * scale_y - 0.5,
            width: size.width,
            height: size.height,
        }
    }
}

/// One camera and the times at which it looks.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Name from the camera file, or made from the view's number.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// Times in \[0,1\]; empty if the file does not say.
    pub times: Vec<f32>,
    /// Whether it is known to be so. What a search for a film's cameras did not find is a guess, which can be drawn and
    /// is no evidence.
    pub located: bool,
}

/// Views, each with its times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraSet {
    /// In order of first appearance.
    pub views: Vec<View>,
    /// Whether the views are the frames of one clip, rather than places that a clip can be rendered from.
    pub in_sequence: bool,
}

impl CameraSet {
    /// All (view index, camera, time) entries, view by view.
    pub fn entries(&self) -> impl Iterator<Item = (usize, &Camera, f32)> {
        self.views.iter().enumerate().flat_map(|(index, view)| {
            let times = view.times.iter();
            times.map(move |&time| (index, &view.camera, time))
        })
    }

    /// What a camera that follows each view would see: a clip is a view over its times, or, where every view has
    /// one time only, the views that come k-th at each time. Views in sequence are one clip.
    #[must_use]
    pub fn clips(&self) -> Vec<Vec<(Camera, f32)>> {
        if self.in_sequence {
            return vec![self.entries().map(|(_, camera, time)| (*camera, time)).collect()];
        }
        if self.views.iter().any(|v| v.times.len() != 1) {
            let clip = |v: &View| v.times.iter().map(|&t| (v.camera, t)).collect();
            return self.views.iter().map(clip).collect();
        }
        let mut moments: Vec<(f32, Vec<Camera>)> = Vec::new();
        for (_, camera, time) in self.entries() {
            match moments.iter_mut().find(|(t, _)| *t == time) {
                Some((_, cameras)) => cameras.push(*camera),
                None => moments.push((time, vec![*camera])),
            }
        }
        moments.sort_by(|a, b| a.0.total_cmp(&b.0));
        let clips = moments.iter().map(|(_, cameras)| cameras.len()).max().unwrap_or(0);
        (0..clips).map(|k| moments.iter().filter_map(|(t, cameras)| Some((*cameras.get(k)?, *t))).collect()).collect()
    }

    /// The camera and moment of each frame of the film that [`Self::clips`] are one after the other; none where it is a
    /// guess.
    #[must_use]
    pub fn film(&self) -> Vec<Option<(Camera, f32)>> {
        if !self.in_sequence {
            return self.clips().concat().into_iter().map(Some).collect();
        }
        self.entries().map(|(view, camera, time)| self.views[view].located.then_some((*camera, time))).collect()
    }

    /// The same views at another image size, see [`Camera::resized`].
    #[must_use]
    pub fn resized(mut self, size: FrameSize) -> Self {
        for view in &mut self.views {
            view.camera = view.camera.resized(size);
        }
        self
    }

    /// The same views, all at `times`, as places to render from.
    #[must_use]
    pub fn at_times(mut self, times: &[f32]) -> Self {
        for view in &mut self.views {
            view.times = times.to_vec();
        }
        self.in_sequence = false;
        self
    }
}

/// Inverts a rigid camera-to-world transform in f64.
pub(super) fn invert_rigid(rotation: DMat3, position: DVec3) -> Mat4 {
    let inverse = rotation.transpose();
    DMat4::from_mat3_translation(inverse, -(inverse * position)).as_mat4()
}
