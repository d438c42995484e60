//! Where a scene is looked at from when nobody says.

use glam::{DMat3, DQuat, DVec3, Vec3};
use serde::{Serialize, Serializer};

use super::cameras::Camera;
use crate::scene::gaussians::{Gaussians, opacity_of};
use crate::scene::model::Model;

/// Share of the splats' opacity that lies within the sphere that cameras take in: stray splats far out must not make
/// the scene small.
const TAKEN_IN: f64 = 0.98;
/// Least product of the shares of directions that the axes of cameras leave open, for a point between them to be known:
/// that of axes up to some two degrees apart.
const CROSSING: f64 = 1e-3;
/// Least length of the mean of unit vectors that point up, for them to agree on what is up.
const AGREED: f64 = 0.1;

/// The point that cameras look at, and how far they stand from it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LookAt {
    /// The point, world units; left out of files where it is the origin.
    #[serde(skip_serializing_if = "is_origin", serialize_with = "as_array")]
    pub target: DVec3,
    /// Distance, world units.
    pub radius: f64,
    /// What is up, a unit vector; left out of files where it is the z axis.
    #[serde(skip_serializing_if = "is_z", serialize_with = "as_array")]
    pub up: DVec3,
}

impl LookAt {
    /// What D-NeRF scenes, and models trained on their kind, are made for.
    pub const D_NERF: Self = Self::at(DVec3::ZERO, 4.0);

    /// A point at a distance; the z axis points up.
    #[must_use]
    pub const fn at(target: DVec3, radius: f64) -> Self {
        Self { target, radius, up: DVec3::Z }
    }

    /// What the cameras of a capture look at: the point that is nearest to all of their axes, the median distance from
    /// it, and what is up for most of them. None for axes that are as good as parallel, and without a camera.
    #[must_use]
    pub fn of_cameras(cameras: &[Camera]) -> Option<Self> {
        let (mut open, mut sum, mut up) = (DMat3::ZERO, DVec3::ZERO, DVec3::ZERO);
        for camera in cameras {
            let [_, down, forward] = camera.axes();
            // What is left of a vector without its part along the axis.
            let beside =
                DMat3::IDENTITY - DMat3::from_cols(forward * forward.x, forward * forward.y, forward * forward.z);
            open += beside;
            sum += beside * camera.position().as_dvec3();
            up -= down;
        }
        let count = cameras.len() as f64;
        if cameras.is_empty() || (open * (1.0 / count)).determinant() < CROSSING {
            return None;
        }
        let target = open.inverse() * sum;
        let away = cameras.iter().map(|camera| (camera.position().as_dvec3().distance(target), 1.0));
        let radius = quantile(away, 0.5).filter(|radius| *radius > 0.0)?;
        let up = if up.length() >= AGREED * count { up.normalize() } else { DVec3::Z };
        target.is_finite().then_some(Self { target, radius, up })
    }

    /// Turns the z axis into what is up.
    #[must_use]
    pub fn uprights(&self) -> DMat3 {
        DMat3::from_quat(DQuat::from_rotation_arc(DVec3::Z, self.up))
    }

    /// What suits a model: [`Self::D_NERF`] for one with a deformation network, which was trained on scenes of that
    /// kind, and [`Self::around`] for any other capture, which can lie anywhere.
    #[must_use]
    pub fn of(model: &Model, fov_x_rad: f64) -> Self {
        if model.motion.is_network() { Self::D_NERF } else { Self::around(&model.gaussians, fov_x_rad) }
    }

    /// So far from the middle of the splats that they fill the frame of a lens with this field of view (rad). The
    /// middle is the median along each axis, every splat counting by its opacity. [`Self::D_NERF`] where there is
    /// nothing to see.
    #[must_use]
    pub fn around(gaussians: &Gaussians, fov_x_rad: f64) -> Self {
        let splats = gaussians.means.iter().zip(gaussians.opacities.iter().map(|logit| opacity_of(*logit)));
        let all: Vec<_> = splats.map(|(mean, weight)| (Vec3::from_array(*mean).as_dvec3(), weight)).collect();
        let along = |axis: usize| quantile(all.iter().map(|(mean, weight)| (mean[axis], *weight)), 0.5);
        let (Some(x), Some(y), Some(z)) = (along(0), along(1), along(2)) else { return Self::D_NERF };
        let target = DVec3::new(x, y, z);
        let reach = quantile(all.iter().map(|(mean, weight)| (mean.distance(target), *weight)), TAKEN_IN);
        match reach.map(|reach| reach / (0.5 * fov_x_rad).sin()) {
            Some(radius) if radius.is_finite() && radius > 0.0 => Self::at(target, radius),
            _ => Self::D_NERF,
        }
    }
}

/// The least value below which `share` of the weight lies; `None` without any weight.
fn quantile(values: impl Iterator<Item = (f64, f64)>, share: f64) -> Option<f64> {
    let mut values: Vec<_> = values.filter(|(value, weight)| value.is_finite() && *weight > 0.0).collect();
    values.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let mut left = share * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let crossed = values.iter().find(|(_, weight)| {
        left -= weight;
        left <= 0.0
    });
    crossed.or(values.last()).map(|(value, _)| *value)
}

fn is_origin(target: &DVec3) -> bool {
    *target == DVec3::ZERO
}

fn is_z(up: &DVec3) -> bool {
    *up == DVec3::Z
}

fn as_array<S: Serializer>(vector: &DVec3, serializer: S) -> Result<S::Ok, S::Error> {
    vector.to_array().serialize(serializer)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A half-transparent unit cross around (5, 0, -2), and a stray splat.
    fn cross() -> Gaussians {
        let axes = [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(|axis| [axis, -axis, Vec3::ZERO]);
        let middle = Vec3::new(5.0, 0.0, -2.0);
        let mut means: Vec<[f32; 3]> = axes.map(|at| (middle + at).to_array()).collect();
        means.push([900.0; 3]);
        let mut opacities = vec![0.0; means.len()];
        opacities[9] = -9.0;
        Gaussians { means, opacities, ..Gaussians::default() }
    }

    #[test]
    fn cameras_take_in_the_splats_wherever_they_are() {
        let fov = std::f64::consts::FRAC_PI_3;
        let seen = LookAt::around(&cross(), fov);
        assert_eq!(seen.target, DVec3::new(5.0, 0.0, -2.0), "the middle");
        // Splats at distance 1 touch the edge of a field of view of 60 degrees from twice as far.
        assert!((seen.radius - 2.0).abs() < 1e-9, "{}", seen.radius);
    }

    #[test]
    fn where_nothing_is_seen_the_usual_place_will_do() {
        let nothing = Gaussians::default();
        let point = Gaussians { means: vec![[1.0; 3]], opacities: vec![0.0], ..Gaussians::default() };
        let astray = Gaussians { means: vec![[f32::NAN; 3]], opacities: vec![0.0], ..Gaussians::default() };
        for gaussians in [nothing, point, astray] {
            assert_eq!(LookAt::around(&gaussians, 0.7), LookAt::D_NERF, "{:?}", gaussians.means);
        }
    }
}
