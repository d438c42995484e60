//! CLIP checkpoints: where they come from, and the towers that are made of them.
//!
//! A checkpoint is Hugging Face's `CLIPModel` layout, `config.json` and `model.safetensors`. Nothing about a particular
//! model is built in; the miniature one that ships with guard4d is loaded the same way.

use std::path::{Path, PathBuf};

use guard4d_kernels::Device;
use guard4d_kernels::nn::half_check::check_attention;
use guard4d_kernels::nn::pack::Precision;

use super::config::ClipConfig;
use super::layer::TowerPurpose;
use super::text::TextTower;
use super::vision::VisionTower;
use super::weights::Weights;
use crate::base::tensor_file::TensorFile;
use crate::error::EngineError;

/// Where a checkpoint comes from.
#[derive(Clone, Debug)]
pub enum ClipSource<'a> {
    /// The miniature CLIP that ships with guard4d: for demonstrations, tests and drafts.
    Mini,
    /// A folder with `config.json` and `model.safetensors`.
    Dir(PathBuf),
    /// The two files' content.
    Bytes {
        /// `config.json`
        config: &'a [u8],
        /// `model.safetensors`
        weights: &'a [u8],
    },
}

/// A checked checkpoint; towers are put on the device when they are asked for.
#[derive(Debug)]
pub struct ClipModel {
    device: Device,
    config: ClipConfig,
    weights: Weights,
    hash: blake3::Hash,
    precision: Precision,
    is_built_in: bool,
}

impl<'a> ClipSource<'a> {
    /// `mini`, or a folder.
    #[must_use]
    pub fn from_argument(text: &str) -> Self {
        if text == "mini" { Self::Mini } else { Self::Dir(PathBuf::from(text)) }
    }
}

impl ClipModel {
    /// Reads a checkpoint and checks its keys and shapes against its configuration.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] without the files; [`EngineError::BadData`] naming the first key that is missing,
    /// unexpected or of another shape.
    pub fn load(device: &Device, source: &ClipSource) -> Result<Self, EngineError> {
        match source {
            ClipSource::Mini => {
                let config = include_bytes!("../../../assets/mini-clip/config.json");
                let weights = include_bytes!("../../../assets/mini-clip/model.safetensors");
                let mini = Self::from_bytes(device, Path::new("miniature CLIP"), config, weights)?;
                Ok(Self { is_built_in: true, ..mini })
            }
            ClipSource::Dir(dir) => {
                let (config, path) = (dir.join("config.json"), dir.join("model.safetensors"));
                let sizes = ClipConfig::from_json(&config, &read(&config)?)?;
                Self::new(device, &path, sizes, &read(&path)?)
            }
            ClipSource::Bytes { config, weights } => Self::from_bytes(device, Path::new("CLIP"), config, weights),
        }
    }

    fn from_bytes(device: &Device, path: &Path, config: &[u8], weights: &[u8]) -> Result<Self, EngineError> {
        Self::new(device, path, ClipConfig::from_json(path, config)?, weights)
    }

    fn new(device: &Device, path: &Path, config: ClipConfig, weights: &[u8]) -> Result<Self, EngineError> {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&serde_json::to_vec(&config).expect("a configuration of numbers and strings is valid JSON"));
        hasher.update(blake3::hash(weights).as_bytes());
        let weights = Weights::new(TensorFile::from_bytes(path, weights)?, &config)?;
        Ok(Self {
            device: device.clone(),
            config,
            weights,
            hash: hasher.finalize(),
            precision: Precision::F32,
            is_built_in: false,
        })
    }

    /// The same checkpoint with the image tower's matrices kept in this precision, and with [`Precision::Half`] its
    /// attention computed in it. The text tower always has floats, so that keys and token tables do not depend on it.
    #[must_use]
    pub fn in_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    /// Of the image tower's matrices.
    #[must_use]
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// Whether it is the one inside the program, which no owner chose.
    #[must_use]
    pub fn is_built_in(&self) -> bool {
        self.is_built_in
    }

    /// Sizes of both towers.
    #[must_use]
    pub fn config(&self) -> &ClipConfig {
        &self.config
    }

    /// BLAKE3 over the sizes and the hash of the weights file: what receipts and keys are bound to.
    #[must_use]
    pub fn hash(&self) -> blake3::Hash {
        self.hash
    }

    /// File that the weights came from, for messages.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.weights.path()
    }

    /// Puts the image tower on the device.
    ///
    /// # Errors
    /// When memory runs out; [`KernelError::Unsuitable`](guard4d_kernels::KernelError::Unsuitable) where 16-bit floats
    /// are asked of a device that computes attention wrongly in them.
    pub fn vision(&self, purpose: TowerPurpose) -> Result<VisionTower, EngineError> {
        if self.precision == Precision::Half {
            check_attention(&self.device)?;
        }
        VisionTower::load(&self.device, &self.weights, &self.config, purpose, self.precision)
    }

    /// Puts the text tower on the device.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn text(&self) -> Result<TextTower, EngineError> {
        TextTower::load(&self.device, &self.weights, &self.config)
    }
}

fn read(path: &Path) -> Result<Vec<u8>, EngineError> {
    std::fs::read(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => {
            EngineError::MissingInput { path: path.to_owned(), expected: "a CLIP checkpoint".to_owned() }
        }
        _ => EngineError::Io { path: path.to_owned(), source },
    })
}
