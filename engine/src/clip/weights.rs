//! Checkpoint tensors: exactly the keys and shapes that the configuration asks for.

use std::collections::BTreeMap;
use std::path::Path;

use super::config::{ClipConfig, Sizes};
use crate::error::EngineError;
use crate::tensor_file::{TensorFile, Values};

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
                return Err(bad(&file.path, name, "no such tensor", &format!("{shape:?}")));
            };
            if tensor.shape != *shape {
                return Err(bad(&file.path, name, &format!("{:?}", tensor.shape), &format!("{shape:?}")));
            }
            if !matches!(tensor.values, Values::F32(_)) {
                return Err(bad(&file.path, name, "integers", "F32, F16 or BF16"));
            }
            file.finite(name, shape)?;
        }
        let stranger = |name: &&String| !expected.contains_key(*name) && !IGNORED.contains(&name.as_str());
        if let Some(name) = file.tensors.keys().find(stranger) {
            return Err(bad(&file.path, name, "a tensor", "no tensor of this name in a CLIPModel"));
        }
        Ok(Self { file })
    }

    /// Elements of a tensor that the check has seen.
    pub(super) fn get(&self, name: &str) -> Result<&[f32], EngineError> {
        match self.file.tensors.get(name).map(|t| &t.values) {
            Some(Values::F32(values)) => Ok(values),
            _ => Err(bad(&self.file.path, name, "no such tensor", "floats")),
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

/// Every tensor of a `CLIPModel` of these sizes, with its shape.
pub(super) fn expected_tensors(config: &ClipConfig) -> BTreeMap<String, Vec<usize>> {
    let (text, vision) = (&config.text_config, &config.vision_config);
    let (text_width, width, patch) = (text.hidden_size, vision.hidden_size, vision.patch_size);
    let mut all = BTreeMap::new();
    let mut add = |name: &str, shape: &[usize]| {
        all.insert(name.to_owned(), shape.to_vec());
    };
    add("logit_scale", &[]);
    add("text_projection.weight", &[config.projection_dim, text_width]);
    add("visual_projection.weight", &[config.projection_dim, width]);
    add("text_model.embeddings.token_embedding.weight", &[text.vocab_size, text_width]);
    add("text_model.embeddings.position_embedding.weight", &[text.max_position_embeddings, text_width]);
    add("vision_model.embeddings.class_embedding", &[width]);
    add("vision_model.embeddings.patch_embedding.weight", &[width, vision.num_channels, patch, patch]);
    add("vision_model.embeddings.position_embedding.weight", &[vision.tokens(), width]);
    // The reference implementation spells `pre_layrnorm`, and so does every checkpoint.
    let norms = [
        ("text_model.final_layer_norm", text_width),
        ("vision_model.pre_layrnorm", width),
        ("vision_model.post_layernorm", width),
    ];
    for (name, width) in norms {
        add(&format!("{name}.weight"), &[width]);
        add(&format!("{name}.bias"), &[width]);
    }
    add_layers(&mut all, "text_model", text_width, text.intermediate_size, text.num_hidden_layers);
    add_layers(&mut all, "vision_model", width, vision.intermediate_size, vision.num_hidden_layers);
    all
}

fn add_layers(all: &mut BTreeMap<String, Vec<usize>>, tower: &str, width: usize, inner: usize, layers: usize) {
    for layer in 0..layers {
        let linears = [
            ("self_attn.q_proj", width, width),
            ("self_attn.k_proj", width, width),
            ("self_attn.v_proj", width, width),
            ("self_attn.out_proj", width, width),
            ("mlp.fc1", inner, width),
            ("mlp.fc2", width, inner),
        ];
        for (name, outputs, inputs) in linears {
            all.insert(format!("{}.{name}.weight", layer_prefix(tower, layer)), vec![outputs, inputs]);
            all.insert(format!("{}.{name}.bias", layer_prefix(tower, layer)), vec![outputs]);
        }
        for name in ["layer_norm1", "layer_norm2"] {
            all.insert(format!("{}.{name}.weight", layer_prefix(tower, layer)), vec![width]);
            all.insert(format!("{}.{name}.bias", layer_prefix(tower, layer)), vec![width]);
        }
    }
}

/// Key prefix of a transformer layer.
pub(super) fn layer_prefix(tower: &str, layer: usize) -> String {
    format!("{tower}.encoder.layers.{layer}")
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

fn bad(path: &Path, field: &str, got: &str, expected: &str) -> EngineError {
    EngineError::BadData {
        path: path.to_owned(),
        field: field.to_owned(),
        got: got.to_owned(),
        expected: expected.to_owned(),
    }
}
