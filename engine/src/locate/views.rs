//! From where an asset is looked at for the small pictures that films are compared with.

use glam::{DMat3, DQuat, DVec3};

use super::pose::Pose;
use super::stage::{About, Stage};
use crate::base::digest::Digest;
use crate::base::numbers::narrow;
use crate::base::spread::spread;
use crate::scene::camera::paths::{Lens, Orbit, USUAL_FOV_X_RAD};
use crate::scene::{Camera, FrameSize, Model};

/// Directions on a whole sphere, some 15 degrees apart.
const DIRECTIONS: u32 = 183;
/// Elevations that cameras are looked for at, degrees.
const ELEVATIONS_DEG: [f64; 2] = [-35.0, 90.0];
/// Moments of a moving asset.
pub(super) const MOMENTS: u32 = 8;
/// Places within a scene, of those where cameras are known to stand; views from each, all around and a little up and
/// down, as far apart as half of a picture; and so many as the cameras have them.
const PLACES: usize = 16;
const AZIMUTHS: u32 = 15;
const TILTS_DEG: [f64; 3] = [0.0, -25.0, 25.0];
const OWN_VIEWS: usize = 64;

/// From where films of an asset may have been taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Vantage<'a> {
    /// From outside, all around.
    Around,
    /// From within a scene, near where these cameras stand; any way they look.
    Near(&'a [Camera]),
}

impl<'a> Vantage<'a> {
    /// Near cameras, if any are known.
    #[must_use]
    pub fn of(near: &'a [Camera]) -> Self {
        if near.is_empty() { Self::Around } else { Self::Near(near) }
    }

    /// What poses are about that are looked for.
    #[must_use]
    pub fn about(self) -> About {
        match self {
            Self::Around => About::Middle,
            Self::Near(_) => About::Seen,
        }
    }

    /// Hash of what is looked for from here.
    #[must_use]
    pub fn digest_of(self, model: &Model) -> Digest {
        Digest::of(format!("{} {self:?}", model.digest()).as_bytes())
    }

    /// The views of square pictures through a usual lens.
    pub(super) fn views(self, stage: &Stage) -> Vec<Pose> {
        match self {
            Self::Around => all_around(stage),
            Self::Near(cameras) => near(stage, cameras),
        }
    }
}

/// Views of each moment, from all directions.
fn all_around(stage: &Stage) -> Vec<Pose> {
    let moments = if stage.moves() { MOMENTS } else { 1 };
    let at = |moment| directions().filter_map(move |direction| from_outside(stage, direction, time_of(moment)));
    (0..moments).flat_map(at).collect()
}

/// From 0 to 1.
fn time_of(moment: u32) -> f64 {
    f64::from(moment) / f64::from(MOMENTS - 1)
}

/// Directions evenly over the sphere (a spiral of golden angles), z up.
fn directions() -> impl Iterator<Item = DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let [low, high] = ELEVATIONS_DEG.map(|degrees| degrees.to_radians().sin());
    let at = move |i: u32| {
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(DIRECTIONS);
        let (sin, cos) = (golden * f64::from(i)).sin_cos();
        let across = (1.0 - z * z).sqrt();
        DVec3::new(across * cos, across * sin, z)
    };
    (0..DIRECTIONS).map(at).filter(move |direction| (low..=high).contains(&direction.z))
}

/// Upright, at the usual distance.
fn from_outside(stage: &Stage, direction: DVec3, time: f64) -> Option<Pose> {
    // Any square: poses are in widths of pictures.
    let lens = Lens { fov_x_rad: USUAL_FOV_X_RAD, size: FrameSize::new(64, 64).ok()? };
    let look_at = stage.look_at();
    let elevation_deg = direction.z.asin().to_degrees();
    let camera = Orbit { views: 1, elevation_deg, look_at, lens }.cameras().ok()?.views.first()?.camera;
    let camera = camera.around(look_at.target, DMat3::from_axis_angle(look_at.up, direction.y.atan2(direction.x)));
    Pose::of_camera(&camera, narrow(time), stage.middle())
}

/// Views as the cameras have them, and all around from some of their places. A scene is looked at from within at one
/// moment in each: most of it is still.
fn near(stage: &Stage, cameras: &[Camera]) -> Vec<Pose> {
    let up = -cameras.iter().map(|camera| camera.axes()[1]).sum::<DVec3>();
    let own = spread(cameras.len(), OWN_VIEWS).map(|number| Standing::of(&cameras[number]));
    let around = apart(cameras).into_iter().flat_map(|place| Standing::of(&cameras[place]).around(up));
    let moment_of = |moment| if stage.moves() { moment } else { 0 };
    let each = (0..MOMENTS).cycle().zip(own.chain(around));
    each.map(|(moment, standing)| standing.pose(time_of(moment_of(moment)))).collect()
}

/// Cameras that stand far apart: each is farthest from those before it.
fn apart(cameras: &[Camera]) -> Vec<usize> {
    let place = |at: usize| cameras[at].position().as_dvec3();
    let mut far = vec![f64::INFINITY; cameras.len()];
    let mut places = Vec::new();
    while places.len() < PLACES {
        let farthest = (0..cameras.len()).max_by(|a, b| far[*a].total_cmp(&far[*b])).filter(|at| far[*at] > 0.0);
        let Some(next) = farthest else { break };
        far.iter_mut().enumerate().for_each(|(at, far)| *far = far.min(place(at).distance(place(next))));
        places.push(next);
    }
    places
}

/// Where a camera is, and which way it looks.
#[derive(Clone, Copy)]
struct Standing {
    position: DVec3,
    /// World to camera.
    turn: DMat3,
}

impl Standing {
    fn of(camera: &Camera) -> Self {
        let [right, down, forward] = camera.axes();
        Self { position: camera.position().as_dvec3(), turn: DMat3::from_cols(right, down, forward).transpose() }
    }

    /// The same place, looking all around, a little up and a little down; nothing where nobody says what is up.
    fn around(self, up: DVec3) -> Vec<Self> {
        let Some(up) = up.try_normalize() else { return Vec::new() };
        let begin = up.any_orthonormal_vector();
        let turned = |azimuth: u32| {
            let angle = std::f64::consts::TAU * f64::from(azimuth) / f64::from(AZIMUTHS);
            TILTS_DEG.map(|tilt| {
                let (rise, level) = tilt.to_radians().sin_cos();
                let forward = level * (DQuat::from_axis_angle(up, angle) * begin) + rise * up;
                let right = forward.cross(up).normalize();
                Self { turn: DMat3::from_cols(right, forward.cross(right), forward).transpose(), ..self }
            })
        };
        (0..AZIMUTHS).flat_map(turned).collect()
    }

    /// Through a usual lens.
    fn pose(self, time: f64) -> Pose {
        let lens = (0.5 / (USUAL_FOV_X_RAD / 2.0).tan()).ln();
        Pose::standing(self.position, DQuat::from_mat3(&self.turn).normalize(), lens, time)
    }
}
