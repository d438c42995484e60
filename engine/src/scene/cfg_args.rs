//! `cfg_args`, the hyperparameters beside a 4DGaussians model: `Namespace(name=literal, ...)` as text.
//!
//! Upstream evaluates this text as Python; here it is parsed, and a name that is not known is refused, because it
//! may change what the renderer has to do.

use std::path::Path;

use super::gaussians::MAX_SH_DEGREE;
use super::literal::{Literal, parse_namespace};
use crate::base::files::{bad_data, read_file};
use crate::error::EngineError;

/// Longest file that is read; a full upstream namespace is about 4 KiB.
const MAX_BYTES: usize = 256 * 1024;

/// Names that upstream writes and that do not change how a saved model is rendered: training, data and program
/// settings, and widths of parts that the renderer computes and drops.
const WITHOUT_EFFECT: &[&str] = &[
    "add_point",
    "add_points",
    "batch_size",
    "checkpoint_iterations",
    "coarse_iterations",
    "compute_cov3D_python",
    "configs",
    "convert_SHs_python",
    "custom_sampler",
    "data_device",
    "dataloader",
    "debug",
    "debug_from",
    "deformation_lr_delay_mult",
    "deformation_lr_final",
    "deformation_lr_init",
    "densification_interval",
    "densify_from_iter",
    "densify_grad_threshold_after",
    "densify_grad_threshold_coarse",
    "densify_grad_threshold_fine_init",
    "densify_until_iter",
    "detect_anomaly",
    "eval",
    "expname",
    "extension",
    "feature_lr",
    "grid_lr_final",
    "grid_lr_init",
    "images",
    "ip",
    "iterations",
    "l1_time_planes",
    "lambda_dssim",
    "lambda_lpips",
    "llffhold",
    "model_path",
    "opacity_lr",
    "opacity_pe",
    "opacity_reset_interval",
    "opacity_threshold_coarse",
    "opacity_threshold_fine_after",
    "opacity_threshold_fine_init",
    "percent_dense",
    "plane_tv_weight",
    "port",
    "posebase_pe",
    "position_lr_delay_mult",
    "position_lr_final",
    "position_lr_init",
    "position_lr_max_steps",
    "pruning_from_iter",
    "pruning_interval",
    "quiet",
    "render_process",
    "resolution",
    "rotation_lr",
    "save_iterations",
    "scale_rotation_pe",
    "scaling_lr",
    "source_path",
    "start_checkpoint",
    "test_iterations",
    "time_smoothness_weight",
    "timebase_pe",
    "timenet_output",
    "timenet_width",
    "weight_constraint_after",
    "weight_constraint_init",
    "weight_decay_iteration",
    "zerostamp_init",
];

/// Names that [`DeformConfig`] is made of.
const READ: &[&str] = &[
    "apply_rotation",
    "bounds",
    "defor_depth",
    "empty_voxel",
    "grid_pe",
    "kplanes_config",
    "multires",
    "net_width",
    "no_do",
    "no_dr",
    "no_ds",
    "no_dshs",
    "no_dx",
    "no_grid",
    "sh_degree",
    "static_mlp",
    "white_background",
];

/// Most entries of `multires`; upstream's default has four.
const MAX_LEVELS: usize = 16;

/// Largest width, channel count, depth or resolution that is believed.
const MAX_SIZE: usize = 1 << 16;

/// Upstream's default of [`DeformConfig::bounds`].
pub(super) const DEFAULT_BOUNDS: f32 = 1.6;

/// The hyperparameters that decide how a 4DGaussians model is deformed and rendered, under upstream's names.
#[derive(Clone, Debug, PartialEq)]
pub struct DeformConfig {
    /// Width W of the deformation MLP.
    pub net_width: usize,
    /// Depth D of `feature_out`; 0 and 1 both mean a single linear layer.
    pub defor_depth: usize,
    /// Factor of the spatial resolution, per HexPlane level.
    pub multires: Vec<usize>,
    /// Channels C of every plane.
    pub output_coordinate_dim: usize,
    /// Base resolution along x, y, z and t; t is not scaled by `multires`.
    pub resolution: [usize; 4],
    /// Skip the position offset.
    pub no_dx: bool,
    /// Skip the scale offset.
    pub no_ds: bool,
    /// Skip the rotation offset.
    pub no_dr: bool,
    /// Skip the opacity offset.
    pub no_do: bool,
    /// Skip the SH offset.
    pub no_dshs: bool,
    /// Compose rotations as quaternions instead of adding them.
    pub apply_rotation: bool,
    /// Half-width of the initial grid box; the saved box replaces it.
    pub bounds: f32,
    /// Background: white if set, black otherwise.
    pub white_background: bool,
    /// Degree of the stored SH.
    pub sh_degree: u32,
}

impl DeformConfig {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], and those of [`DeformConfig::parse`].
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        Self::parse(path, &read_file(path, "the cfg_args of a 4DGaussians model")?)
    }

    /// Parses `text`, which came from `path`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for anything but `Namespace(name=literal, ...)`, for a name that is unknown, missing
    /// or set twice, for a value of the wrong kind, and for the network variants that are not supported.
    pub fn parse(path: &Path, text: &[u8]) -> Result<Self, EngineError> {
        if text.len() > MAX_BYTES {
            let expected = format!("at most {MAX_BYTES}");
            return Err(bad_data(path, "length", format!("{} bytes", text.len()), expected));
        }
        let text = std::str::from_utf8(text).map_err(|_| bad_data(path, "text", "bytes that are no text", "UTF-8"))?;
        let pairs = parse_namespace(text).map_err(|e| bad_data(path, format!("byte {}", e.at), e.got, e.expected))?;
        let namespace = Namespace { path, pairs };
        namespace.check_names()?;
        namespace.check_variant()?;
        namespace.config()
    }
}

struct Namespace<'a> {
    path: &'a Path,
    pairs: Vec<(String, Literal)>,
}

impl Namespace<'_> {
    fn check_names(&self) -> Result<(), EngineError> {
        for (index, (name, _)) in self.pairs.iter().enumerate() {
            if !READ.contains(&name.as_str()) && !WITHOUT_EFFECT.contains(&name.as_str()) {
                let expected = "only flags of 4DGaussians, since others may change the rendering";
                return Err(bad_data(self.path, name, "unknown flag", expected));
            }
            if self.pairs[..index].iter().any(|(earlier, _)| earlier == name) {
                return Err(bad_data(self.path, name, "set twice", "each flag once"));
            }
        }
        Ok(())
    }

    /// Refuses the variants of the network whose terms this renderer does not compute.
    fn check_variant(&self) -> Result<(), EngineError> {
        let expected = "False; this variant of the deformation network is not supported";
        for name in ["static_mlp", "empty_voxel", "no_grid"] {
            if self.bool_or(name, false)? {
                return Err(bad_data(self.path, name, "True", expected));
            }
        }
        match self.find("grid_pe") {
            None | Some(Literal::Int(0 | 1)) => Ok(()),
            Some(other) => Err(bad_data(
                self.path,
                "grid_pe",
                other.describe(),
                "0 or 1; positional encoding of grid features is not supported",
            )),
        }
    }

    /// Flags that older upstream versions did not write take upstream's default.
    fn config(&self) -> Result<DeformConfig, EngineError> {
        let planes = self.dict("kplanes_config")?;
        self.check_dimension(planes, "grid_dimensions", 2)?;
        self.check_dimension(planes, "input_coordinate_dim", 4)?;
        let channels = self.entry(planes, "output_coordinate_dim")?;
        let resolution = self.sizes("resolution", self.entry(planes, "resolution")?)?;
        let resolution = resolution.try_into().map_err(|list: Vec<usize>| {
            let got = format!("{} values", list.len());
            bad_data(self.path, "kplanes_config resolution", got, "4 (x, y, z, t)")
        })?;
        let multires = self.sizes("multires", self.get("multires")?)?;
        if multires.is_empty() || multires.len() > MAX_LEVELS {
            let got = format!("{} levels", multires.len());
            return Err(bad_data(self.path, "multires", got, format!("1 to {MAX_LEVELS}")));
        }
        Ok(DeformConfig {
            net_width: self.size("net_width", self.get("net_width")?, 1)?,
            defor_depth: self.size("defor_depth", self.get("defor_depth")?, 0)?,
            multires,
            output_coordinate_dim: self.size("output_coordinate_dim", channels, 1)?,
            resolution,
            no_dx: self.bool("no_dx")?,
            no_ds: self.bool("no_ds")?,
            no_dr: self.bool("no_dr")?,
            no_do: self.bool("no_do")?,
            no_dshs: self.bool("no_dshs")?,
            apply_rotation: self.bool_or("apply_rotation", false)?,
            bounds: self.bounds()?,
            white_background: self.bool_or("white_background", true)?,
            sh_degree: self.sh_degree()?,
        })
    }

    fn find(&self, name: &str) -> Option<&Literal> {
        let pair = self.pairs.iter().find(|(key, _)| key == name);
        pair.map(|(_, value)| value)
    }

    fn get(&self, name: &str) -> Result<&Literal, EngineError> {
        self.find(name).ok_or_else(|| bad_data(self.path, name, "missing", "a flag of the 4DGaussians trainer"))
    }

    fn wrong(&self, name: &str, value: &Literal, expected: &str) -> EngineError {
        bad_data(self.path, name, value.describe(), expected)
    }

    fn bool(&self, name: &str) -> Result<bool, EngineError> {
        match self.get(name)? {
            Literal::Bool(value) => Ok(*value),
            other => Err(self.wrong(name, other, "True or False")),
        }
    }

    fn bool_or(&self, name: &str, default: bool) -> Result<bool, EngineError> {
        match self.find(name) {
            None => Ok(default),
            Some(_) => self.bool(name),
        }
    }

    fn size(&self, name: &str, value: &Literal, least: usize) -> Result<usize, EngineError> {
        let size = match value {
            Literal::Int(size) => usize::try_from(*size).ok(),
            _ => None,
        };
        let size = size.filter(|size| (least..=MAX_SIZE).contains(size));
        size.ok_or_else(|| self.wrong(name, value, &format!("{least} to {MAX_SIZE}")))
    }

    fn sizes(&self, name: &str, value: &Literal) -> Result<Vec<usize>, EngineError> {
        match value {
            Literal::List(items) => items.iter().map(|item| self.size(name, item, 1)).collect(),
            other => Err(self.wrong(name, other, "a list of integers")),
        }
    }

    fn dict(&self, name: &str) -> Result<&[(Literal, Literal)], EngineError> {
        match self.get(name)? {
            Literal::Dict(pairs) => Ok(pairs),
            other => Err(self.wrong(name, other, "a dict")),
        }
    }

    fn entry<'b>(&self, dict: &'b [(Literal, Literal)], name: &str) -> Result<&'b Literal, EngineError> {
        let is_name = |key: &Literal| matches!(key, Literal::Str(text) if text == name);
        let mut entries = dict.iter().filter(|(key, _)| is_name(key));
        match (entries.next(), entries.next()) {
            (Some((_, value)), None) => Ok(value),
            (found, _) => {
                let got = found.map_or("missing", |_| "set twice");
                let field = format!("kplanes_config {name}");
                Err(bad_data(self.path, field, got, "one value"))
            }
        }
    }

    fn check_dimension(&self, dict: &[(Literal, Literal)], name: &str, supported: i64) -> Result<(), EngineError> {
        let value = self.entry(dict, name)?;
        match value {
            Literal::Int(got) if *got == supported => Ok(()),
            other => Err(self.wrong(name, other, &format!("{supported} (HexPlane)"))),
        }
    }

    fn bounds(&self) -> Result<f32, EngineError> {
        match self.find("bounds") {
            None => Ok(DEFAULT_BOUNDS),
            Some(value) => {
                let number = match value {
                    Literal::Float(number) => number.to_string(),
                    Literal::Int(number) => number.to_string(),
                    _ => String::new(),
                };
                let bounds = number.parse().ok().filter(|b: &f32| b.is_finite() && *b > 0.0);
                bounds.ok_or_else(|| self.wrong("bounds", value, "a positive number"))
            }
        }
    }

    fn sh_degree(&self) -> Result<u32, EngineError> {
        match self.find("sh_degree") {
            None => Ok(MAX_SH_DEGREE),
            Some(value) => {
                let degree = match value {
                    Literal::Int(degree) => u32::try_from(*degree).ok(),
                    _ => None,
                };
                let degree = degree.filter(|degree| *degree <= MAX_SH_DEGREE);
                degree.ok_or_else(|| self.wrong("sh_degree", value, &format!("0 to {MAX_SH_DEGREE}")))
            }
        }
    }
}
