//! Sizes of a CLIP model, as Hugging Face writes them into `config.json`.

use std::collections::BTreeMap;
use std::path::Path;

use guard4d_kernels::nn::activation::Activation;
use serde::{Deserialize, Serialize};

use crate::base::files::bad_data;
use crate::error::EngineError;

/// Alignment of every width: the lanes of a matrix product.
const WIDTH_UNIT: usize = 8;
/// End-token id that old configurations name although their vocabulary ends the sequence with its last id.
const LEGACY_EOS: u32 = 2;

/// Both towers. A key that is absent has the value that Hugging Face's `CLIPConfig` documents as default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClipConfig {
    /// Width of the joint feature space.
    #[serde(default = "projection_dim")]
    pub projection_dim: usize,
    /// Text tower.
    #[serde(default)]
    pub text_config: TextConfig,
    /// Image tower.
    #[serde(default)]
    pub vision_config: VisionConfig,
}

/// Sizes of the text tower.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TextConfig {
    /// Token ids.
    pub vocab_size: usize,
    /// Elements of a token.
    pub hidden_size: usize,
    /// Elements inside the MLP.
    pub intermediate_size: usize,
    /// Transformer layers.
    pub num_hidden_layers: usize,
    /// Attention heads.
    pub num_attention_heads: usize,
    /// Longest sequence.
    pub max_position_embeddings: usize,
    /// Activation of the MLP.
    pub hidden_act: String,
    /// Epsilon of the layer norms.
    pub layer_norm_eps: f32,
    /// Id that begins a sequence.
    pub bos_token_id: u32,
    /// Id that ends a sequence.
    pub eos_token_id: u32,
}

/// Sizes of the image tower.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct VisionConfig {
    /// Elements of a token.
    pub hidden_size: usize,
    /// Elements inside the MLP.
    pub intermediate_size: usize,
    /// Transformer layers.
    pub num_hidden_layers: usize,
    /// Attention heads.
    pub num_attention_heads: usize,
    /// Channels of an image.
    pub num_channels: usize,
    /// Side of an image in pixels.
    pub image_size: usize,
    /// Side of a patch in pixels.
    pub patch_size: usize,
    /// Activation of the MLP.
    pub hidden_act: String,
    /// Epsilon of the layer norms.
    pub layer_norm_eps: f32,
}

fn projection_dim() -> usize {
    512
}

impl Default for TextConfig {
    fn default() -> Self {
        Self {
            vocab_size: 49_408,
            hidden_size: 512,
            intermediate_size: 2048,
            num_hidden_layers: 12,
            num_attention_heads: 8,
            max_position_embeddings: 77,
            hidden_act: "quick_gelu".to_owned(),
            layer_norm_eps: 1e-5,
            bos_token_id: 49_406,
            eos_token_id: 49_407,
        }
    }
}

impl Default for VisionConfig {
    fn default() -> Self {
        Self {
            hidden_size: 768,
            intermediate_size: 3072,
            num_hidden_layers: 12,
            num_attention_heads: 12,
            num_channels: 3,
            image_size: 224,
            patch_size: 32,
            hidden_act: "quick_gelu".to_owned(),
            layer_norm_eps: 1e-5,
        }
    }
}

/// What the two towers' transformers have in common.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub(super) width: usize,
    pub(super) inner: usize,
    pub(super) layers: usize,
    pub(super) heads: usize,
    pub(super) activation: Activation,
    pub(super) eps: f32,
}

impl ClipConfig {
    /// Reads and checks a `config.json`; `path` is for messages.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the field.
    pub fn from_json(path: &Path, json: &[u8]) -> Result<Self, EngineError> {
        let config: Self = crate::base::json::parse(path, "config", json, "the configuration of a CLIPModel")?;
        config.check(path)?;
        Ok(config)
    }

    /// Every tensor of a checkpoint of these sizes, with its shape.
    #[must_use]
    pub fn tensors(&self) -> BTreeMap<String, Vec<usize>> {
        expected_tensors(self)
    }

    fn check(&self, path: &Path) -> Result<(), EngineError> {
        let (text, vision) = (&self.text_config, &self.vision_config);
        expect(path, "projection_dim", self.projection_dim, self.projection_dim.is_multiple_of(WIDTH_UNIT), UNITS)?;
        let towers = [
            ("text_config", text.hidden_size, text.intermediate_size, text.num_attention_heads, text.num_hidden_layers),
            (
                "vision_config",
                vision.hidden_size,
                vision.intermediate_size,
                vision.num_attention_heads,
                vision.num_hidden_layers,
            ),
        ];
        for (tower, width, inner, heads, layers) in towers {
            let field = |name: &str| format!("{tower}.{name}");
            expect(path, &field("hidden_size"), width, width.is_multiple_of(WIDTH_UNIT), UNITS)?;
            expect(path, &field("intermediate_size"), inner, inner.is_multiple_of(WIDTH_UNIT), UNITS)?;
            let even = heads > 0 && width.is_multiple_of(heads * 4);
            expect(path, &field("num_attention_heads"), heads, even, "heads of a multiple of 4 elements")?;
            expect(path, &field("num_hidden_layers"), layers, true, "at least one layer")?;
        }
        let (side, patch) = (vision.image_size, vision.patch_size);
        expect(path, "vision_config.num_channels", vision.num_channels, vision.num_channels == 3, "3")?;
        expect(path, "vision_config.patch_size", patch, patch <= side, "at most image_size")?;
        expect(path, "text_config.vocab_size", text.vocab_size, text.vocab_size > 2, "more than two tokens")?;
        let longest = text.max_position_embeddings;
        expect(path, "text_config.max_position_embeddings", longest, longest > 2, "begin, end and a token")?;
        activation(path, "text_config.hidden_act", &text.hidden_act)?;
        activation(path, "vision_config.hidden_act", &vision.hidden_act).map(|_| ())
    }

    pub(super) fn text_sizes(&self, path: &Path) -> Result<Sizes, EngineError> {
        let c = &self.text_config;
        Ok(Sizes {
            width: c.hidden_size,
            inner: c.intermediate_size,
            layers: c.num_hidden_layers,
            heads: c.num_attention_heads,
            activation: activation(path, "text_config.hidden_act", &c.hidden_act)?,
            eps: c.layer_norm_eps,
        })
    }

    pub(super) fn vision_sizes(&self, path: &Path) -> Result<Sizes, EngineError> {
        let c = &self.vision_config;
        Ok(Sizes {
            width: c.hidden_size,
            inner: c.intermediate_size,
            layers: c.num_hidden_layers,
            heads: c.num_attention_heads,
            activation: activation(path, "vision_config.hidden_act", &c.hidden_act)?,
            eps: c.layer_norm_eps,
        })
    }
}

impl TextConfig {
    /// Ids that begin and end a sequence. Configurations from before 2023 name 2 as the end; their checkpoints use the
    /// last two ids of the vocabulary.
    #[must_use]
    pub fn begin_and_end(&self) -> (u32, u32) {
        if self.eos_token_id == LEGACY_EOS {
            let last = u32::try_from(self.vocab_size - 1).unwrap_or(u32::MAX);
            (last - 1, last)
        } else {
            (self.bos_token_id, self.eos_token_id)
        }
    }
}

impl VisionConfig {
    /// Tokens of an image: the class token and one per patch.
    #[must_use]
    pub fn tokens(&self) -> usize {
        1 + (self.image_size / self.patch_size).pow(2)
    }
}

const UNITS: &str = "a positive multiple of 8";

fn activation(path: &Path, field: &str, name: &str) -> Result<Activation, EngineError> {
    match name {
        "quick_gelu" => Ok(Activation::QuickGelu),
        "gelu" => Ok(Activation::Gelu),
        "relu" => Ok(Activation::Relu),
        other => Err(bad_data(path, field, other.to_owned(), "quick_gelu, gelu or relu")),
    }
}

fn expect(path: &Path, field: &str, value: usize, holds: bool, expected: &str) -> Result<(), EngineError> {
    if holds && value > 0 { Ok(()) } else { Err(bad_data(path, field, value.to_string(), expected)) }
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
