//! Where training looks at a scene from.

use clap::Args;
use glam::DVec3;
use guard4d_kernels::image::resize::ImageSize;
use serde::{Deserialize, Serialize};

use super::parse::{check, point, range, single, size, word};
use crate::error::EngineError;
use crate::scene::camera::paths::Lens;
use crate::scene::{FrameSize, LookAt, Model};

/// Views that training takes: all around a point and looking at it. A part of the scene that they do not see is not
/// marked.
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

impl TrainingViews {
    /// Where they look at a model from: what is set, and for the rest what suits the model.
    #[must_use]
    pub fn look_at(&self, model: &Model) -> LookAt {
        let LookAt { target, radius } = LookAt::of(model, self.fov_deg.to_radians());
        LookAt { target: self.target.map_or(target, DVec3::from_array), radius: self.radius.unwrap_or(radius) }
    }

    /// The same from this place.
    #[must_use]
    pub fn looking_at(self, look_at: LookAt) -> Self {
        Self { target: Some(look_at.target.to_array()), radius: Some(look_at.radius), ..self }
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
        check("radius", radius, radius.is_finite() && radius > 0.0, "a positive number")
    }
}
