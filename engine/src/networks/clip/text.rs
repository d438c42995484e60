//! The text tower: token sequences to features.

use guard4d_kernels::nn::attention::Mask;
use guard4d_kernels::nn::embedding::{self, Tables};
use guard4d_kernels::nn::l2_normalize;
use guard4d_kernels::nn::layer_norm::{self, LayerNorm, Rows};
use guard4d_kernels::nn::pack::Precision;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::config::{ClipConfig, TextConfig};
use super::encoder::{Batch, Encoder, EncoderState};
use super::layer::{Linear, Loader, PLAIN, TowerPurpose};
use super::weights::Weights;
use crate::error::EngineError;

/// Sequences per submission of [`TextTower::embed`].
const CHUNK: usize = 64;

/// Weights of the text tower on the device.
#[derive(Debug)]
pub struct TextTower {
    device: Device,
    config: TextConfig,
    projection_dim: usize,
    table: Buffer<f32>,
    position: Buffer<f32>,
    encoder: Encoder,
    final_norm: LayerNorm,
    projection: Linear,
}

/// Activations of a batch of sequences of one length.
#[derive(Debug)]
struct TextWorkspace {
    ids: Buffer<u32>,
    tokens: usize,
    encoder: EncoderState,
    pooled: Buffer<f32>,
    embeds: Buffer<f32>,
    features: Buffer<f32>,
}

/// Features of some sequences, host side, row-major `[n, projection_dim]`.
#[derive(Clone, Debug, PartialEq)]
pub struct TextFeatures {
    /// Before normalisation.
    pub embeds: Vec<f32>,
    /// Of unit length.
    pub features: Vec<f32>,
}

impl TextTower {
    pub(super) fn load(device: &Device, weights: &Weights, config: &ClipConfig) -> Result<Self, EngineError> {
        let loader = Loader { device, weights, purpose: TowerPurpose::Features, precision: Precision::F32 };
        let sizes = config.text_sizes(weights.path())?;
        let table = weights.get("text_model.embeddings.token_embedding.weight")?;
        let position = weights.get("text_model.embeddings.position_embedding.weight")?;
        let projection = weights.get("text_projection.weight")?;
        Ok(Self {
            device: device.clone(),
            config: config.text_config.clone(),
            projection_dim: config.projection_dim,
            table: device.buffer_from("token embeddings", table)?,
            position: device.buffer_from("position embeddings", position)?,
            encoder: Encoder::load(&loader, "text_model", sizes)?,
            final_norm: loader.norm("text_model.final_layer_norm", sizes.eps)?,
            projection: loader.matrix("text projection", projection, None, sizes.width)?,
        })
    }

    /// Elements of a feature.
    #[must_use]
    pub fn projection_dim(&self) -> usize {
        self.projection_dim
    }

    /// Sizes and special tokens.
    #[must_use]
    pub fn config(&self) -> &TextConfig {
        &self.config
    }

    /// Features of token sequences of one common length, read at their last token.
    ///
    /// The mask is causal, so tokens after the end token cannot change the feature: leave the padding away.
    ///
    /// # Shapes
    /// in `sequences` n sequences of `tokens` ids each, begin and end token included, one after the other ·
    /// out \[n, projection_dim\]
    /// # Determinism: bitwise, and independent of how many sequences are given
    ///
    /// # Errors
    /// [`EngineError::Usage`] when the length does not fit the tower or an id leaves its vocabulary.
    pub fn embed(&self, sequences: &[u32], tokens: usize) -> Result<TextFeatures, EngineError> {
        self.check(sequences, tokens)?;
        let (count, dim) = (sequences.len() / tokens, self.projection_dim);
        let mut ws = self.workspace(CHUNK.min(count), tokens)?;
        let mut found = TextFeatures { embeds: Vec::new(), features: Vec::new() };
        for chunk in sequences.chunks(CHUNK * tokens) {
            ws.ids.write_at(0, chunk)?;
            let mut rec = self.device.recorder()?;
            self.forward(&mut rec, &mut ws)?;
            rec.submit()?;
            let used = 0..chunk.len() / tokens * dim;
            found.embeds.extend(ws.embeds.read_range(used.clone())?);
            found.features.extend(ws.features.read_range(used)?);
        }
        Ok(found)
    }

    fn check(&self, sequences: &[u32], tokens: usize) -> Result<(), EngineError> {
        let usage =
            |what: &str, got: String, expected: String| EngineError::Usage { what: what.to_owned(), got, expected };
        let longest = self.config.max_position_embeddings;
        if tokens == 0 || tokens > longest {
            return Err(usage("tokens per sequence", tokens.to_string(), format!("1 to {longest}")));
        }
        if !sequences.len().is_multiple_of(tokens) {
            return Err(usage("token ids", sequences.len().to_string(), format!("a multiple of {tokens}")));
        }
        let vocab = self.config.vocab_size;
        match sequences.iter().find(|id| **id as usize >= vocab) {
            Some(id) => Err(usage("token id", id.to_string(), format!("below {vocab}"))),
            None => Ok(()),
        }
    }

    fn workspace(&self, sequences: usize, tokens: usize) -> Result<TextWorkspace, KernelError> {
        let (device, width) = (&self.device, self.config.hidden_size);
        let batch = Batch { sequences, tokens, pick: tokens - 1, mask: Mask::Causal };
        Ok(TextWorkspace {
            ids: device.buffer("text.ids", sequences * tokens)?,
            tokens,
            encoder: EncoderState::new(device, "text", &self.encoder, batch)?,
            pooled: device.buffer("text.pooled", sequences * width)?,
            embeds: device.buffer("text.embeds", sequences * self.projection_dim)?,
            features: device.buffer("text.features", sequences * self.projection_dim)?,
        })
    }

    fn forward(&self, rec: &mut Recorder, ws: &mut TextWorkspace) -> Result<(), KernelError> {
        let width = self.config.hidden_size;
        let tables = Tables { table: &self.table, position: &self.position, width };
        embedding::gather(rec, &tables, &ws.ids, ws.tokens, &mut ws.encoder.x[0])?;
        self.encoder.forward(rec, &mut ws.encoder)?;
        let sequences = Rows::all(ws.ids.len() / ws.tokens);
        layer_norm::forward(rec, &self.final_norm, &ws.encoder.y, sequences, &mut ws.pooled)?;
        self.projection.forward(rec, &ws.pooled, PLAIN, &mut ws.embeds)?;
        l2_normalize::forward(rec, &ws.embeds, self.projection_dim, &mut ws.features)
    }
}
