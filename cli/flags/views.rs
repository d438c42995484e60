//! Where models are looked at from.

use std::path::PathBuf;

use clap::Args;
use glam::DVec3;

use super::size::parse_size;

/// Width and height of pictures when nothing says otherwise, px.
const DEFAULT_SIZE: (u32, u32) = (400, 400);

/// Where a model is filmed from.
#[derive(Args, Debug)]
#[command(next_help_heading = "Views of a model")]
pub(crate) struct EvaluationViews {
    /// Camera file or folder; its content tells which kind
    ///
    /// Known are transforms JSON (D-NeRF, Blender, nerfstudio), cameras.json (INRIA), camera_path.json (nerfstudio), a
    /// COLMAP folder (text or binary; itself or with sparse/0) or a Nerfies/HyperNeRF folder. Where it has no times, as
    /// COLMAP and INRIA, --frames spreads frames over the motion. Lens distortion is refused: undistort first; of
    /// Nerfies cameras it is ignored, as 4DGaussians does.
    #[arg(long, value_name = "PATH", conflicts_with = "orbit")]
    pub(crate) cameras: Option<PathBuf>,
    /// Film this many frames on a smooth flight through --cameras, while time runs from 0 to 1
    #[arg(long, value_name = "FRAMES", requires = "cameras")]
    pub(crate) interpolate: Option<u32>,
    /// Let the flight come back to its first camera, so that the film can be repeated
    #[arg(long, requires = "interpolate")]
    pub(crate) closed: bool,
    /// This many views on a circle around the scene instead [default: 6]
    #[arg(long, value_name = "VIEWS")]
    pub(crate) orbit: Option<u32>,
    /// Elevation of the orbit in degrees above the horizon
    #[arg(long, value_name = "DEGREES", default_value_t = 30.0, allow_negative_numbers = true)]
    pub(crate) elevation: f32,
    /// Radius of the orbit in scene units
    ///
    /// Unless given, 4 for a moving model, and as far as fills the frame for a static one.
    #[arg(long, value_name = "UNITS")]
    pub(crate) radius: Option<f64>,
    /// Point that the orbit is around
    ///
    /// Unless given, the origin for a moving model, and the middle of the splats of a static one.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub(crate) target: Option<DVec3>,
    /// What is up for the orbit [default: the z axis]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_direction, allow_hyphen_values = true)]
    pub(crate) up: Option<DVec3>,
    /// Horizontal field of view of the orbit in degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 39.6)]
    pub(crate) fov: f32,
    /// Frames per view of the orbit, and of cameras without times, spread over the whole motion
    #[arg(long, default_value_t = 8)]
    pub(crate) frames: u32,
    /// Picture size WIDTHxHEIGHT [default: what --cameras says, or 400x400]
    ///
    /// What --cameras shows is scaled to it, and stretched if its shape is another.
    #[arg(long, value_parser = parse_size)]
    pub(crate) size: Option<(u32, u32)>,
}

impl EvaluationViews {
    /// Width and height in px of what has no size of its own.
    pub(crate) fn size(&self) -> (u32, u32) {
        self.size.unwrap_or(DEFAULT_SIZE)
    }
}

/// A direction, brought to the length 1.
fn parse_direction(text: &str) -> Result<DVec3, String> {
    parse_point(text)?.try_normalize().ok_or_else(|| format!("`{text}`: expected a direction, X,Y,Z"))
}

/// A point of the scene.
fn parse_point(text: &str) -> Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(|n| n.is_finite()) => Ok(DVec3::new(x, y, z)),
        _ => Err(format!("`{text}`: expected three numbers, X,Y,Z")),
    }
}
