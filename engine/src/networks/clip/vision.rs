//! The image tower: normalised pixels to features, and the gradient back to the pixels.

use guard4d_kernels::nn::attention::Mask;
use guard4d_kernels::nn::l2_normalize;
use guard4d_kernels::nn::layer_norm::{self, LayerNorm, Rows};
use guard4d_kernels::nn::matmul::Epilogue;
use guard4d_kernels::nn::pack::Precision;
use guard4d_kernels::nn::patch_embed::{self, PatchShape};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::config::{ClipConfig, VisionConfig};
use super::encoder::{Batch, Encoder, EncoderState};
use super::layer::{Linear, Loader, PLAIN, TowerPurpose};
use super::weights::{Weights, channels_last};
use crate::error::EngineError;

/// Weights of the image tower on the device.
#[derive(Debug)]
pub struct VisionTower {
    device: Device,
    config: VisionConfig,
    projection_dim: usize,
    purpose: TowerPurpose,
    patches: Linear,
    /// Position embeddings `[tokens, width]`, class embedding added to the first.
    positions: Vec<f32>,
    pre_norm: LayerNorm,
    encoder: Encoder,
    post_norm: LayerNorm,
    projection: Linear,
}

/// Activations of one batch; made once, reused by every step.
#[derive(Debug)]
pub struct VisionWorkspace {
    shape: PatchShape,
    rows: Buffer<f32>,
    positions: Buffer<f32>,
    embedded: Buffer<f32>,
    encoder: EncoderState,
    pooled: Buffer<f32>,
    v_y: Buffer<f32>,
    v_embeds: Buffer<f32>,
    v_embedded: Buffer<f32>,
    /// Features before normalisation `[B, projection_dim]`.
    pub embeds: Buffer<f32>,
    /// Features of unit length `[B, projection_dim]`.
    pub features: Buffer<f32>,
}

impl VisionWorkspace {
    /// Gives back the memory of activations that the backward pass can compute again, as if the tower had been loaded
    /// for [`TowerPurpose::LeanInputGradient`]; whether there were any.
    pub fn forget_activations(&mut self) -> bool {
        self.encoder.forget_activations()
    }

    /// Whether the backward pass computes activations again.
    #[must_use]
    pub fn recomputes(&self) -> bool {
        self.encoder.recomputes()
    }
}

impl VisionTower {
    pub(super) fn load(
        device: &Device,
        weights: &Weights,
        config: &ClipConfig,
        purpose: TowerPurpose,
        precision: Precision,
    ) -> Result<Self, EngineError> {
        let loader = Loader { device, weights, purpose, precision };
        let sizes = config.vision_sizes(weights.path())?;
        let vision = &config.vision_config;
        let conv = weights.get("vision_model.embeddings.patch_embedding.weight")?;
        let patches = channels_last(conv, &sizes, vision.patch_size);
        let mut positions = weights.get("vision_model.embeddings.position_embedding.weight")?.to_vec();
        for (position, class) in positions.iter_mut().zip(weights.get("vision_model.embeddings.class_embedding")?) {
            *position += class;
        }
        let projection = weights.get("visual_projection.weight")?;
        Ok(Self {
            device: device.clone(),
            config: vision.clone(),
            projection_dim: config.projection_dim,
            purpose,
            patches: loader.matrix("vision patches", &patches, None, 4 * vision.patch_size.pow(2))?,
            positions,
            pre_norm: loader.norm("vision_model.pre_layrnorm", sizes.eps)?,
            encoder: Encoder::load(&loader, "vision_model", sizes)?,
            post_norm: loader.norm("vision_model.post_layernorm", sizes.eps)?,
            projection: loader.matrix("visual projection", projection, None, sizes.width)?,
        })
    }

    /// Side of the square images that the tower takes, in pixels.
    #[must_use]
    pub fn image_size(&self) -> usize {
        self.config.image_size
    }

    /// Elements of a feature.
    #[must_use]
    pub fn projection_dim(&self) -> usize {
        self.projection_dim
    }

    /// What the tower was loaded for.
    #[must_use]
    pub fn purpose(&self) -> TowerPurpose {
        self.purpose
    }

    /// Room for `batch` images; nothing is allocated afterwards.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn workspace(&self, batch: usize) -> Result<VisionWorkspace, KernelError> {
        let (side_px, patch_px) = (self.config.image_size, self.config.patch_size);
        let shape = PatchShape { batch, side_px, patch_px };
        let tokens = self.config.tokens();
        let (width, device) = (self.config.hidden_size, &self.device);
        let sequences = Batch { sequences: batch, tokens, pick: 0, mask: Mask::Full };
        let kept = usize::from(self.purpose.has_gradient());
        Ok(VisionWorkspace {
            shape,
            rows: device.buffer("vision.rows", shape.rows_len())?,
            positions: device.buffer_from("vision.positions", &self.positions.repeat(batch))?,
            embedded: device.buffer("vision.embedded", batch * tokens * width)?,
            encoder: EncoderState::new(device, "vision", &self.encoder, sequences)?,
            pooled: device.buffer("vision.pooled", batch * width)?,
            v_y: device.buffer("vision.v_y", kept * batch * width)?,
            v_embeds: device.buffer("vision.v_embeds", kept * batch * self.projection_dim)?,
            v_embedded: device.buffer("vision.v_embedded", kept * batch * tokens * width)?,
            embeds: device.buffer("vision.embeds", batch * self.projection_dim)?,
            features: device.buffer("vision.features", batch * self.projection_dim)?,
        })
    }

    /// Image features of a batch.
    ///
    /// # Shapes
    /// in `pixels` \[B, S, S, 4\], minus mean over standard deviation per channel, fourth channel ignored ·
    /// out `ws.embeds`, `ws.features` \[B, projection_dim\] (=)
    /// # Equation: Radford et al. 2021, figure 3; features are divided by their length
    /// # Determinism: bitwise
    ///
    /// # Errors
    /// [`KernelError::Shape`] when `pixels` does not fit the workspace.
    pub fn forward(
        &self,
        rec: &mut Recorder,
        pixels: &Buffer<f32>,
        ws: &mut VisionWorkspace,
    ) -> Result<(), KernelError> {
        let tokens = Rows::all(ws.shape.batch * ws.shape.tokens());
        patch_embed::unfold(rec, ws.shape, pixels, &mut ws.rows)?;
        self.patches.forward(rec, &ws.rows, Epilogue::Add(&ws.positions), &mut ws.embedded)?;
        layer_norm::forward(rec, &self.pre_norm, &ws.embedded, tokens, &mut ws.encoder.x[0])?;
        self.encoder.forward(rec, &mut ws.encoder)?;
        layer_norm::forward(rec, &self.post_norm, &ws.encoder.y, Rows::all(ws.shape.batch), &mut ws.pooled)?;
        self.projection.forward(rec, &ws.pooled, PLAIN, &mut ws.embeds)?;
        l2_normalize::forward(rec, &ws.embeds, self.projection_dim, &mut ws.features)
    }

    /// Gradient of the pixels, after [`Self::forward`] with the same workspace.
    ///
    /// # Shapes
    /// in `v_features` \[B, projection_dim\], gradient of `ws.features` · out `v_pixels` \[B, S, S, 4\] (=), fourth
    /// channel zero
    /// # Determinism: bitwise
    ///
    /// # Errors
    /// [`KernelError::Shape`] when a buffer does not fit the workspace, or when the tower was loaded for
    /// [`TowerPurpose::Features`].
    pub fn backward(
        &self,
        rec: &mut Recorder,
        v_features: &Buffer<f32>,
        ws: &mut VisionWorkspace,
        v_pixels: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        if !self.purpose.has_gradient() {
            return Err(KernelError::Shape {
                kernel: "clip/vision",
                buffer: "purpose",
                got: format!("{:?}", self.purpose),
                expected: format!("{:?}", TowerPurpose::InputGradient),
            });
        }
        let (tokens, images) = (Rows::all(ws.shape.batch * ws.shape.tokens()), Rows::all(ws.shape.batch));
        l2_normalize::backward(rec, &ws.embeds, v_features, self.projection_dim, &mut ws.v_embeds)?;
        self.projection.backward(rec, &ws.v_embeds, PLAIN, &mut ws.pooled)?;
        let upstream = layer_norm::Upstream { x: &ws.encoder.y, v_y: &ws.pooled, v_residual: None };
        layer_norm::backward(rec, &self.post_norm, &upstream, images, &mut ws.v_y)?;
        self.encoder.backward(rec, &ws.v_y, &mut ws.encoder)?;
        let upstream = layer_norm::Upstream { x: &ws.embedded, v_y: ws.encoder.v_x(), v_residual: None };
        layer_norm::backward(rec, &self.pre_norm, &upstream, tokens, &mut ws.v_embedded)?;
        self.patches.backward(rec, &ws.v_embedded, PLAIN, &mut ws.rows)?;
        patch_embed::fold(rec, ws.shape, &ws.rows, v_pixels)
    }
}
