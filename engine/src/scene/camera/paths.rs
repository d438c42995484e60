//! Cameras made by rule: orbits, and random views from a band around the target. The z axis points up.

use std::ops::RangeInclusive;

use glam::{DMat3, DVec3, Vec3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::cameras::{Camera, CameraSet, FrameSize, View, invert_rigid};
use crate::error::EngineError;

/// Its multiples never come back to the same place of a circle, and leave no large gap.
const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;

/// Field of view and image size of made cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Horizontal field of view, rad.
    pub fov_x_rad: f64,
    /// Image size.
    pub size: FrameSize,
}

/// Evenly spaced azimuths on one circle around `target`.
#[derive(Clone, Debug, PartialEq)]
pub struct Orbit {
    /// Number of views.
    pub views: u32,
    /// Elevation above the horizontal plane through the target, degrees.
    pub elevation_deg: f64,
    /// Distance from the target, world units.
    pub radius: f64,
    /// Point that all cameras look at.
    pub target: Vec3,
    /// Lens of all cameras.
    pub lens: Lens,
}

impl Orbit {
    /// The orbit's cameras; the first stands on the -y side, and azimuth turns towards +x.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for no views, a radius that is not positive, or an impossible angle.
    pub fn cameras(&self) -> Result<CameraSet, EngineError> {
        let band = Band {
            azimuth_deg: 0.0..=360.0,
            elevation_deg: self.elevation_deg..=self.elevation_deg,
            radius: self.radius..=self.radius,
            target: self.target,
            lens: self.lens,
        };
        band.check(self.views)?;
        let step = 360.0 / f64::from(self.views);
        Ok(named("orbit", self.views, |index| {
            let azimuth_deg = step * f64::from(index);
            band.look_from([azimuth_deg, self.elevation_deg], self.radius)
        }))
    }
}

/// A region of camera positions around `target`, in spherical coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Azimuths, degrees; 0 is the -y side, 90 the +x side.
    pub azimuth_deg: RangeInclusive<f64>,
    /// Elevations, degrees, within \[-90,90\].
    pub elevation_deg: RangeInclusive<f64>,
    /// Distances from the target, world units.
    pub radius: RangeInclusive<f64>,
    /// Point that all cameras look at.
    pub target: Vec3,
    /// Lens of all cameras.
    pub lens: Lens,
}

impl Band {
    /// Draws `views` cameras, uniform in azimuth and radius. Elevations fill their range evenly, as multiples of the
    /// golden ratio fill a circle: areas are small near the poles, from which films are taken all the same.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for no views, an empty range, a radius that is not positive, or an impossible angle.
    ///
    /// # Determinism
    /// the same `seed` gives the same cameras, and a longer set starts with the shorter one
    pub fn sample(&self, views: u32, seed: u64) -> Result<CameraSet, EngineError> {
        self.check(views)?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut between = |low: f64, high: f64| {
            let unit = f64::from(rng.next_u32()) / f64::from(u32::MAX);
            low + (high - low) * unit
        };
        let first = between(0.0, 1.0);
        Ok(named("random", views, |index| {
            let azimuth_deg = between(*self.azimuth_deg.start(), *self.azimuth_deg.end());
            let (low, high) = (self.elevation_deg.start(), self.elevation_deg.end());
            let share = (first + f64::from(index) * GOLDEN_RATIO).fract();
            let elevation_deg = low + (high - low) * share;
            let radius = between(*self.radius.start(), *self.radius.end());
            self.look_from([azimuth_deg, elevation_deg], radius)
        }))
    }

    fn check(&self, views: u32) -> Result<(), EngineError> {
        let usage = |what: &str, got: String, expected: &str| {
            Err(EngineError::Usage { what: what.to_owned(), got, expected: expected.to_owned() })
        };
        let inside = |range: &RangeInclusive<f64>, low: f64, high: f64| {
            *range.start() >= low && range.start() <= range.end() && *range.end() <= high
        };
        if views == 0 {
            return usage("views", views.to_string(), "at least 1");
        }
        if !inside(&self.azimuth_deg, -360.0, 360.0) {
            let got = format!("{:?}", self.azimuth_deg);
            return usage("azimuth", got, "a range within -360 to 360 degrees");
        }
        if !inside(&self.elevation_deg, -90.0, 90.0) {
            let got = format!("{:?}", self.elevation_deg);
            return usage("elevation", got, "a range within -90 to 90 degrees");
        }
        if !inside(&self.radius, f64::MIN_POSITIVE, f64::from(f32::MAX)) {
            let got = format!("{:?}", self.radius);
            return usage("radius", got, "a range of positive distances");
        }
        let fov = self.lens.fov_x_rad;
        if !(fov > 0.0 && fov < std::f64::consts::PI) {
            return usage("field of view", format!("{fov} rad"), "between 0 and pi");
        }
        if !self.target.is_finite() {
            return usage("target", format!("{:?}", self.target), "a finite point");
        }
        Ok(())
    }

    /// The camera at `[azimuth, elevation]` degrees, looking at the target with the horizon level.
    ///
    /// Straight above and below, where the horizon is undefined, the azimuth says where the image's right side points.
    fn look_from(&self, angles_deg: [f64; 2], radius: f64) -> Camera {
        let [azimuth, elevation] = angles_deg.map(f64::to_radians);
        let (sin_a, cos_a) = azimuth.sin_cos();
        let (sin_e, cos_e) = elevation.sin_cos();
        let outward = DVec3::new(cos_e * sin_a, -cos_e * cos_a, sin_e);
        let right = DVec3::new(cos_a, sin_a, 0.0);
        let forward = -outward;
        let rotation = DMat3::from_cols(right, forward.cross(right), forward);
        let position = self.target.as_dvec3() + outward * radius;
        let world_to_camera = invert_rigid(rotation, position);
        Camera::with_fov(world_to_camera, self.lens.fov_x_rad, self.lens.size)
    }
}

fn named(stem: &str, views: u32, mut camera: impl FnMut(u32) -> Camera) -> CameraSet {
    let views =
        (0..views).map(|index| View { name: format!("{stem}_{index:03}"), camera: camera(index), times: Vec::new() });
    CameraSet { views: views.collect(), in_sequence: false }
}
