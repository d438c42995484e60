//! What CLIP says of frames without a mark, foretold by what they show coarsely.
//!
//! Most of what moves CLIP's features from one frame to the next is what the frame shows, and a mark has to be read
//! above that. But what an asset shows is known: its unmarked training views are. A thumbnail of a frame is too coarse
//! for a mark to move it, and tells between which of these views the frame lies. What CLIP says of them, so mixed, is
//! taken off before a frame is decoded. No key and no message has a part in it.

use guard4d_kernels::image::resize::{ImageSize, ResizePlan};
use guard4d_kernels::shape::ClipShape;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};
use nalgebra::{DMatrix, DVector};

use crate::base::matrix::{row_major, rows, share_apart, single};
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;
use crate::picture::distortion::Resizer;

/// Side of thumbnails in pixels. Of 8 px they foretell a fifth less of what logits of stress4d vary by.
const THUMBNAIL_PX: usize = 16;
/// Floats of a thumbnail.
pub const THUMBNAIL_LEN: usize = THUMBNAIL_PX * THUMBNAIL_PX * 3;
/// Channels of frames on the device; the fourth is no colour.
const DEVICE_CHANNELS: usize = 4;
/// Views that are remembered, at most: those of 144 clips. The work of fitting grows with their cube.
pub const MOST_VIEWS: usize = 1152;
/// Views by which reach and ridge are chosen, at most: the best of few is nearly that of all.
const MOST_COMPARED: usize = 384;
/// How far a view reaches, as shares of the median squared distance between views, of which one is chosen.
const REACHES: [f64; 3] = [0.3, 1.0, 3.0];
/// Ridges on the kernel, of which one is chosen.
const RIDGES: [f64; 3] = [0.003, 0.03, 0.2];
const THUMBNAILS: &str = "content.thumbnails";
const WEIGHTS: &str = "content.weights";
const REACH: &str = "content.reach";
const RIDGE: &str = "content.ridge";

/// What unmarked views look like, and what CLIP says of them.
#[derive(Clone, Debug, PartialEq)]
pub struct ContentModel {
    /// `[M, T, T, 3]` in \[0, 1\].
    pub thumbnails: Vec<f32>,
    /// Share of each view in the features of a frame that looks like it `[M, D]`.
    pub weights: Vec<f32>,
    /// Squared distance of thumbnails at which a view has the e-th part of its share.
    pub reach: f32,
    /// What was added to the likeness of each view with itself, so that no view tells all.
    pub ridge: f32,
}

/// A model, and what it foretells of the views that it was fitted to.
#[derive(Debug)]
pub struct FittedContent {
    /// The model.
    pub model: ContentModel,
    /// What is foretold of each view by all others `[M, D]`: as it will be of views that nobody has seen.
    pub left_out: Vec<f32>,
}

impl ContentModel {
    /// Fits thumbnails `[M, T, T, 3]` to features `[M, D]` of unmarked frames; what is foretold is how far a frame's
    /// features are from their mean.
    ///
    /// # Equation
    /// f(x) = k(x, X) (K + ρ)⁻¹ Y with k(x, y) = exp(−|x − y|² / r): kernel ridge regression (Saunders, Gammerman
    /// and Vovk 1998). Left out, view i is told Yᵢ − ((K + ρ)⁻¹ Y)ᵢ / ((K + ρ)⁻¹)ᵢᵢ; r and ρ are those with
    /// the least sum of squares of what is left then.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] for values that are no numbers, and without a view.
    pub fn fit(thumbnails: &[f32], features: &[f32]) -> Result<FittedContent, EngineError> {
        if thumbnails.is_empty() || thumbnails.iter().chain(features).any(|v| !v.is_finite()) {
            let what = "unmarked frames to foretell content by".to_owned();
            return Err(EngineError::NotFinite { what, got: f64::NAN });
        }
        let views = thumbnails.len() / THUMBNAIL_LEN;
        let targets = centred(rows(features, features.len() / views));
        let apart = squared_distances(thumbnails);
        let (median, step) = (median(&apart), views.div_ceil(MOST_COMPARED));
        let few: Vec<usize> = (0..views).step_by(step).collect();
        let (few_apart, few_targets) = (apart.select_rows(&few).select_columns(&few), targets.select_rows(&few));
        let mut best = (f64::INFINITY, Ridge { reach: REACHES[0] * median, ridge: RIDGES[0] });
        for (reach, ridge) in REACHES.iter().flat_map(|reach| RIDGES.iter().map(move |ridge| (reach * median, *ridge)))
        {
            let ridge = Ridge { reach, ridge };
            let left = ridge.solve(&few_apart, &few_targets)?.left_over().norm_squared();
            if left < best.0 {
                best = (left, ridge);
            }
        }
        // As a file holds it, so that what a file says is the same to the bit.
        let (reach, ridge) = (single(best.1.reach), single(best.1.ridge));
        let best = Ridge { reach: f64::from(reach), ridge: f64::from(ridge) };
        let solved = best.solve(&apart, &targets)?;
        let unexplained = solved.left_over().norm_squared() / targets.norm_squared();
        tracing::debug!(unexplained, reach = best.reach / median, ridge = best.ridge, "content foretold");
        let model = Self { thumbnails: thumbnails.to_vec(), weights: row_major(&solved.weights), reach, ridge };
        Ok(FittedContent { left_out: best.left_out(&apart, &model.weights_of_views(), &solved.own), model })
    }

    /// What is foretold of each view that it was fitted to by all others `[M, D]`.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] for views that cannot be told apart.
    pub fn left_out(&self) -> Result<Vec<f32>, EngineError> {
        let ridge = Ridge { reach: f64::from(self.reach), ridge: f64::from(self.ridge) };
        let apart = squared_distances(&self.thumbnails);
        Ok(ridge.left_out(&apart, &self.weights_of_views(), &ridge.inverse(&apart)?.diagonal()))
    }

    fn weights_of_views(&self) -> DMatrix<f64> {
        rows(&self.weights, self.weights.len() / self.views())
    }

    /// The view that has this thumbnail, if one has.
    #[must_use]
    pub fn view_of(&self, thumbnail: &[f32]) -> Option<usize> {
        self.thumbnails.chunks_exact(THUMBNAIL_LEN).position(|known| known == thumbnail)
    }

    /// How many views it remembers.
    #[must_use]
    pub fn views(&self) -> usize {
        self.thumbnails.len() / THUMBNAIL_LEN
    }

    /// How far the features of frames with these thumbnails `[n, T, T, 3]` are from the mean of all `[n, D]`, were they
    /// unmarked; zeros for one that looks like no view.
    #[must_use]
    pub fn foretell(&self, thumbnails: &[f32]) -> Vec<f32> {
        thumbnails.chunks_exact(THUMBNAIL_LEN).flat_map(|thumbnail| self.foretell_one(thumbnail)).collect()
    }

    fn foretell_one(&self, thumbnail: &[f32]) -> Vec<f32> {
        let width = self.weights.len() / self.views();
        let mut told = vec![0.0; width];
        for (known, weights) in self.thumbnails.chunks_exact(THUMBNAIL_LEN).zip(self.weights.chunks_exact(width)) {
            let share = (-squared_distance(thumbnail, known) / f64::from(self.reach)).exp();
            told.iter_mut().zip(weights).for_each(|(told, weight)| *told += share * f64::from(*weight));
        }
        told.into_iter().map(single).collect()
    }

    /// Adds the tensors `content.thumbnails`, `content.weights`, `content.reach` and `content.ridge` to a file.
    pub fn store(&self, file: &mut TensorFile) {
        let views = self.views();
        let mut add = |name: &str, shape: &[usize], values: &[f32]| {
            file.tensors.insert(name.to_owned(), Tensor::f32(shape, values.to_vec()));
        };
        add(THUMBNAILS, &[views, THUMBNAIL_LEN], &self.thumbnails);
        add(WEIGHTS, &[views, self.weights.len() / views], &self.weights);
        add(REACH, &[1], &[self.reach]);
        add(RIDGE, &[1], &[self.ridge]);
    }

    /// Reads what [`ContentModel::store`] wrote of features of `width` numbers; none where nothing was stored.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the tensor.
    pub fn load(file: &TensorFile, width: usize) -> Result<Option<Self>, EngineError> {
        let Some(tensor) = file.tensors.get(WEIGHTS) else { return Ok(None) };
        let views = tensor.shape.first().copied().unwrap_or(0);
        if !(1..=MOST_VIEWS).contains(&views) {
            return Err(file.bad(WEIGHTS, &format!("{views} views"), &format!("1 to {MOST_VIEWS}")));
        }
        let positive = |name: &str| match file.finite(name, &[1])?[0] {
            number if number > 0.0 => Ok(number),
            other => Err(file.bad(name, &other.to_string(), "a positive number")),
        };
        let (reach, ridge) = (positive(REACH)?, positive(RIDGE)?);
        let thumbnails = file.finite(THUMBNAILS, &[views, THUMBNAIL_LEN])?.to_vec();
        Ok(Some(Self { thumbnails, weights: file.finite(WEIGHTS, &[views, width])?.to_vec(), reach, ridge }))
    }

    /// How far it is from `other`, as a share of its size; infinite for another number of views.
    #[must_use]
    pub fn share_apart(&self, other: &Self) -> f64 {
        let parts = [
            share_apart(&self.thumbnails, &other.thumbnails),
            share_apart(&self.weights, &other.weights),
            share_apart(&[self.reach], &[other.reach]),
            share_apart(&[self.ridge], &[other.ridge]),
        ];
        // A NaN stays one.
        parts.into_iter().fold(0.0, |most: f64, part| if part.is_nan() || part > most { part } else { most })
    }

    /// How many numbers it has.
    #[must_use]
    pub fn numbers(&self) -> usize {
        self.thumbnails.len() + self.weights.len() + 2
    }
}

/// How views are mixed.
#[derive(Clone, Copy)]
struct Ridge {
    reach: f64,
    ridge: f64,
}

impl Ridge {
    /// K + ρ.
    fn kernel(self, apart: &DMatrix<f64>) -> DMatrix<f64> {
        let views = apart.nrows();
        apart.map(|d| (-d / self.reach).exp()) + DMatrix::from_diagonal_element(views, views, self.ridge)
    }

    fn inverse(self, apart: &DMatrix<f64>) -> Result<DMatrix<f64>, EngineError> {
        let singular = || EngineError::NotFinite { what: "likeness of unmarked frames".to_owned(), got: f64::NAN };
        Ok(self.kernel(apart).cholesky().ok_or_else(singular)?.inverse())
    }

    fn solve(self, apart: &DMatrix<f64>, targets: &DMatrix<f64>) -> Result<Solved, EngineError> {
        let inverse = self.inverse(apart)?;
        Ok(Solved { weights: &inverse * targets, own: inverse.diagonal() })
    }

    /// What all other views foretell of each, with these weights and the diagonal of (K + ρ)⁻¹.
    fn left_out(self, apart: &DMatrix<f64>, weights: &DMatrix<f64>, own: &DVector<f64>) -> Vec<f32> {
        let targets = self.kernel(apart) * weights;
        row_major(&DMatrix::from_fn(weights.nrows(), weights.ncols(), |i, j| {
            targets[(i, j)] - weights[(i, j)] / own[i]
        }))
    }
}

/// (K + ρ)⁻¹ Y and the diagonal of (K + ρ)⁻¹.
struct Solved {
    weights: DMatrix<f64>,
    own: DVector<f64>,
}

impl Solved {
    /// What of each view is left of what all others foretell.
    fn left_over(&self) -> DMatrix<f64> {
        DMatrix::from_fn(self.weights.nrows(), self.weights.ncols(), |i, j| self.weights[(i, j)] / self.own[i])
    }
}

fn centred(values: DMatrix<f64>) -> DMatrix<f64> {
    let mean = values.row_mean();
    DMatrix::from_fn(values.nrows(), values.ncols(), |i, j| values[(i, j)] - mean[j])
}

fn squared_distances(thumbnails: &[f32]) -> DMatrix<f64> {
    let views: Vec<&[f32]> = thumbnails.chunks_exact(THUMBNAIL_LEN).collect();
    let mut apart = DMatrix::zeros(views.len(), views.len());
    for i in 0..views.len() {
        for j in 0..i {
            let distance = squared_distance(views[i], views[j]);
            (apart[(i, j)], apart[(j, i)]) = (distance, distance);
        }
    }
    apart
}

fn squared_distance(a: &[f32], b: &[f32]) -> f64 {
    f64::from(a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>())
}

fn median(values: &DMatrix<f64>) -> f64 {
    let mut values: Vec<f64> = values.iter().copied().collect();
    let middle = values.len() / 2;
    let median = *values.select_nth_unstable_by(middle, f64::total_cmp).1;
    // Where all views are alike, none is nearer than another.
    if median > 0.0 { median } else { 1.0 }
}

/// Takes what is foretold off the features of the same frames.
pub(crate) fn take_off(features: &mut [f32], told: &[f32]) {
    features.iter_mut().zip(told).for_each(|(feature, told)| *feature -= told);
}

/// Makes thumbnails of clips as CLIP sees them.
#[derive(Debug)]
pub(crate) struct Thumbnailer {
    resizer: Resizer,
    small: Buffer<f32>,
}

impl Thumbnailer {
    /// Of clips of shape `seen`.
    ///
    /// # Errors
    /// When memory runs out.
    pub(crate) fn new(device: &Device, seen: ClipShape) -> Result<Self, KernelError> {
        let from = ImageSize { height: seen.height, width: seen.width };
        let to = ImageSize { height: THUMBNAIL_PX, width: THUMBNAIL_PX };
        let small = seen.frames * THUMBNAIL_PX * THUMBNAIL_PX * DEVICE_CHANNELS;
        Ok(Self {
            resizer: Resizer::new(device, seen.frames, ResizePlan::new(device, from, to)?)?,
            small: device.buffer("content.thumbnails", small)?,
        })
    }

    /// Records it for one clip `[F,S,S,4]`.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub(crate) fn record(&mut self, rec: &mut Recorder, clip: &Buffer<f32>) -> Result<(), KernelError> {
        self.resizer.forward(rec, clip, &mut self.small)
    }

    /// The thumbnails of the clip that was recorded and submitted last `[F, T, T, 3]`.
    ///
    /// # Errors
    /// When the device fails.
    pub(crate) fn read(&self) -> Result<Vec<f32>, KernelError> {
        let colour = |texel: &[f32; DEVICE_CHANNELS]| [texel[0], texel[1], texel[2]];
        Ok(self.small.read()?.as_chunks().0.iter().flat_map(colour).collect())
    }
}
