//! Cameras made by rule: orbits, and random views from a band around the target.

use std::ops::RangeInclusive;

use glam::{DMat3, DVec3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::cameras::{Camera, CameraSet, FrameSize, View, invert_rigid};
use super::look_at::LookAt;
use crate::base::numbers::narrow;
use crate::error::EngineError;

/// Horizontal field of view that D-NeRF scenes are filmed with, rad.
pub const USUAL_FOV_X_RAD: f64 = 0.691_111_2;

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

/// Evenly spaced azimuths on one circle around the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Orbit {
    /// Number of views.
    pub views: u32,
    /// Elevation above the horizontal plane through the target, degrees.
    pub elevation_deg: f64,
    /// What all cameras look at, and from how far.
    pub look_at: LookAt,
    /// Lens of all cameras.
    pub lens: Lens,
}

impl Orbit {
    /// The orbit's cameras; the first stands on the -y side where z is up, and azimuth turns towards +x.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for no views, a radius that is not positive, or an impossible angle.
    pub fn cameras(&self) -> Result<CameraSet, EngineError> {
        let band =
            Band { elevation_deg: self.elevation_deg..=self.elevation_deg, ..Band::around(self.look_at, self.lens) };
        band.check(self.views)?;
        let step = 360.0 / f64::from(self.views);
        Ok(named("orbit", self.views, |index| band.look_from([step * f64::from(index), self.elevation_deg], 1.0)))
    }
}

/// How far cameras stray from looking straight at their target through one lens.
#[derive(Clone, Debug, PartialEq)]
pub struct Straying {
    /// Largest angle between the line of sight and the target, degrees.
    pub aim_deg: f64,
    /// Largest turn about the line of sight either way, degrees.
    pub roll_deg: f64,
    /// Factors of the focal length.
    pub zoom: RangeInclusive<f64>,
}

impl Straying {
    /// Not at all.
    pub const NONE: Self = Self { aim_deg: 0.0, roll_deg: 0.0, zoom: 1.0..=1.0 };

    fn check(&self) -> Result<(), EngineError> {
        let usage = |what: &str, got: String, expected: &str| {
            Err(EngineError::Usage { what: what.to_owned(), got, expected: expected.to_owned() })
        };
        if !(0.0..90.0).contains(&self.aim_deg) {
            return usage("aim", self.aim_deg.to_string(), "0 to less than 90 degrees");
        }
        if !(0.0..=180.0).contains(&self.roll_deg) {
            return usage("roll", self.roll_deg.to_string(), "0 to 180 degrees");
        }
        let (low, high) = (*self.zoom.start(), *self.zoom.end());
        if !(low > 0.0 && low <= high && high.is_finite()) {
            return usage("zoom", format!("{:?}", self.zoom), "a range of positive factors");
        }
        Ok(())
    }

    /// The camera strayed; numbers are drawn for what can stray alone, so that the others stay what they are.
    fn stray(&self, camera: Camera, rng: &mut ChaCha8Rng) -> Camera {
        let mut strayed = camera;
        if self.aim_deg > 0.0 {
            let away = self.aim_deg.to_radians() * between(rng, 0.0, 1.0).sqrt();
            let (across, down) = between(rng, 0.0, std::f64::consts::TAU).sin_cos();
            strayed = strayed.turned(DMat3::from_axis_angle(DVec3::new(across, down, 0.0), away));
        }
        if self.roll_deg > 0.0 {
            let roll = between(rng, -self.roll_deg, self.roll_deg).to_radians();
            strayed = strayed.turned(DMat3::from_rotation_z(roll));
        }
        if self.zoom.start() < self.zoom.end() || *self.zoom.start() != 1.0 {
            let zoom = narrow(between(rng, *self.zoom.start(), *self.zoom.end()));
            (strayed.fx, strayed.fy) = (zoom * strayed.fx, zoom * strayed.fy);
        }
        strayed
    }
}

/// A region of camera positions around a target, in spherical coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Azimuths, degrees; where z is up, 0 is the -y side and 90 the +x side.
    pub azimuth_deg: RangeInclusive<f64>,
    /// Elevations, degrees, within \[-90,90\].
    pub elevation_deg: RangeInclusive<f64>,
    /// Distances from the target, in radii of `look_at`.
    pub distance: RangeInclusive<f64>,
    /// What cameras look at, and from how far.
    pub look_at: LookAt,
    /// Lens of all cameras.
    pub lens: Lens,
    /// How far they stray from that.
    pub straying: Straying,
}

impl Band {
    /// All around on the horizon.
    #[must_use]
    pub fn around(look_at: LookAt, lens: Lens) -> Self {
        let straying = Straying::NONE;
        Self { azimuth_deg: 0.0..=360.0, elevation_deg: 0.0..=0.0, distance: 1.0..=1.0, look_at, lens, straying }
    }

    /// Draws `views` cameras, uniform in azimuth and distance. Elevations fill their range evenly, as multiples of the
    /// golden ratio fill a circle: areas are small near the poles, from which films are taken all the same.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for no views, an empty range, a distance or zoom that is not positive, or an impossible
    /// angle.
    ///
    /// # Determinism
    /// the same `seed` gives the same cameras, and a longer set starts with the shorter one
    pub fn sample(&self, views: u32, seed: u64) -> Result<CameraSet, EngineError> {
        self.check(views)?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let first = between(&mut rng, 0.0, 1.0);
        Ok(named("random", views, |index| {
            let azimuth_deg = between(&mut rng, *self.azimuth_deg.start(), *self.azimuth_deg.end());
            let (low, high) = (self.elevation_deg.start(), self.elevation_deg.end());
            let share = (first + f64::from(index) * GOLDEN_RATIO).fract();
            let elevation_deg = low + (high - low) * share;
            let distance = between(&mut rng, *self.distance.start(), *self.distance.end());
            self.straying.stray(self.look_from([azimuth_deg, elevation_deg], distance), &mut rng)
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
        if !inside(&self.distance, f64::MIN_POSITIVE, f64::from(f32::MAX)) {
            return usage("distance", format!("{:?}", self.distance), "a range of positive factors");
        }
        let LookAt { target, radius, up } = self.look_at;
        if !(radius > 0.0 && radius <= f64::from(f32::MAX)) {
            return usage("radius", radius.to_string(), "a positive distance");
        }
        let fov = self.lens.fov_x_rad;
        if !(fov > 0.0 && fov < std::f64::consts::PI) {
            return usage("field of view", format!("{fov} rad"), "between 0 and pi");
        }
        if !target.is_finite() {
            return usage("target", format!("{target:?}"), "a finite point");
        }
        if !up.is_normalized() {
            return usage("up", format!("{up:?}"), "a vector of length 1");
        }
        self.straying.check()
    }

    /// The camera at `[azimuth, elevation]` degrees, looking at the target with the horizon level.
    ///
    /// Straight above and below, where the horizon is undefined, the azimuth says where the image's right side points.
    fn look_from(&self, angles_deg: [f64; 2], distance: f64) -> Camera {
        let [azimuth, elevation] = angles_deg.map(f64::to_radians);
        let (sin_a, cos_a) = azimuth.sin_cos();
        let (sin_e, cos_e) = elevation.sin_cos();
        let upright = self.look_at.uprights();
        let outward = upright * DVec3::new(cos_e * sin_a, -cos_e * cos_a, sin_e);
        let right = upright * DVec3::new(cos_a, sin_a, 0.0);
        let forward = -outward;
        let rotation = DMat3::from_cols(right, forward.cross(right), forward);
        let position = self.look_at.target + outward * (distance * self.look_at.radius);
        let world_to_camera = invert_rigid(rotation, position);
        Camera::with_fov(world_to_camera, self.lens.fov_x_rad, self.lens.size)
    }
}

pub(super) fn between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    let unit = f64::from(rng.next_u32()) / f64::from(u32::MAX);
    low + (high - low) * unit
}

pub(super) fn named(stem: &str, views: u32, mut camera: impl FnMut(u32) -> Camera) -> CameraSet {
    let views = (0..views).map(|index| View {
        name: format!("{stem}_{index:03}"),
        camera: camera(index),
        times: Vec::new(),
        located: true,
    });
    CameraSet { views: views.collect(), in_sequence: false }
}
