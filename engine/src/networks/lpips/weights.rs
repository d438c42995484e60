//! LPIPS checkpoints: exactly the keys and shapes of one of the two networks.

use std::fmt;
use std::path::Path;

use crate::base::digest::Digest;
use crate::base::tensor_file::TensorFile;
use crate::error::EngineError;

/// Colours of a picture.
const RGB: usize = 3;

/// Network whose features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LpipsNet {
    /// `AlexNet`, five layers.
    Alex,
    /// VGG16, thirteen layers.
    Vgg16,
}

impl LpipsNet {
    /// Name in receipts.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Alex => "alex",
            Self::Vgg16 => "vgg16",
        }
    }

    /// Least height and width of a picture, so that every pooling has something to look at.
    #[must_use]
    pub fn min_side_px(self) -> usize {
        match self {
            Self::Alex => 31,
            Self::Vgg16 => 16,
        }
    }

    /// The convolutions in their order (Krizhevsky 2014 and Simonyan & Zisserman 2015, as torchvision numbers them).
    /// The features behind the ReLU are compared in front of each pooling and at the end, and of `AlexNet` behind each
    /// layer.
    pub(super) fn layers(self) -> &'static [Layer] {
        const POOL_3: Option<Pool> = Some(Pool { side: 3, stride: 2 });
        const POOL_2: Option<Pool> = Some(Pool { side: 2, stride: 2 });
        const fn alex(index: usize, pool: Option<Pool>, channels: [usize; 2], taps: usize) -> Layer {
            Layer { index, pool, channels, taps, stride: 1, padding: taps / 2, is_tapped: true }
        }
        const fn vgg(index: usize, pool: Option<Pool>, channels: [usize; 2], is_tapped: bool) -> Layer {
            Layer { index, pool, channels, taps: 3, stride: 1, padding: 1, is_tapped }
        }
        match self {
            Self::Alex => {
                const {
                    &[
                        Layer { stride: 4, padding: 2, ..alex(0, None, [RGB, 64], 11) },
                        alex(3, POOL_3, [64, 192], 5),
                        alex(6, POOL_3, [192, 384], 3),
                        alex(8, None, [384, 256], 3),
                        alex(10, None, [256, 256], 3),
                    ]
                }
            }
            Self::Vgg16 => {
                const {
                    &[
                        vgg(0, None, [RGB, 64], false),
                        vgg(2, None, [64, 64], true),
                        vgg(5, POOL_2, [64, 128], false),
                        vgg(7, None, [128, 128], true),
                        vgg(10, POOL_2, [128, 256], false),
                        vgg(12, None, [256, 256], false),
                        vgg(14, None, [256, 256], true),
                        vgg(17, POOL_2, [256, 512], false),
                        vgg(19, None, [512, 512], false),
                        vgg(21, None, [512, 512], true),
                        vgg(24, POOL_2, [512, 512], false),
                        vgg(26, None, [512, 512], false),
                        vgg(28, None, [512, 512], true),
                    ]
                }
            }
        }
    }
}

impl fmt::Display for LpipsNet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A max pooling without padding.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pool {
    pub(super) side: usize,
    pub(super) stride: usize,
}

/// One convolution with its ReLU.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layer {
    /// Number in `features.*`.
    index: usize,
    /// In front of it.
    pub(super) pool: Option<Pool>,
    /// Of its input and its output.
    pub(super) channels: [usize; 2],
    /// Side of its filters.
    pub(super) taps: usize,
    /// Of the filters; more than 1 only in the first layer.
    pub(super) stride: usize,
    /// Zeros on every side.
    pub(super) padding: usize,
    /// Whether its output is compared.
    pub(super) is_tapped: bool,
}

/// A checked checkpoint: the convolutions `features.N.{weight,bias}` and the weights of their channels
/// `linN.model.1.weight`.
pub struct LpipsWeights {
    net: LpipsNet,
    digest: Digest,
    file: TensorFile,
}

impl LpipsWeights {
    /// Reads a safetensors file; its first layer tells which network it is.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] without the file; [`EngineError::BadData`] naming the first tensor that is
    /// missing, unexpected, of another shape or not finite.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        let file = TensorFile::read(path)?;
        let digest = Digest::of_file(path)?;
        let net = match file.get(&weight_name(0))?.shape.last() {
            Some(11) => LpipsNet::Alex,
            _ => LpipsNet::Vgg16,
        };
        let weights = Self { net, digest, file };
        let mut known = Vec::new();
        for layer in net.layers() {
            weights.filters(layer)?;
            known.extend([weight_name(layer.index), bias_name(layer.index)]);
        }
        for tap in 0..net.layers().iter().filter(|layer| layer.is_tapped).count() {
            weights.head(tap)?;
            known.push(head_name(tap));
        }
        match weights.file.tensors.keys().find(|name| !known.contains(name)) {
            None => Ok(weights),
            Some(name) => Err(weights.file.bad(name, "a tensor", &format!("no tensor of this name for {net}"))),
        }
    }

    /// Network that they are for.
    #[must_use]
    pub fn net(&self) -> LpipsNet {
        self.net
    }

    /// Hash of the file.
    #[must_use]
    pub fn digest(&self) -> Digest {
        self.digest
    }

    /// Filters `[Co, Ci, taps, taps]` and biases `[Co]` of a layer.
    pub(super) fn filters(&self, layer: &Layer) -> Result<[&[f32]; 2], EngineError> {
        let [inputs, outputs] = layer.channels;
        let weight = self.file.finite(&weight_name(layer.index), &[outputs, inputs, layer.taps, layer.taps])?;
        Ok([weight, self.file.finite(&bias_name(layer.index), &[outputs])?])
    }

    /// Weights of the channels `[Co]` that are compared.
    pub(super) fn head(&self, tap: usize) -> Result<&[f32], EngineError> {
        let mut tapped = self.net.layers().iter().filter(|layer| layer.is_tapped);
        let channels = tapped.nth(tap).map_or(0, |layer| layer.channels[1]);
        self.file.finite(&head_name(tap), &[1, channels, 1, 1])
    }
}

fn weight_name(index: usize) -> String {
    format!("features.{index}.weight")
}

fn bias_name(index: usize) -> String {
    format!("features.{index}.bias")
}

fn head_name(tap: usize) -> String {
    format!("lin{tap}.model.1.weight")
}

impl fmt::Debug for LpipsWeights {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "LpipsWeights({}, {})", self.net, self.digest)
    }
}

impl PartialEq for LpipsWeights {
    fn eq(&self, other: &Self) -> bool {
        self.digest == other.digest
    }
}
