//! The scenes of a study: where they come from, how they are varied, and who films them.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;
use guard4d_engine::render::render_frames;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::gaussians::{CHANNELS, SH_FLOATS, Y0};
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt, Model, Motion, demo};
use guard4d_engine::watermark::embed::EmbedConfig;
use guard4d_kernels::Device;

/// The scene that ships inside the program.
const DEMO: &str = "demo";
/// Cameras that training never sees, where a model folder has them.
const TEST_CAMERAS: &str = "transforms_test.json";
/// Views of a scene without such cameras, one clip each.
const ORBIT_VIEWS: u32 = 6;
/// Their frames, spread over the whole motion.
pub(super) const ORBIT_FRAMES: u16 = 8;
/// Their elevation in degrees.
pub(super) const ORBIT_ELEVATION_DEG: f64 = 30.0;
/// Field of view of the D-NeRF scenes, as training has it.
const FOV_X_RAD: f64 = 0.691_111_2;
/// DC coefficient of a colour: (colour − ½) / Y₀.
#[allow(clippy::cast_possible_truncation, reason = "coefficients are single precision")]
const DC_PER_COLOUR: f32 = 1.0 / Y0 as f32;

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SceneSource {
    /// The built-in one.
    Demo,
    /// A 4DGaussians folder or a static PLY.
    Path(PathBuf),
}

impl SceneSource {
    /// The model, in its own kind of file.
    ///
    /// # Errors
    /// Those of reading it.
    pub fn open_in_kind(&self) -> Result<Model, EngineError> {
        match self {
            Self::Demo => Model::open_in_kind(demo::DemoScene::unpack()?.path()),
            Self::Path(path) => Model::open_in_kind(path),
        }
    }
}

/// `demo` or a path.
impl FromStr for SceneSource {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        Ok(if text == DEMO { Self::Demo } else { Self::Path(PathBuf::from(text)) })
    }
}

/// The last part of the path.
impl fmt::Display for SceneSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Demo => f.write_str(DEMO),
            Self::Path(path) => write!(f, "{}", path.file_name().unwrap_or(path.as_os_str()).to_string_lossy()),
        }
    }
}

/// What is done to a scene before it is marked, to see where methods fail.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Variant {
    /// Nothing.
    #[default]
    AsIs,
    /// One grey for all splats.
    Textureless,
    /// Saturated white, so that no offset can make it brighter.
    White,
    /// Black, so that no offset can make it darker.
    Black,
    /// Every opacity times a factor.
    Opacity(f32),
    /// So many splats: evenly spaced ones of the file, or all of them several times over, which then share their light.
    Splats(usize),
    /// Displacements times a factor.
    Motion(f32),
    /// No motion.
    Still,
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AsIs => f.write_str("as it is"),
            Self::Textureless => f.write_str("textureless"),
            Self::White => f.write_str("white"),
            Self::Black => f.write_str("black"),
            Self::Opacity(factor) => write!(f, "opacity x{factor}"),
            Self::Splats(count) => write!(f, "{count} splats"),
            Self::Motion(factor) => write!(f, "motion x{factor}"),
            Self::Still => f.write_str("no motion"),
        }
    }
}

impl Variant {
    fn apply(self, model: &mut Model) {
        match self {
            Self::AsIs => {}
            Self::Textureless => paint(model, 0.5),
            Self::White => paint(model, 1.0),
            Self::Black => paint(model, 0.0),
            Self::Opacity(factor) => {
                model.gaussians.opacities.iter_mut().for_each(|logit| *logit = scaled_opacity(*logit, factor));
            }
            Self::Splats(count) => resample(model, count),
            Self::Motion(factor) => {
                if let Motion::HexPlane(network) = &mut model.motion {
                    let out = &mut network.pos_deform.out;
                    out.weight.iter_mut().chain(&mut out.bias).for_each(|w| *w *= factor);
                }
            }
            Self::Still => model.motion = Motion::Still,
        }
    }
}

/// Gives all splats one colour.
fn paint(model: &mut Model, colour: f32) {
    for splat in model.gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS) {
        splat.fill(0.0);
        splat[..CHANNELS].fill((colour - 0.5) * DC_PER_COLOUR);
    }
}

/// Logit of `factor` times the opacity of a logit.
fn scaled_opacity(logit: f32, factor: f32) -> f32 {
    let opacity = factor / (1.0 + (-logit).exp());
    (opacity / (1.0 - opacity)).ln()
}

/// Evenly spaced splats, or copies of all of them, whose opacity is lowered so that the picture stays what it was.
fn resample(model: &mut Model, count: usize) {
    let from = &model.gaussians;
    let len = from.len();
    let picks: Vec<usize> = (0..count).map(|i| if count <= len { i * len / count } else { i % len }).collect();
    let copies = count.div_ceil(len.max(1)).max(1) as f32;
    let pick3 = |rows: &[[f32; 3]]| picks.iter().map(|&i| rows[i]).collect();
    // 1 − (1 − a)^(1/n) of each copy is a of all n of them.
    let thin = |logit: f32| {
        let clear = 1.0 / (1.0 + logit.exp());
        let opacity = 1.0 - clear.powf(1.0 / copies);
        (opacity / (1.0 - opacity)).ln()
    };
    let mut to = from.clone();
    to.means = pick3(&from.means);
    to.scales = pick3(&from.scales);
    to.quats = picks.iter().map(|&i| from.quats[i]).collect();
    to.opacities = picks.iter().map(|&i| thin(from.opacities[i])).collect();
    to.sh_coeffs = picks.iter().flat_map(|&i| from.sh_coeffs[i * SH_FLOATS..][..SH_FLOATS].to_vec()).collect();
    model.gaussians = to;
}

/// A scene with the clips that training never sees.
pub(super) struct Scene {
    pub(super) model: Model,
    /// Where it is looked at from.
    pub(super) look_at: LookAt,
    pub(super) cameras: CameraSet,
    /// Clean 8-bit frames of these cameras.
    pub(super) clean: Vec<Vec<Frame>>,
}

impl Scene {
    /// Loads, varies and films a scene.
    pub(super) fn open(
        device: &Device,
        source: &SceneSource,
        variant: Variant,
        size: FrameSize,
    ) -> Result<Self, EngineError> {
        let (mut model, look_at, cameras) = match source {
            SceneSource::Demo => load(demo::DemoScene::unpack()?.path(), size)?,
            SceneSource::Path(path) => load(path, size)?,
        };
        variant.apply(&mut model);
        let clean = render_frames(device, &model, &cameras)?;
        Ok(Self { model, look_at, cameras, clean })
    }

    /// Settings whose training looks at the scene from where it fills the frame.
    pub(super) fn framed(&self, config: &EmbedConfig) -> EmbedConfig {
        config.clone().with(|c| c.views = c.views.clone().looking_at(self.look_at))
    }
}

fn load(path: &Path, size: FrameSize) -> Result<(Model, LookAt, CameraSet), EngineError> {
    let model = Model::open(path)?;
    let look_at = LookAt::of(&model, FOV_X_RAD);
    let cameras = match path.join(TEST_CAMERAS) {
        file if file.is_file() => CameraSet::open(&file, size)?,
        _ => orbit(size, ORBIT_ELEVATION_DEG, look_at)?.at_times(&times(0.0, 1.0)),
    };
    Ok((model, look_at, cameras))
}

/// A circle of views.
pub(super) fn orbit(size: FrameSize, elevation_deg: f64, look_at: LookAt) -> Result<CameraSet, EngineError> {
    let lens = Lens { fov_x_rad: FOV_X_RAD, size };
    Orbit { views: ORBIT_VIEWS, elevation_deg, look_at, lens }.cameras()
}

/// Evenly spaced times from `first` to `last`.
pub(super) fn times(first: f32, last: f32) -> Vec<f32> {
    let gaps = f32::from(ORBIT_FRAMES - 1);
    (0..ORBIT_FRAMES).map(|i| first + (last - first) * f32::from(i) / gaps).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_share_the_light_of_what_they_copy() {
        let logit = 0.7f32;
        let opacity = 1.0 / (1.0 + (-logit).exp());
        let half = scaled_opacity(logit, 0.5);
        // Single precision, of numbers of order 1.
        assert!((1.0 / (1.0 + (-half).exp()) - 0.5 * opacity).abs() < 1e-6, "half of the opacity: {half}");
    }

    #[test]
    fn variants_change_what_they_name() {
        let unpacked = demo::DemoScene::unpack().expect("the built-in scene unpacks");
        let model = Model::open(unpacked.path()).expect("the built-in scene loads");
        let with = |variant: Variant| {
            let mut changed = model.clone();
            variant.apply(&mut changed);
            changed
        };
        assert_eq!(with(Variant::AsIs).gaussians, model.gaussians, "nothing");
        assert_eq!(with(Variant::Splats(200)).gaussians.len(), 200, "fewer splats");
        let many = with(Variant::Splats(2 * model.gaussians.len() + 1)).gaussians;
        assert_eq!(many.means.len(), many.sh_coeffs.len() / SH_FLOATS, "rows belong together");
        assert!(many.opacities.iter().zip(&model.gaussians.opacities).all(|(m, o)| m < o), "copies are fainter");
        assert!(with(Variant::Still).motion.is_still(), "no motion");
        assert!(with(Variant::White).gaussians.sh_coeffs.iter().all(|v| *v >= 0.0), "bright");
        assert_ne!(with(Variant::Motion(4.0)).motion.network(), model.motion.network(), "another motion");
    }
}
