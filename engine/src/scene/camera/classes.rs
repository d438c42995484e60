//! Classes of films, by how their cameras differ from those that training takes.

use std::fmt;
use std::str::FromStr;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::cameras::{CameraSet, FrameSize};
use super::look_at::LookAt;
use super::paths::{Lens, Orbit};
use crate::error::EngineError;

/// Elevation of the classes that are about something else, degrees: within what training sees by default, and none of
/// the elevations that are looked at otherwise.
const LEVEL_DEG: f64 = 25.0;
/// Turn of a rolled camera, degrees.
const ROLL_DEG: f64 = 10.0;

/// A class of films of an asset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraClass {
    /// As training's views are, 30 degrees above the horizon.
    Usual,
    /// From 75 degrees above.
    Above,
    /// From 20 degrees below the horizon.
    Below,
    /// From 1.6 times the distance.
    Far,
    /// From 0.7 times the distance.
    Near,
    /// Through a lens of 60 degrees, 16:9.
    Wide,
    /// Through a lens of 25 degrees, from so far that the asset is as large as usual.
    Narrow,
    /// 9:16, through a lens of 30 degrees.
    Portrait,
    /// Aimed beside the asset, through a lens of 55 degrees.
    OffCentre,
    /// Turned about the line of sight by 10 degrees.
    Roll,
}

impl CameraClass {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Usual,
        Self::Above,
        Self::Below,
        Self::Far,
        Self::Near,
        Self::Wide,
        Self::Narrow,
        Self::Portrait,
        Self::OffCentre,
        Self::Roll,
    ];

    /// So many cameras of the class on a circle around an asset that training looks at so, through this lens.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for no views, and for a lens or a radius that is none.
    pub fn cameras(self, look_at: LookAt, lens: Lens, views: u32) -> Result<CameraSet, EngineError> {
        let [elevation_deg, distance] = match self {
            Self::Usual => [30.0, 1.0],
            Self::Above => [75.0, 1.0],
            Self::Below => [-20.0, 1.0],
            Self::Far => [LEVEL_DEG, 1.6],
            Self::Near => [LEVEL_DEG, 0.7],
            Self::Narrow => [LEVEL_DEG, (lens.fov_x_rad / 2.0).tan() / (25f64.to_radians() / 2.0).tan()],
            Self::Wide | Self::Portrait | Self::OffCentre | Self::Roll => [LEVEL_DEG, 1.0],
        };
        let fov_x_rad = match self {
            Self::Wide => 60f64.to_radians(),
            Self::Narrow => 25f64.to_radians(),
            Self::Portrait => 30f64.to_radians(),
            Self::OffCentre => 55f64.to_radians(),
            _ => lens.fov_x_rad,
        };
        let size = match self {
            Self::Wide => with_aspect(lens.size, [16.0, 9.0])?,
            Self::Portrait => with_aspect(lens.size, [9.0, 16.0])?,
            _ => lens.size,
        };
        let beside = if self == Self::OffCentre { DVec3::new(0.175, 0.075, 0.125) } else { DVec3::ZERO };
        let LookAt { target, radius, .. } = look_at;
        let beside = look_at.uprights() * beside;
        let look_at = LookAt { target: target + radius * beside, radius: radius * distance, ..look_at };
        let orbit = Orbit { views, elevation_deg, look_at, lens: Lens { fov_x_rad, size } };
        let mut cameras = orbit.cameras()?;
        if self == Self::Roll {
            // The camera clockwise, and so the picture counterclockwise.
            let roll = DMat3::from_rotation_z(-ROLL_DEG.to_radians());
            cameras.views.iter_mut().for_each(|view| view.camera = view.camera.turned(roll));
        }
        Ok(cameras)
    }
}

/// A frame of as many pixels in another shape; even sides, as films have them.
fn with_aspect(size: FrameSize, [across, down]: [f64; 2]) -> Result<FrameSize, EngineError> {
    let unit = (f64::from(size.width()) * f64::from(size.height()) / (across * down)).sqrt();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a side of a frame")]
    let side = |units: f64| ((unit * units / 2.0).round() * 2.0).max(2.0) as u32;
    FrameSize::new(side(across), side(down))
}

/// The name that files and the command line use.
impl fmt::Display for CameraClass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl FromStr for CameraClass {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        let found = Self::ALL.into_iter().find(|class| class.to_string() == text);
        found.ok_or_else(|| EngineError::Usage {
            what: "class of films".to_owned(),
            got: text.to_owned(),
            expected: format!("one of {}", Self::ALL.map(|class| class.to_string()).join(", ")),
        })
    }
}
