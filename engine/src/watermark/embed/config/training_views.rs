//! Where training looks at a scene from.

use clap::Args;
use glam::DVec3;
use guard4d_kernels::image::resize::ImageSize;
use serde::{Deserialize, Serialize};

use super::parse::{check, direction, point, range, single, size, word};
use super::training_camera::TrainingCamera;
use crate::error::EngineError;
use crate::scene::camera::capture::Capture;
use crate::scene::camera::paths::{Band, Lens, Straying};
use crate::scene::{Camera, CameraSet, FrameSize, LookAt, Model};

/// Most cameras of a capture that views are taken near: more of them tell no more of a scene.
const MOST_CAMERAS: usize = 256;
/// Largest difference between the shapes of cameras and training frames, as a logarithm of width over height.
const SAME_SHAPE: f64 = 0.02;
/// How far training goes from the cameras of a capture, degrees. A view between two of training's is read 10 points
/// worse than these, so that training goes into the gaps.
const JITTER_DEG: f64 = 5.0;

/// Views that training takes: all around a point and looking at it, or near the cameras of a capture. A part of the
/// scene that they do not see is not marked.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Training views")]
pub struct TrainingViews {
    /// Point that training looks at; by default the origin for a moving model, and the middle of the splats of a static
    /// one
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<[f64; 3]>,
    /// Distance from there in scene units; by default 4 for a moving model, and as far as fills the frame for a static
    /// one
    #[arg(long, value_name = "UNITS")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius: Option<f64>,
    /// What is up in the scene; by default the z axis
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true, hide = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// Horizontal field of view in degrees
    #[arg(long = "fov", value_name = "DEGREES", value_parser = single)]
    pub fov_deg: f64,
    /// Size of training frames in pixels
    #[arg(long = "size", value_name = "WIDTHxHEIGHT", value_parser = size)]
    pub size_px: (u32, u32),
    /// Training clips of eight frames
    #[arg(long = "train-clips", value_name = "N", hide = true)]
    pub clips: u32,
    /// Elevations in degrees above the horizon
    #[arg(long = "train-elevation", value_name = "LOW..HIGH", value_parser = range::<f64>, hide = true)]
    #[arg(allow_hyphen_values = true)]
    pub elevation_deg: (f64, f64),
    /// Azimuths in degrees, by default all around; 0 is the -y side where z is up, 90 the +x side
    #[arg(long = "train-azimuth", value_name = "LOW..HIGH", value_parser = range::<f64>, hide = true)]
    #[arg(allow_hyphen_values = true)]
    #[serde(default = "all_around", skip_serializing_if = "is_all_around")]
    pub azimuth_deg: (f64, f64),
    /// Distances, as factors of the radius; by default 1..1
    #[arg(long = "train-distance", value_name = "LOW..HIGH", value_parser = range::<f64>, hide = true)]
    #[serde(default = "as_it_is", skip_serializing_if = "is_as_it_is")]
    pub distance: (f64, f64),
    /// Focal lengths, as factors of what the field of view says; by default 1..1
    #[arg(long = "train-zoom", value_name = "LOW..HIGH", value_parser = range::<f64>, hide = true)]
    #[serde(default = "as_it_is", skip_serializing_if = "is_as_it_is")]
    pub zoom: (f64, f64),
    /// Largest angle between a line of sight and the point that training looks at in degrees; by default 0
    #[arg(long = "train-aim", value_name = "DEGREES", hide = true)]
    #[serde(default, skip_serializing_if = "is_nothing")]
    pub aim_deg: f64,
    /// Largest turn about the line of sight either way in degrees; by default 0
    #[arg(long = "train-roll", value_name = "DEGREES", hide = true)]
    #[serde(default, skip_serializing_if = "is_nothing")]
    pub roll_deg: f64,
    /// Cameras of a capture, near which views are taken instead of all around; none for the latter
    #[arg(skip)]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<TrainingCamera>,
    /// How far views go from the cameras of a capture in degrees, as seen from what these look at; by default 5
    #[arg(long = "train-jitter", value_name = "DEGREES", hide = true)]
    #[serde(default = "jitter", skip_serializing_if = "is_jitter")]
    pub jitter_deg: f64,
    /// Largest turn of a camera around the scene between two frames in degrees, where all frames of a clip are of one
    /// camera
    #[arg(long = "turn", value_name = "DEGREES", hide = true)]
    pub turn_deg: f64,
    /// Whether films are framed as training views are before CLIP sees them: `known` by what these look like, `whole`
    /// not at all, `auto` if the scene stands out from its background in nearly all of them
    #[arg(long, value_name = "HOW", value_parser = framing, hide = true)]
    #[serde(default = "whole")]
    pub framing: FramingChoice,
}

/// Whether films are framed as training views are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FramingChoice {
    /// If the scene stands out.
    Auto,
    /// No: frames are shown whole.
    Whole,
    /// Yes, see [`crate::picture::known_views`].
    Known,
}

fn framing(text: &str) -> Result<FramingChoice, EngineError> {
    word("framing", text)
}

/// What settings from before there was a choice mean.
fn whole() -> FramingChoice {
    FramingChoice::Whole
}

fn all_around() -> (f64, f64) {
    (0.0, 360.0)
}

fn is_all_around(azimuth_deg: &(f64, f64)) -> bool {
    *azimuth_deg == all_around()
}

fn as_it_is() -> (f64, f64) {
    (1.0, 1.0)
}

fn is_as_it_is(factors: &(f64, f64)) -> bool {
    *factors == as_it_is()
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn is_nothing(degrees: &f64) -> bool {
    *degrees == 0.0
}

fn jitter() -> f64 {
    JITTER_DEG
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn is_jitter(degrees: &f64) -> bool {
    *degrees == jitter()
}

impl TrainingViews {
    /// Views of this size, all around from 30 degrees below the horizon to straight above.
    #[must_use]
    pub fn new(size_px: (u32, u32), clips: u32) -> Self {
        Self {
            target: None,
            radius: None,
            up: None,
            fov_deg: 39.6,
            size_px,
            clips,
            elevation_deg: (-30.0, 90.0),
            azimuth_deg: all_around(),
            distance: as_it_is(),
            zoom: as_it_is(),
            aim_deg: 0.0,
            roll_deg: 0.0,
            cameras: Vec::new(),
            jitter_deg: jitter(),
            turn_deg: 12.0,
            framing: FramingChoice::Auto,
        }
    }

    /// Where they look at a model from: what is set, and for the rest what the cameras of a capture look at, or what
    /// suits the model.
    #[must_use]
    pub fn look_at(&self, model: &Model) -> LookAt {
        let cameras: Vec<Camera> = self.cameras.iter().map(TrainingCamera::camera).collect();
        let found = LookAt::of_cameras(&cameras);
        let LookAt { target, radius, up } = found.unwrap_or_else(|| LookAt::of(model, self.fov_deg.to_radians()));
        LookAt {
            target: self.target.map_or(target, DVec3::from_array),
            radius: self.radius.unwrap_or(radius),
            up: self.up.map_or(up, DVec3::from_array),
        }
    }

    /// The same from this place.
    #[must_use]
    pub fn looking_at(self, look_at: LookAt) -> Self {
        let LookAt { target, radius, up } = look_at;
        let up = (up != DVec3::Z).then(|| up.to_array());
        Self { target: Some(target.to_array()), radius: Some(radius), up, ..self }
    }

    /// The same near the cameras of a capture, evenly chosen where there are very many, and through their lens.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for no cameras, and for cameras of another shape than the frames of training.
    pub fn near(self, capture: &CameraSet) -> Result<Self, EngineError> {
        let views = &capture.views;
        let most = views.len().min(MOST_CAMERAS);
        let chosen: Vec<Camera> = (0..most).map(|i| views[i * views.len() / most].camera).collect();
        let usage = |got: String, expected: String| {
            Err(EngineError::Usage { what: "cameras of training".to_owned(), got, expected })
        };
        let (width, height) = self.size_px;
        let shape = f64::from(width) / f64::from(height);
        for camera in &chosen {
            let own = f64::from(camera.width) / f64::from(camera.height);
            if (own / shape).ln().abs() > SAME_SHAPE {
                let got = format!("{} x {} px", camera.width, camera.height);
                return usage(got, format!("the shape of training frames, {width} x {height} px; set --size"));
            }
        }
        let mut fov: Vec<f64> = chosen.iter().map(|camera| 2.0 * f64::from(camera.tan_fovx()).atan()).collect();
        let middle = fov.len() / 2;
        if fov.is_empty() {
            return usage("none".to_owned(), "at least one".to_owned());
        }
        let fov_deg = fov.select_nth_unstable_by(middle, f64::total_cmp).1.to_degrees();
        Ok(Self { cameras: chosen.iter().map(TrainingCamera::of).collect(), fov_deg, ..self })
    }

    /// Draws so many cameras that look at a model like this.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for views that no camera takes.
    pub(in super::super) fn sample(&self, look_at: LookAt, views: u32, seed: u64) -> Result<CameraSet, EngineError> {
        let lens = self.lens()?;
        if !self.cameras.is_empty() {
            let cameras = self.cameras.iter().map(|camera| camera.camera().resized(lens.size)).collect();
            return Capture { cameras, look_at, jitter_deg: self.jitter_deg }.sample(views, seed);
        }
        let range = |(low, high): (f64, f64)| low..=high;
        let straying = Straying { aim_deg: self.aim_deg, roll_deg: self.roll_deg, zoom: range(self.zoom) };
        let (azimuth_deg, elevation_deg) = (range(self.azimuth_deg), range(self.elevation_deg));
        Band { azimuth_deg, elevation_deg, distance: range(self.distance), look_at, lens, straying }.sample(views, seed)
    }

    /// What they look through.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a size that no image has.
    pub fn lens(&self) -> Result<Lens, EngineError> {
        let (width, height) = self.size_px;
        Ok(Lens { fov_x_rad: self.fov_deg.to_radians(), size: FrameSize::new(width, height)? })
    }

    /// Size of training frames.
    pub(in super::super) fn frame_size(&self) -> ImageSize {
        ImageSize { height: self.size_px.1 as usize, width: self.size_px.0 as usize }
    }

    pub(super) fn validate(&self) -> Result<(), EngineError> {
        check("views", self.clips, self.clips > 0, "at least 1 training clip")?;
        let radius = self.radius.unwrap_or(1.0);
        check("radius", radius, radius.is_finite() && radius > 0.0, "a positive number")?;
        self.cameras.iter().try_for_each(TrainingCamera::validate)
    }
}
