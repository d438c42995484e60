//! What moves CLIP's image features: second moments of content, of copies and of random offsets, in one asset or in
//! many.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::base::matrix::{row_major, rows, single};
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;

/// Ridge on the covariance of content and of what views disagree about, as a share of its mean eigenvalue: few clips
/// must not look like certainty.
const RIDGE: f64 = 0.05;
/// Least variance that content counts as having, as a share of what random offsets cause: a scene whose unmarked clips
/// are all alike (all white, say) can be read too.
const LEAST_CONTENT: f64 = 1e-3;
/// Weight of what views make of the same offsets, each its own, beside what content makes: offsets have to move all
/// views alike, and training makes more of both than random fields do. Measured on three scenes with two keys each:
/// docs/log/2026-11-23.md, "What a field and its negative both do".
const APART_WEIGHT: f64 = 4.0;

/// Features of one asset, all of unmarked or randomly perturbed clips.
#[derive(Debug)]
pub struct AssetFeatures<'a> {
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
}

/// Sums of second moments over assets, each asset's about its own mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Scatter {
    /// Content, and what views disagree about `[D, D]`.
    noise: DMatrix<f64>,
    /// How far copies lie from the content's mean `[D, D]`.
    copies: DMatrix<f64>,
    /// Rows whose second moments are those of the fields' mean responses `[r, D]`, at most D of them where assets were
    /// added.
    responses: DMatrix<f64>,
}

impl Scatter {
    /// Of one asset.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] when features are not finite or there is no content.
    pub fn of(data: &AssetFeatures<'_>) -> Result<Self, EngineError> {
        let AssetFeatures { width, frames, .. } = *data;
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
        let copies = rows(data.copies, width);
        let shifts = DMatrix::from_fn(copies.nrows(), width, |i, j| copies[(i, j)] - mean[j]);
        let share = 1.0 / (responses.nrows().max(1) as f64).sqrt();
        Ok(Self { noise, copies: shifts.tr_mul(&shifts) / copies.nrows().max(1) as f64, responses: share * responses })
    }

    /// The sum of two, [stored](Self::stored).
    #[must_use]
    pub fn with(&self, other: &Self) -> Self {
        let (mine, theirs, width) = (self.responses.nrows(), other.responses.nrows(), self.noise.nrows());
        let mut responses = DMatrix::zeros(mine + theirs, width);
        responses.rows_mut(0, mine).copy_from(&self.responses);
        responses.rows_mut(mine, theirs).copy_from(&other.responses);
        if responses.nrows() > width {
            // As many rows as there are columns have the same second moments.
            responses = responses.qr().unpack_r();
        }
        Self { noise: &self.noise + &other.noise, copies: &self.copies + &other.copies, responses }.stored()
    }

    /// The same in single precision, as files hold it.
    #[must_use]
    pub fn stored(&self) -> Self {
        let stored = |matrix: &DMatrix<f64>| matrix.map(|value| f64::from(single(value)));
        Self { noise: stored(&self.noise), copies: stored(&self.copies), responses: stored(&self.responses) }
    }

    /// Adds the tensors `scatter.noise`, `scatter.copies` and `scatter.responses` to a file.
    pub fn store(&self, file: &mut TensorFile) {
        let width = self.noise.nrows();
        let mut add = |name: &str, matrix: &DMatrix<f64>| {
            let tensor = Tensor::f32(&[matrix.nrows(), width], row_major(matrix));
            file.tensors.insert(format!("scatter.{name}"), tensor);
        };
        add("noise", &self.noise);
        add("copies", &self.copies);
        add("responses", &self.responses);
    }

    /// Reads what [`Scatter::store`] wrote.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the tensor.
    pub fn load(file: &TensorFile) -> Result<Self, EngineError> {
        let width = file.get("scatter.noise")?.shape.first().copied().unwrap_or(0);
        let matrix = |name: &str, height: usize| -> Result<DMatrix<f64>, EngineError> {
            Ok(rows(file.finite(&format!("scatter.{name}"), &[height, width])?, width))
        };
        let responses = file.get("scatter.responses")?.shape.first().copied().unwrap_or(0);
        Ok(Self {
            noise: matrix("noise", width)?,
            copies: matrix("copies", width)?,
            responses: matrix("responses", responses)?,
        })
    }

    /// Variance along a direction that content has at least.
    pub(crate) fn least_content(&self) -> f64 {
        RIDGE * LEAST_CONTENT * self.responses.norm_squared() / self.noise.nrows() as f64
    }

    /// Σ_content + w Σ_apart + ridge + Σ_copies
    fn all_noise(&self) -> DMatrix<f64> {
        let width = self.noise.nrows();
        let ridge = self.least_content().max(RIDGE * self.noise.trace() / width as f64);
        // The copies after the ridge: they can lie far from the mean, but in few directions, and say nothing of the
        // others.
        &self.noise + DMatrix::from_diagonal_element(width, width, ridge) + &self.copies
    }

    /// Mean ratio of response to noise in the space of some directions `[D, L]`: what the discriminants make as large
    /// as can be.
    ///
    /// # Equation: tr((Vᵀ Σ_noise V)⁻¹ Vᵀ Σ_response V) / L
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] for directions that depend on each other.
    pub fn separation(&self, directions: &DMatrix<f64>) -> Result<f64, EngineError> {
        let noise = directions.tr_mul(&(self.all_noise() * directions));
        let seen = &self.responses * directions;
        let cholesky = noise.cholesky().ok_or_else(|| not_finite("directions"))?;
        Ok(cholesky.solve(&seen.tr_mul(&seen)).trace() / directions.ncols().max(1) as f64)
    }

    /// Image directions `[D, L]` in which offsets move the features of all views alike, and most in relation to
    /// content, to what views disagree about and to what copies do; in falling order of that ratio, each scaled to a
    /// mean square response of 1.
    ///
    /// # Equation
    /// The L leading solutions v of Σ_response v = λ (Σ_content + w Σ_apart + ridge + Σ_copies) v (Fisher 1936,
    /// discriminants), where Σ_response is of the fields' mean responses, Σ_apart of what single frames respond beside
    /// them and Σ_copies of how far copies lie from the mean of the content.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] with fewer independent responses than bits.
    pub fn discriminants(&self, bits: usize) -> Result<DMatrix<f64>, EngineError> {
        let width = self.noise.nrows();
        let cholesky = self.all_noise().cholesky().ok_or_else(|| not_finite("image features of the unmarked clips"))?;
        // With the content whitened (w = L⁻¹ r), the problem is the responses' own Gram matrix.
        let whitened =
            cholesky.l().solve_lower_triangular(&self.responses.transpose()).ok_or_else(|| not_finite("content"))?;
        let eigen = SymmetricEigen::new(whitened.tr_mul(&whitened));
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
        Ok(directions)
    }
}

fn not_finite(what: &str) -> EngineError {
    EngineError::NotFinite { what: what.to_owned(), got: f64::NAN }
}

/// Means of groups of rows, and what each row has beside its group's.
fn means_and_rests(all: &DMatrix<f64>, group: usize) -> (DMatrix<f64>, DMatrix<f64>) {
    let group = group.max(1);
    let means = DMatrix::from_fn(all.nrows() / group, all.ncols(), |i, j| all.view((i * group, j), (group, 1)).mean());
    let rests = DMatrix::from_fn(means.nrows() * group, all.ncols(), |i, j| all[(i, j)] - means[(i / group, j)]);
    (means, rests)
}
