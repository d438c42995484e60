//! Checkpoint tensors: exactly the keys and shapes that the configuration asks for.

use std::path::Path;

use super::config::{ClipConfig, Sizes, expected_tensors};
use crate::base::files::bad_data;
use crate::base::tensor_file::{TensorFile, Values};
use crate::error::EngineError;

/// Buffers that some versions of the reference implementation saved along; their content is 0, 1, 2, ….
const IGNORED: [&str; 2] = ["text_model.embeddings.position_ids", "vision_model.embeddings.position_ids"];

/// The tensors of a `CLIPModel`, checked.
#[derive(Debug)]
pub(super) struct Weights {
    file: TensorFile,
}

impl Weights {
    /// Checks that `file` holds every tensor of `config`, in its shape, and nothing else.
    pub(super) fn new(file: TensorFile, config: &ClipConfig) -> Result<Self, EngineError> {
        let expected = expected_tensors(config);
        for (name, shape) in &expected {
            let Some(tensor) = file.tensors.get(name) else {
                return Err(bad_data(&file.path, name, "no such tensor", format!("{shape:?}")));
            };
            if tensor.shape != *shape {
                return Err(bad_data(&file.path, name, format!("{:?}", tensor.shape), format!("{shape:?}")));
            }
            if !matches!(tensor.values, Values::F32(_)) {
                return Err(bad_data(&file.path, name, "integers", "F32, F16 or BF16"));
            }
            file.finite(name, shape)?;
        }
        let unexpected = |name: &&String| !expected.contains_key(*name) && !IGNORED.contains(&name.as_str());
        if let Some(name) = file.tensors.keys().find(unexpected) {
            return Err(bad_data(&file.path, name, "a tensor", "no tensor of this name in a CLIPModel"));
        }
        Ok(Self { file })
    }

    /// Elements of a tensor that the check has seen.
    pub(super) fn get(&self, name: &str) -> Result<&[f32], EngineError> {
        match self.file.tensors.get(name).map(|t| &t.values) {
            Some(Values::F32(values)) => Ok(values),
            _ => Err(bad_data(&self.file.path, name, "no such tensor", "floats")),
        }
    }

    /// Several tensors one after the other: rows of stacked matrices, or stacked biases.
    pub(super) fn stacked(&self, names: &[String]) -> Result<Vec<f32>, EngineError> {
        let parts: Result<Vec<&[f32]>, EngineError> = names.iter().map(|name| self.get(name)).collect();
        Ok(parts?.concat())
    }

    pub(super) fn path(&self) -> &Path {
        &self.file.path
    }
}

/// Patch weights `[width, 3, patch, patch]` with channels last and padded to four: `[width, patch*patch*4]`.
pub(super) fn channels_last(conv: &[f32], sizes: &Sizes, patch_px: usize) -> Vec<f32> {
    let area = patch_px * patch_px;
    let mut out = vec![0.0; sizes.width * area * 4];
    for (index, value) in conv.iter().enumerate() {
        let (filter, channel, pixel) = (index / (3 * area), index / area % 3, index % area);
        out[(filter * area + pixel) * 4 + channel] = *value;
    }
    out
}
