//! The weights of a Deformable-3DGS network (Yang et al. 2024), and what its `cfg_args` say.

use std::path::Path;

use super::deformation::{Linear, StateDict};
use super::literal::{Literal, parse_namespace};
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::pth::Tensor;

/// Frequencies 2⁰, 2¹, … of the position's sines and cosines.
pub const POSITION_FREQUENCIES: usize = 10;
/// Values that a position is encoded as: itself, then sines and cosines of each frequency.
pub const POSITION_FLOATS: usize = 3 * (1 + 2 * POSITION_FREQUENCIES);

/// Frequencies of the time, without and with a network of its own.
const TIME_FREQUENCIES: [usize; 2] = [10, 6];
/// Width of the layers, and how many there are.
const WIDTH: usize = 256;
const LAYERS: usize = 8;
/// The layer whose input is the encoding again, then the layer before.
pub const SKIP: usize = 5;
/// Sizes of the time's own network.
const TIME_WIDTH: usize = 256;
const TIME_OUTPUTS: usize = 30;

/// What the network says about positions.
#[derive(Clone, Debug, PartialEq)]
pub enum PositionHead {
    /// An offset.
    Offset(Linear),
    /// A screw motion: the twist's w and v (`is_6dof`).
    Screw {
        /// Rotation, 3.
        w: Linear,
        /// Shift, 3.
        v: Linear,
    },
}

/// A network that maps an encoded position and time to changes of a splat after activation.
#[derive(Clone, Debug, PartialEq)]
pub struct WarpWeights {
    /// Two layers with a ReLU between them that the encoded time goes through first (`is_blender`).
    pub time_net: Option<[Linear; 2]>,
    /// Layers with a ReLU behind each. The first takes encoded position and time, layer [`SKIP`] the same with the
    /// output of the layer before behind it.
    pub layers: Vec<Linear>,
    /// What happens to positions.
    pub position: PositionHead,
    /// Change of the unit quaternion, 4.
    pub rotation: Linear,
    /// Change of the standard deviation, 3.
    pub scaling: Linear,
}

impl WarpWeights {
    /// Takes the tensors of a state dict, which came from `path`. Which variant it is, its keys say.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the first tensor that is missing, left over, of another shape or not finite.
    pub fn from_state_dict(path: &Path, tensors: Vec<(String, Tensor)>) -> Result<Self, EngineError> {
        let has = |name: &str| tensors.iter().any(|(key, _)| key == name);
        let (has_time_net, is_screw) = (has("timenet.0.weight"), has("branch_w.weight"));
        let mut dict = StateDict::new(path, "", tensors);
        let time_floats = 1 + 2 * TIME_FREQUENCIES[usize::from(has_time_net)];
        let time_net = match has_time_net {
            false => None,
            true => Some([
                dict.linear("timenet.0", time_floats, TIME_WIDTH)?,
                dict.linear("timenet.2", TIME_WIDTH, TIME_OUTPUTS)?,
            ]),
        };
        let encoded = POSITION_FLOATS + if has_time_net { TIME_OUTPUTS } else { time_floats };
        let inputs = |layer: usize| match layer {
            0 => encoded,
            SKIP => encoded + WIDTH,
            _ => WIDTH,
        };
        let layers = (0..LAYERS).map(|layer| dict.linear(&format!("linear.{layer}"), inputs(layer), WIDTH));
        let layers = layers.collect::<Result<_, _>>()?;
        let position = match is_screw {
            true => {
                PositionHead::Screw { w: dict.linear("branch_w", WIDTH, 3)?, v: dict.linear("branch_v", WIDTH, 3)? }
            }
            false => PositionHead::Offset(dict.linear("gaussian_warp", WIDTH, 3)?),
        };
        let rotation = dict.linear("gaussian_rotation", WIDTH, 4)?;
        let scaling = dict.linear("gaussian_scaling", WIDTH, 3)?;
        dict.check_empty()?;
        Ok(Self { time_net, layers, position, rotation, scaling })
    }

    /// The time, 0 to 1, as the layers take it: encoded, and through its own network if there is one.
    #[must_use]
    pub fn encoded_time(&self, time: f32) -> Vec<f32> {
        let frequencies = TIME_FREQUENCIES[usize::from(self.time_net.is_some())];
        let mut values = vec![time];
        encode(&[time], frequencies, &mut values);
        if let Some([first, second]) = &self.time_net {
            let hidden: Vec<f32> = first.apply(&values).into_iter().map(|value| value.max(0.0)).collect();
            values = second.apply(&hidden);
        }
        values
    }
}

/// A position as the layers take it.
///
/// # Shapes
/// out [`POSITION_FLOATS`] values: the position, then sine and cosine of it times each frequency
#[must_use]
pub fn encoded_position(position: [f32; 3]) -> Vec<f32> {
    let mut values = position.to_vec();
    encode(&position, POSITION_FREQUENCIES, &mut values);
    values
}

fn encode(values: &[f32], frequencies: usize, out: &mut Vec<f32>) {
    let mut factor = 1.0;
    for _ in 0..frequencies {
        out.extend(values.iter().map(|value| (value * factor).sin()));
        out.extend(values.iter().map(|value| (value * factor).cos()));
        factor *= 2.0;
    }
}

/// Whether `cfg_args` say that the background is white. Upstream's default is black.
///
/// # Errors
/// [`EngineError::BadData`] for text that is no `Namespace(name=literal, ...)`.
pub(super) fn has_white_background(path: &Path, text: &[u8]) -> Result<bool, EngineError> {
    let text = std::str::from_utf8(text).map_err(|_| bad_data(path, "text", "bytes that are no text", "UTF-8"))?;
    let pairs = parse_namespace(text).map_err(|e| bad_data(path, format!("byte {}", e.at), e.got, e.expected))?;
    Ok(pairs.iter().any(|(name, value)| name == "white_background" && matches!(value, Literal::Bool(true))))
}
