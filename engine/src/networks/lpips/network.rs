//! One of LPIPS's networks on the device, and what it is fed with.

use std::path::Path;
use std::str::FromStr;

use guard4d_kernels::image::CHANNELS;
use guard4d_kernels::image::normalize::Normalization;
use guard4d_kernels::nn::conv2d::{FilterBank, Filters};
use guard4d_kernels::{Buffer, Device};
use serde::{Deserialize, Serialize};

use super::weights::{Layer, LpipsNet, LpipsWeights};
use crate::error::EngineError;

/// Mean and standard deviation of the networks' inputs, for colours in \[-1, 1\] (the reference code's scaling layer).
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
/// See [`SHIFT`].
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Taps of either network.
pub const NUM_TAPS: usize = 5;

/// Range in which the network is given colours. Figures of the two cannot be compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LpipsInput {
    /// \[-1, 1\], as the networks' normalisation wants it.
    #[default]
    Canonical,
    /// \[0, 1\], as much of the splatting literature gives it, without another normalisation.
    #[serde(rename = "unit")]
    UnitFed,
}

impl FromStr for LpipsInput {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        match text {
            "canonical" => Ok(Self::Canonical),
            "unit" => Ok(Self::UnitFed),
            _ => Err(EngineError::Usage {
                what: "input of LPIPS".to_owned(),
                got: text.to_owned(),
                expected: "canonical or unit".to_owned(),
            }),
        }
    }
}

impl LpipsInput {
    /// From colours in \[0, 1\] to the network's input.
    fn normalization(self) -> Normalization {
        match self {
            // (2 x - 1 - shift) / scale.
            Self::Canonical => Normalization { mean: SHIFT.map(|s| 0.5 * (1.0 + s)), std: SCALE.map(|s| 0.5 * s) },
            Self::UnitFed => Normalization { mean: SHIFT, std: SCALE },
        }
    }
}

/// A distance: the sum of what its taps give.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LpipsScore {
    /// Mean over pixels of each tap.
    pub per_tap: [f64; NUM_TAPS],
}

impl LpipsScore {
    /// The distance.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.per_tap.iter().sum()
    }
}

/// A network on the device.
#[derive(Debug)]
pub struct Lpips {
    pub(super) device: Device,
    pub(super) net: LpipsNet,
    pub(super) input: Normalization,
    pub(super) layers: Vec<(Layer, Filters)>,
    pub(super) heads: Vec<Buffer<f32>>,
}

impl Lpips {
    /// Reads a checkpoint and puts it on the device.
    ///
    /// # Errors
    /// As [`LpipsWeights::read`] and [`Lpips::new`].
    pub fn load(device: &Device, path: &Path, input: LpipsInput) -> Result<Self, EngineError> {
        Self::new(device, &LpipsWeights::read(path)?, input)
    }

    /// Puts a checkpoint on the device.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, weights: &LpipsWeights, input: LpipsInput) -> Result<Self, EngineError> {
        let net = weights.net();
        let mut layers = Vec::new();
        for (i, layer) in net.layers().iter().enumerate() {
            let [weight, bias] = weights.filters(layer)?;
            let stacked = stack(weight, layer);
            let bank = FilterBank {
                weight: &stacked,
                bias,
                out_channels: layer.channels[1],
                in_channels: stacked_channels(layer),
                taps: stacked_taps(layer),
            };
            layers.push((*layer, Filters::new(device, &format!("lpips.{i}"), &bank)?));
        }
        let head = |tap| Ok(device.buffer_from(&format!("lpips.head.{tap}"), weights.head(tap)?)?);
        let heads = (0..NUM_TAPS).map(head).collect::<Result<_, EngineError>>()?;
        Ok(Self { device: device.clone(), net, input: input.normalization(), layers, heads })
    }

    /// Which network it is.
    #[must_use]
    pub fn net(&self) -> LpipsNet {
        self.net
    }
}

/// Taps of a layer over cells of `stride`² pixels.
pub(super) fn stacked_taps(layer: &Layer) -> usize {
    layer.taps.div_ceil(layer.stride)
}

/// Channels of such a cell; colours have a fourth channel there, a cell of one pixel is taken as it is.
fn stacked_channels(layer: &Layer) -> usize {
    match layer.stride {
        1 => layer.channels[0],
        stride => stride * stride * CHANNELS,
    }
}

/// Filters with a stride as filters of stride 1 over cells of `stride`² pixels, each of four channels.
fn stack(weight: &[f32], layer: &Layer) -> Vec<f32> {
    let Layer { taps, stride, channels: [inputs, outputs], .. } = *layer;
    if stride == 1 {
        return weight.to_vec();
    }
    let (cells, channels) = (stacked_taps(layer), stacked_channels(layer));
    let mut stacked = vec![0.0; outputs * channels * cells * cells];
    for (i, value) in weight.iter().enumerate() {
        let (filter, input, y, x) = (i / (inputs * taps * taps), i / (taps * taps) % inputs, i / taps % taps, i % taps);
        let channel = (y % stride * stride + x % stride) * CHANNELS + input;
        stacked[((filter * channels + channel) * cells + y / stride) * cells + x / stride] = *value;
    }
    stacked
}
