//! Modality calibration: a message-independent affine map from CLIP's image features to its text features.
//!
//! Image and text features lie in different cones, and scene content moves image features far more than a
//! mark does. From unmarked clips and from random offsets (which carry no message) this module finds the
//! image directions in which offsets move the features of all views alike, and most in relation to content and to what
//! views disagree about, and maps them onto the directions along which the key's bits move text features. Nothing here depends on a message.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rand_chacha::ChaCha20Rng;

use super::decoder::{DecoderWeights, Linear};
use super::prf::standard_normal;
use crate::error::EngineError;
use crate::tensor_file::{Tensor, TensorFile};

/// Ridge on the covariance of content and of what views disagree about, as a share of its mean eigenvalue: few clips must not look like certainty.
const RIDGE: f64 = 0.05;
/// Least variance that content counts as having, as a share of what random offsets cause: a scene whose unmarked clips are all
/// alike (all white, say) can be read too.
const LEAST_CONTENT: f64 = 1e-3;
/// Weight of what views make of the same offsets, each its own, beside what content makes: offsets have to move all views
/// alike, and training makes more of both than random fields do. Measured on three scenes with two keys each: docs/method.md.
const APART_WEIGHT: f64 = 4.0;
/// Content's standard deviation along each bit, where ±1 is the text feature of a written bit.
pub const CONTENT_LEVEL: f64 = 0.35;

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

/// Features that a calibration is fitted to, all of unmarked or randomly perturbed clips.
#[derive(Debug)]
pub struct CalibrationData<'a> {
    /// Features of unmarked frames `[n, D]`.
    pub content: &'a [f32],
    /// Features of unmarked frames in copies that differ from them by what copies go through `[m, D]`; may be empty.
    pub copies: &'a [f32],
    /// Feature change that each random offset field causes in each of its frames `[k, F, D]`.
    pub responses: &'a [f32],
    /// `F`, of as many views as can be
    pub frames: usize,
    /// `D`
    pub width: usize,
    /// `L`
    pub bits: usize,
}

impl Calibration {
    /// Fits the directions; the mean logits are left at zero, for they need the decoder.
    ///
    /// # Equation
    /// The L leading solutions v of Σ_response v = λ (Σ_content + w Σ_apart + ridge + Σ_copies) v (Fisher 1936, discriminants), where
    /// Σ_response is of the fields' mean responses, Σ_apart of what single frames respond beside them and Σ_copies of how far copies lie from the mean of the content; scaled to equal response, mixed by a keyed rotation so that all bits are equally hard, and scaled as a whole so
    /// that content stays at a fixed level.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] when features are not finite or too few to fit.
    pub fn fit(data: &CalibrationData<'_>, rng: &mut ChaCha20Rng) -> Result<Self, EngineError> {
        let CalibrationData { width, bits, frames, .. } = *data;
        let not_finite = |what: &str| EngineError::NotFinite { what: what.to_owned(), got: f64::NAN };
        // The eigenvalue iteration would never end on them.
        if data.content.iter().chain(data.responses).chain(data.copies).any(|v| !v.is_finite()) {
            return Err(not_finite("image features for the calibration"));
        }
        if data.content.is_empty() {
            return Err(not_finite("image features of no unmarked clip at all"));
        }
        let content = rows(data.content, width);
        let mean = content.row_mean();
        let centred = DMatrix::from_fn(content.nrows(), width, |i, j| content[(i, j)] - mean[j]);
        let mut noise = centred.tr_mul(&centred) / content.nrows().max(1) as f64;
        let (responses, apart) = means_and_rests(&rows(data.responses, width), frames);
        noise += APART_WEIGHT * apart.tr_mul(&apart) / apart.nrows().saturating_sub(responses.nrows()).max(1) as f64;
        let caused = responses.norm_squared() / responses.nrows().max(1) as f64;
        let least = RIDGE * LEAST_CONTENT * caused / width as f64;
        let ridge = least.max(RIDGE * noise.trace() / width as f64);
        for i in 0..width {
            noise[(i, i)] += ridge;
        }
        // After the ridge: copies can lie far from the mean, but in few directions, and say nothing of the others.
        let copies = rows(data.copies, width);
        let shifts = DMatrix::from_fn(copies.nrows(), width, |i, j| copies[(i, j)] - mean[j]);
        noise += shifts.tr_mul(&shifts) / copies.nrows().max(1) as f64;
        let cholesky = noise.cholesky().ok_or_else(|| not_finite("image features of the unmarked clips"))?;
        // With the content whitened (w = L⁻¹ r), the problem is the responses' own Gram matrix.
        let whitened =
            cholesky.l().solve_lower_triangular(&responses.transpose()).ok_or_else(|| not_finite("content"))?;
        let gram = whitened.tr_mul(&whitened) / responses.nrows().max(1) as f64;
        let eigen = SymmetricEigen::new(gram);
        let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let weakest = order.get(bits - 1).map_or(0.0, |&i| eigen.eigenvalues[i]);
        if weakest.is_nan() || weakest <= 0.0 {
            return Err(not_finite("response of the image features to offsets"));
        }
        let mut directions = DMatrix::zeros(width, bits);
        for (column, &index) in order[..bits].iter().enumerate() {
            let in_span: DVector<f64> = &whitened * eigen.eigenvectors.column(index);
            let in_span = in_span.normalize() / eigen.eigenvalues[index].sqrt();
            let direction = cholesky.l().tr_solve_lower_triangular(&in_span).ok_or_else(|| not_finite("content"))?;
            directions.set_column(column, &direction);
        }
        let mixed = directions * random_rotation(bits, rng);
        let projected = &centred * &mixed;
        let shown = projected.norm_squared() / projected.len().max(1) as f64;
        let level = shown.max(least * mixed.norm_squared() / bits.max(1) as f64).sqrt();
        let scaled = mixed * (CONTENT_LEVEL / level);
        if scaled.iter().any(|v| !v.is_finite()) {
            return Err(not_finite("calibrated directions"));
        }
        Ok(Self {
            mean_image: mean.iter().map(|v| single(*v)).collect(),
            directions: row_major(&scaled),
            mean_logits: vec![0.0; bits],
        })
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

/// Half the mean change of the text feature when a bit flips from 0 to 1 `[L, D]`.
///
/// # Shapes
/// in `features` [n, D] · `signs` [n, L], ±1 · `mean` [D]
#[must_use]
pub fn bit_codes(features: &[f32], signs: &[f32], mean: &[f32], bits: usize) -> Vec<f32> {
    let width = mean.len();
    let centred = DMatrix::from_fn(features.len() / width, width, |i, j| f64::from(features[i * width + j] - mean[j]));
    row_major(&(rows(signs, bits).tr_mul(&centred) / centred.nrows().max(1) as f64))
}

/// The coordinates that a calibration mixed by another key has: a rotation of a rotated frame is one more rotation.
///
/// # Shapes
/// in `coordinates` [L] · out [L]
pub(super) fn remix(coordinates: &[f64], rng: &mut ChaCha20Rng) -> Vec<f64> {
    let mixed = random_rotation(coordinates.len(), rng).tr_mul(&DVector::from_column_slice(coordinates));
    mixed.iter().copied().collect()
}

/// A uniformly distributed rotation (QR of a Gaussian matrix, with the signs of R's diagonal).
fn random_rotation(n: usize, rng: &mut ChaCha20Rng) -> DMatrix<f64> {
    let gaussian = DMatrix::from_fn(n, n, |_, _| standard_normal(rng));
    let (mut q, r) = gaussian.qr().unpack();
    for j in 0..n {
        if r[(j, j)] < 0.0 {
            q.column_mut(j).neg_mut();
        }
    }
    q
}

/// Means of groups of rows, and what each row has beside its group's.
fn means_and_rests(all: &DMatrix<f64>, group: usize) -> (DMatrix<f64>, DMatrix<f64>) {
    let group = group.max(1);
    let means = DMatrix::from_fn(all.nrows() / group, all.ncols(), |i, j| all.view((i * group, j), (group, 1)).mean());
    let rests = DMatrix::from_fn(means.nrows() * group, all.ncols(), |i, j| all[(i, j)] - means[(i / group, j)]);
    (means, rests)
}

fn rows(values: &[f32], width: usize) -> DMatrix<f64> {
    DMatrix::from_fn(values.len() / width, width, |i, j| f64::from(values[i * width + j]))
}

fn row_major(matrix: &DMatrix<f64>) -> Vec<f32> {
    matrix.transpose().iter().map(|v| single(*v)).collect()
}

#[allow(clippy::cast_possible_truncation, reason = "single precision is what the device takes")]
fn single(value: f64) -> f32 {
    value as f32
}
