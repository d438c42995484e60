//! Modality calibration: a message-independent affine map from CLIP's image features to its text features.
//!
//! Image and text features lie in different cones, and scene content moves image features far more than a mark does.
//! From unmarked clips and from random offsets (which carry no message) this module finds the image directions in which
//! offsets move the features of all views alike, and most in relation to content and to what views disagree about, and
//! maps them onto the directions along which the key's bits move text features. Nothing here depends on a message.

use nalgebra::{DMatrix, DVector};
use rand_chacha::ChaCha20Rng;

use super::pretrained::PretrainedExtractor;
use super::scatter::{AssetFeatures, Scatter};
use crate::base::matrix::{row_major, rows, single};
use crate::base::rotation::random_rotation;
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;
use crate::watermark::key::decoder::{DecoderWeights, Linear};

/// Content's standard deviation along each bit, where ±1 is the text feature of a written bit.
pub const CONTENT_LEVEL: f64 = 0.35;

/// What rounding directions to single precision can change of them, as a share: their lengths differ by a few powers of
/// ten.
const ROUNDING: f64 = 1e-3;

/// The affine map f ↦ mean_text + codesᵀ · directionsᵀ (f − mean_image).
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Mean image feature of unmarked clips `[D]`.
    pub mean_image: Vec<f32>,
    /// Image directions `[D, L]`, scaled and mixed.
    pub directions: Vec<f32>,
    /// Mean logits of unmarked clips `[L]`, taken off the decoder's output: bits of an unmarked clip fall on either
    /// side of zero.
    pub mean_logits: Vec<f32>,
}

impl Calibration {
    /// Fits the directions to an asset; the mean logits are left at zero, for they need the decoder.
    ///
    /// # Equation
    /// The [discriminants](Scatter::discriminants) of the asset, mixed by a keyed rotation so that all bits are equally
    /// hard, and scaled as a whole so that its content stays at a fixed level.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] when features are not finite or too few to fit.
    pub fn fit(data: &AssetFeatures<'_>, bits: usize, rng: &mut ChaCha20Rng) -> Result<Self, EngineError> {
        let scatter = Scatter::of(data)?;
        Self::along(&scatter.discriminants(bits)?, scatter.least_content(), data.content, rng)
    }

    /// The same along the first L of `pretrained`'s directions: of the asset only unmarked clips are looked at,
    /// `content` `[n, D]`, for the zero and the scale.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for more bits than it has directions; [`EngineError::NotFinite`] when features are not
    /// finite.
    pub fn pretrained(
        pretrained: &PretrainedExtractor,
        content: &[f32],
        bits: usize,
        rng: &mut ChaCha20Rng,
    ) -> Result<Self, EngineError> {
        let most = pretrained.most_bits;
        if bits > most {
            return Err(EngineError::Usage {
                what: "pretrained extractor".to_owned(),
                got: format!("a message of {bits} bits"),
                expected: format!("at most {most}, as many as it has directions"),
            });
        }
        let directions = rows(&pretrained.directions, most).columns(0, bits).into_owned();
        Self::along(&directions, pretrained.least_content, content, rng)
    }

    fn along(
        directions: &DMatrix<f64>,
        least: f64,
        content: &[f32],
        rng: &mut ChaCha20Rng,
    ) -> Result<Self, EngineError> {
        let (width, bits) = directions.shape();
        let content = rows(content, width);
        let mean = content.row_mean();
        let centred = DMatrix::from_fn(content.nrows(), width, |i, j| content[(i, j)] - mean[j]);
        let mixed = directions * random_rotation(bits, rng);
        let projected = &centred * &mixed;
        let shown = projected.norm_squared() / projected.len().max(1) as f64;
        let level = shown.max(least * mixed.norm_squared() / bits.max(1) as f64).sqrt();
        let scaled = mixed * (CONTENT_LEVEL / level);
        if mean.iter().chain(scaled.iter()).any(|v| !v.is_finite()) {
            return Err(EngineError::NotFinite { what: "calibrated directions".to_owned(), got: f64::NAN });
        }
        Ok(Self {
            mean_image: mean.iter().map(|v| single(*v)).collect(),
            directions: row_major(&scaled),
            mean_logits: vec![0.0; bits],
        })
    }

    /// The same directions as the rotation of `to` mixes them instead of that of `from`; the mean logits are left at
    /// zero again.
    #[must_use]
    pub fn mixed_anew(&self, from: &mut ChaCha20Rng, to: &mut ChaCha20Rng) -> Self {
        let bits = self.mean_logits.len();
        let turn = random_rotation(bits, from).transpose() * random_rotation(bits, to);
        let directions = row_major(&(rows(&self.directions, bits) * turn));
        Self { mean_image: self.mean_image.clone(), directions, mean_logits: vec![0.0; bits] }
    }

    /// Whether the directions are the first L of `pretrained`'s, mixed by the rotation of `key_rotation` and scaled as
    /// [`Calibration::pretrained`] does, and in no other way.
    #[must_use]
    pub fn is_along(&self, pretrained: &PretrainedExtractor, key_rotation: &mut ChaCha20Rng) -> bool {
        let (width, bits, most) = (self.mean_image.len(), self.mean_logits.len(), pretrained.most_bits);
        if bits > most || pretrained.directions.len() != width * most {
            return false;
        }
        let own = rows(&self.directions, bits);
        let known = rows(&pretrained.directions, most).columns(0, bits).into_owned();
        let Some(cholesky) = known.tr_mul(&known).cholesky() else { return false };
        let turn = cholesky.solve(&known.tr_mul(&own));
        let beside = (&own - &known * &turn).norm() / own.norm();
        let rotation = random_rotation(bits, key_rotation);
        let scale = turn.dot(&rotation) / bits.max(1) as f64;
        beside < ROUNDING && scale > 0.0 && (&turn - scale * rotation).norm() < ROUNDING * turn.norm()
    }

    /// Coordinates `[L]` of the mean of some features `[n, D]` along the calibrated directions: 0 where unmarked clips
    /// have their mean, about ±1 per written bit.
    ///
    /// # Equation: z = directionsᵀ (mean f − mean_image), in f64
    #[must_use]
    pub fn coordinates(&self, features: &[f32]) -> Vec<f64> {
        let (width, bits) = (self.mean_image.len(), self.mean_logits.len());
        let mean_image = rows(&self.mean_image, width);
        let moved = rows(features, width).row_mean() - mean_image;
        (moved * rows(&self.directions, bits)).iter().copied().collect()
    }

    /// The decoder with this map folded into its first layer, so that it reads image features directly, and the mean
    /// logits into its last.
    #[must_use]
    pub fn fold(&self, decoder: &DecoderWeights, codes: &[f32], text_mean: &[f32]) -> DecoderWeights {
        let (width, bits) = (decoder.width(), decoder.bits());
        let first = &decoder.layers[0];
        let weight = rows(&first.weight, width);
        let map = rows(&self.directions, bits) * rows(codes, width); // [D image, D text]
        let folded = &weight * map.transpose();
        let mean_image = DVector::from_iterator(width, self.mean_image.iter().map(|v| f64::from(*v)));
        let text_mean = DVector::from_iterator(width, text_mean.iter().map(|v| f64::from(*v)));
        let shift = &weight * text_mean - &folded * mean_image;
        let bias = first.bias.iter().zip(shift.iter()).map(|(b, s)| single(f64::from(*b) + s)).collect();
        let mut layers = decoder.layers.clone();
        layers[0] = Linear { weight: row_major(&folded), bias, ..first.clone() };
        if let Some(last) = layers.last_mut() {
            last.bias.iter_mut().zip(&self.mean_logits).for_each(|(b, mean)| *b -= mean);
        }
        DecoderWeights { layers }
    }

    /// Adds the tensors `calibration.mean_image`, `calibration.directions` and
    /// `calibration.mean_logits` to a file.
    pub fn store(&self, file: &mut TensorFile, bits: usize) {
        let width = self.mean_image.len();
        file.tensors.insert("calibration.mean_image".to_owned(), Tensor::f32(&[width], self.mean_image.clone()));
        let directions = Tensor::f32(&[width, bits], self.directions.clone());
        file.tensors.insert("calibration.directions".to_owned(), directions);
        file.tensors.insert("calibration.mean_logits".to_owned(), Tensor::f32(&[bits], self.mean_logits.clone()));
    }

    /// Reads what [`Calibration::store`] wrote.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the tensor.
    pub fn load(file: &TensorFile, width: usize, bits: usize) -> Result<Self, EngineError> {
        Ok(Self {
            mean_image: file.finite("calibration.mean_image", &[width])?.to_vec(),
            directions: file.finite("calibration.directions", &[width, bits])?.to_vec(),
            mean_logits: file.finite("calibration.mean_logits", &[bits])?.to_vec(),
        })
    }
}
