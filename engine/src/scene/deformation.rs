//! The weights of a 4DGaussians deformation network, taken out of its state dict by exact key and shape.

use std::collections::HashMap;
use std::path::Path;

use super::cfg_args::{DEFAULT_BOUNDS, DeformConfig};
use super::gaussians::{MAX_SH_DEGREE, SH_FLOATS};
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::pth::{Tensor, TensorData};

/// Coordinate pairs (a, b) of the six planes in file order; 0, 1, 2 are x, y, z and 3 is t.
///
/// A plane's width runs along a, its height along b.
pub const PLANE_AXES: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];

/// Index of the time axis in [`PLANE_AXES`] and [`DeformConfig::resolution`].
pub const TIME_AXIS: usize = 3;

const PREFIX: &str = "deformation_net.";

/// Tensors that upstream saves and never uses when rendering, with their number of dimensions.
const UNUSED: [(&str, usize); 8] = [
    ("time_poc", 1),
    ("pos_poc", 1),
    ("rotation_scaling_poc", 1),
    ("opacity_poc", 1),
    ("timenet.0.weight", 2),
    ("timenet.0.bias", 1),
    ("timenet.2.weight", 2),
    ("timenet.2.bias", 1),
];

/// One HexPlane plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// Values, channel by channel: \[C, height, width\].
    pub data: Vec<f32>,
    /// Channels C.
    pub channels: usize,
    /// Resolution of the second coordinate of its [`PLANE_AXES`] pair.
    pub height: usize,
    /// Resolution of the first coordinate.
    pub width: usize,
}

/// A linear layer, y = W x + b.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// \[outputs, inputs\] row-major.
    pub weight: Vec<f32>,
    /// \[outputs\].
    pub bias: Vec<f32>,
    /// Inputs.
    pub inputs: usize,
    /// Outputs.
    pub outputs: usize,
}

/// A head: ReLU, `hidden`, ReLU, `out`.
#[derive(Clone, Debug, PartialEq)]
pub struct Head {
    /// W to W (key `.1`).
    pub hidden: Linear,
    /// W to the term's size (key `.3`).
    pub out: Linear,
}

/// A deformation network: HexPlane levels, `feature_out`, and five heads, all present even if unused.
#[derive(Clone, Debug, PartialEq)]
pub struct DeformationWeights {
    /// Hyperparameters; they say which heads apply.
    pub config: DeformConfig,
    /// Grid box as saved: row 0 is its maximum, row 1 its minimum. The flip is upstream's and must stay.
    pub aabb: [[f32; 3]; 2],
    /// Per level six planes in the order of [`PLANE_AXES`].
    pub grids: Vec<[Plane; 6]>,
    /// Linear layers with a ReLU between them and none after the last.
    pub feature_out: Vec<Linear>,
    /// Position offset, 3.
    pub pos_deform: Head,
    /// Log-scale offset, 3.
    pub scales_deform: Head,
    /// Quaternion offset, 4.
    pub rotations_deform: Head,
    /// Logit opacity offset, 1.
    pub opacity_deform: Head,
    /// SH offset, 48 = \[16, 3\] coefficient-major.
    pub shs_deform: Head,
}

impl Linear {
    /// W x + b.
    ///
    /// # Shapes
    /// in `x` \[inputs\] · out \[outputs\]
    #[must_use]
    pub fn apply(&self, x: &[f32]) -> Vec<f32> {
        let rows = self.weight.chunks_exact(self.inputs.max(1)).zip(&self.bias);
        rows.map(|(row, bias)| bias + row.iter().zip(x).map(|(weight, value)| weight * value).sum::<f32>()).collect()
    }

    /// The same layer for some of its inputs, when the others are 0.
    #[must_use]
    pub fn columns(&self, range: std::ops::Range<usize>) -> Self {
        let rows = self.weight.chunks_exact(self.inputs.max(1));
        let weight = rows.flat_map(|row| &row[range.clone()]).copied().collect();
        Self { weight, bias: self.bias.clone(), inputs: range.len(), outputs: self.outputs }
    }
}

impl DeformationWeights {
    /// Takes the tensors of a state dict, which came from `path`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the first tensor that is missing, left over, not f32, of another shape than
    /// `config` implies, or not finite.
    pub fn from_state_dict(
        path: &Path,
        tensors: Vec<(String, Tensor)>,
        config: DeformConfig,
    ) -> Result<Self, EngineError> {
        let mut dict = StateDict::new(path, PREFIX, tensors);
        for (name, dims) in UNUSED {
            dict.drop_unused(name, dims)?;
        }
        let width = config.net_width;
        let features = config.output_coordinate_dim * config.multires.len();
        let depth = config.defor_depth.max(1);
        let weights = Self {
            aabb: dict.aabb()?,
            grids: (config.multires.iter().enumerate())
                .map(|(level, &factor)| dict.level(&config, level, factor))
                .collect::<Result<_, _>>()?,
            feature_out: (0..depth)
                .map(|layer| {
                    let inputs = if layer == 0 { features } else { width };
                    dict.linear(&format!("feature_out.{}", 2 * layer), inputs, width)
                })
                .collect::<Result<_, _>>()?,
            pos_deform: dict.head("pos_deform", width, 3)?,
            scales_deform: dict.head("scales_deform", width, 3)?,
            rotations_deform: dict.head("rotations_deform", width, 4)?,
            opacity_deform: dict.head("opacity_deform", width, 1)?,
            shs_deform: dict.head("shs_deform", width, SH_FLOATS)?,
            config,
        };
        dict.check_empty()?;
        Ok(weights)
    }
}

/// Tensors by name, each taken out once.
pub(super) struct StateDict<'a> {
    path: &'a Path,
    /// Start of the names of all tensors that are used.
    prefix: &'static str,
    tensors: HashMap<String, Tensor>,
}

impl<'a> StateDict<'a> {
    pub(super) fn new(path: &'a Path, prefix: &'static str, tensors: Vec<(String, Tensor)>) -> Self {
        Self { path, prefix, tensors: tensors.into_iter().collect() }
    }

    fn take(&mut self, name: &str) -> Result<Tensor, EngineError> {
        self.tensors
            .remove(name)
            .ok_or_else(|| bad_data(self.path, name, "missing", "a tensor of the deformation network"))
    }

    fn drop_unused(&mut self, name: &str, dims: usize) -> Result<(), EngineError> {
        let tensor = self.take(name)?;
        if tensor.shape.len() != dims {
            let got = format!("shape {:?}", tensor.shape);
            return Err(bad_data(self.path, name, got, format!("{dims} dimensions")));
        }
        Ok(())
    }

    /// The values of the prefix and `name`, which must be finite f32 of exactly `shape`.
    fn values(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, EngineError> {
        let name = format!("{}{name}", self.prefix);
        let tensor = self.take(&name)?;
        if tensor.shape != shape {
            let got = format!("shape {:?}", tensor.shape);
            return Err(bad_data(self.path, name, got, format!("{shape:?}")));
        }
        let TensorData::F32(values) = tensor.data else {
            return Err(bad_data(self.path, name, "integers", "floating point"));
        };
        match values.iter().position(|value| !value.is_finite()) {
            None => Ok(values),
            Some(index) => {
                let got = format!("{} at element {index}", values[index]);
                Err(bad_data(self.path, name, got, "finite values"))
            }
        }
    }

    fn aabb(&mut self) -> Result<[[f32; 3]; 2], EngineError> {
        let values = self.values("grid.aabb", &[2, 3])?;
        let aabb = [0, 3].map(|row| [values[row], values[row + 1], values[row + 2]]);
        let [highest, lowest] = aabb;
        if let Some(axis) = (0..3).find(|&axis| highest[axis] == lowest[axis]) {
            let field = format!("{PREFIX}grid.aabb");
            let got = format!("no extent along axis {axis}");
            return Err(bad_data(self.path, field, got, "a box"));
        }
        Ok(aabb)
    }

    fn level(&mut self, config: &DeformConfig, level: usize, factor: usize) -> Result<[Plane; 6], EngineError> {
        let channels = config.output_coordinate_dim;
        let size = |axis: usize| match axis {
            TIME_AXIS => config.resolution[axis],
            _ => config.resolution[axis] * factor,
        };
        let mut planes = Vec::with_capacity(PLANE_AXES.len());
        for (index, (a, b)) in PLANE_AXES.into_iter().enumerate() {
            let (height, width) = (size(b), size(a));
            let name = format!("grid.grids.{level}.{index}");
            planes.push(Plane { data: self.values(&name, &[1, channels, height, width])?, channels, height, width });
        }
        Ok(planes.try_into().expect("one plane was pushed per pair of axes"))
    }

    pub(super) fn linear(&mut self, name: &str, inputs: usize, outputs: usize) -> Result<Linear, EngineError> {
        Ok(Linear {
            weight: self.values(&format!("{name}.weight"), &[outputs, inputs])?,
            bias: self.values(&format!("{name}.bias"), &[outputs])?,
            inputs,
            outputs,
        })
    }

    fn head(&mut self, name: &str, width: usize, outputs: usize) -> Result<Head, EngineError> {
        Ok(Head {
            hidden: self.linear(&format!("{name}.1"), width, width)?,
            out: self.linear(&format!("{name}.3"), width, outputs)?,
        })
    }

    pub(super) fn check_empty(&self) -> Result<(), EngineError> {
        match self.tensors.keys().min() {
            None => Ok(()),
            Some(name) => {
                let got = "a tensor that the model's settings do not account for";
                let expected = "exactly the keys of the deformation network";
                Err(bad_data(self.path, name, got, expected))
            }
        }
    }
}

/// Derives the hyperparameters from the shapes of a state dict, for models without `cfg_args`.
///
/// The flags are not recoverable: position, scale and rotation are assumed on, opacity and SH off, background
/// white, which is how upstream trains D-NeRF and HyperNeRF scenes.
///
/// # Errors
/// [`EngineError::BadData`] if the tensors that the sizes are read from are missing or contradict each other.
pub fn derive_config(path: &Path, tensors: &[(String, Tensor)]) -> Result<DeformConfig, EngineError> {
    let shape = |name: &str| -> Result<&[usize], EngineError> {
        let found = tensors.iter().find(|(key, _)| key.strip_prefix(PREFIX) == Some(name));
        let (_, tensor) = found.ok_or_else(|| {
            let field = format!("{PREFIX}{name}");
            bad_data(path, field, "missing", "a tensor of the deformation network")
        })?;
        Ok(&tensor.shape)
    };
    let plane = |level: usize, index: usize| -> Result<[usize; 4], EngineError> {
        let name = format!("grid.grids.{level}.{index}");
        let sizes = shape(&name)?;
        let plane = <[usize; 4]>::try_from(sizes).ok().filter(|p| !p.contains(&0));
        plane.ok_or_else(|| bad_data(path, name, format!("shape {sizes:?}"), "[1, C, H, W]"))
    };
    let [_, channels, y, x] = plane(0, 0)?;
    let [_, _, z, _] = plane(0, 1)?;
    let [_, _, t, _] = plane(0, 2)?;
    let has = |name: String| tensors.iter().any(|(key, _)| *key == name);
    let levels = (0..).take_while(|level| has(format!("{PREFIX}grid.grids.{level}.0")));
    let mut multires = Vec::new();
    for level in levels {
        let [_, _, _, width] = plane(level, 0)?;
        multires.push(width / x);
    }
    let layers = (0..).take_while(|layer| has(format!("{PREFIX}feature_out.{}.weight", 2 * layer)));
    Ok(DeformConfig {
        net_width: shape("feature_out.0.bias")?.first().copied().unwrap_or(0),
        defor_depth: layers.count(),
        multires,
        output_coordinate_dim: channels,
        resolution: [x, y, z, t],
        no_dx: false,
        no_ds: false,
        no_dr: false,
        no_do: true,
        no_dshs: true,
        apply_rotation: false,
        bounds: DEFAULT_BOUNDS,
        white_background: true,
        sh_degree: MAX_SH_DEGREE,
    })
}
