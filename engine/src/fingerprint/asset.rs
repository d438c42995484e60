//! What a leaked asset says of each splat of the original: where it is found again, and how far its base colour is from
//! what the original's became.
//!
//! Splats are found again by where they are, after the transform of the whole is undone, and colours are compared
//! after the exposure and contrast that fit each channel best. No key takes part, so that whatever is found here is as
//! good as given to whoever computes a score from it.

use rayon::prelude::*;

use super::align::{NEAR, Search};
use super::cloud::Cloud;
use super::exposure::Exposure;
use super::seen::{Seen, SplatEvidence};
use super::similarity::{Pair, Similarity};
use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, SH_FLOATS, Y0};
use crate::scene::{Gaussians, Model};

/// Largest difference of a channel that counts, of 1. Marks of the usual strength are smaller. Tried on three captures
/// and the built-in scene: half of it costs a fifth of the score where colours are noisy by as much, twice of it a
/// quarter where splats were merged.
const LIMIT: f64 = 0.1;
/// Distance in spacings within which a splat can be the original's. Of what decimation makes of two, which is neither,
/// three in four are farther away; positions that a format rounds are nearer, but where splats lie in heaps.
const REACH: f64 = 0.3;
/// Share of rows that have to be near the original's same rows for the order to be the original's: a tenth may have
/// been moved by hand or by rounding.
const IN_ORDER: f64 = 0.9;
/// Splats of the original that a leaked one is compared with: as many as are within its spacing.
const CHOICE: usize = 4;
/// Deviations that a colour is off at most where splats are told apart: one that was painted over is told by its place.
const PAINTED: f64 = 3.0;
/// Typical errors of position by which several leaked splats may be at unequal distances and still be one's copies.
const SAME_PLACE: f64 = 2.0;

/// What a leaked asset says.
#[derive(Clone, Debug, PartialEq)]
pub struct AssetEvidence {
    /// Of each splat of the original: the limited difference of its colour, the mean of its channels, and 1; zeros for
    /// a splat that was not found.
    pub splats: SplatEvidence,
    /// Splats of the original that were found again.
    pub matched: usize,
    /// What carries the original's positions to the leaked ones.
    pub similarity: Similarity,
}

impl Seen for AssetEvidence {
    fn evidence(&self) -> &SplatEvidence {
        &self.splats
    }

    /// One for each splat: whatever edits do, they do to splats.
    fn together(&self) -> f64 {
        1.0
    }

    /// # Equation
    /// The colours themselves, where a splat was found.
    fn normal(&mut self, colours: &[f64]) -> Result<Vec<f64>, EngineError> {
        Ok(colours.iter().zip(&self.splats.response).map(|(colour, found)| colour * found).collect())
    }
}

/// A splat of the leaked asset and the one of the original that it is taken for.
#[derive(Clone, Copy, Debug)]
struct Claim {
    leaked: usize,
    original: usize,
    /// Between both, where the original is.
    distance: f64,
}

/// What both assets have to be compared.
struct Assets<'a> {
    cloud: &'a Cloud,
    search: Search<'a>,
    original_colours: Vec<[f64; CHANNELS]>,
    leaked_colours: Vec<[f64; CHANNELS]>,
}

/// Gathers what `leaked` says of `original`, the unmarked asset, by their canonical positions and base colours. That
/// little of it is found again is no error: whoever asks decides what that means.
///
/// # Shapes
/// out `splats` \[N\] of the original
///
/// # Errors
/// [`EngineError::Usage`] if either has no splat that lies somewhere.
///
/// # Determinism
/// The same for the same assets, however many threads there are.
pub fn gather_asset(original: &Model, leaked: &Model) -> Result<AssetEvidence, EngineError> {
    let (original, leaked) = (&original.gaussians, &leaked.gaussians);
    let cloud = Cloud::new(&original.means);
    let search = Search::new(original, &cloud, leaked);
    for (what, is_nowhere) in [("original", cloud.is_empty()), ("leaked asset", search.is_empty())] {
        if is_nowhere {
            return Err(EngineError::Usage {
                what: what.to_owned(),
                got: "no splat at a finite position".to_owned(),
                expected: "at least one".to_owned(),
            });
        }
    }
    let assets = Assets { cloud: &cloud, search, original_colours: colours(original), leaked_colours: colours(leaked) };
    let in_order = assets.in_order();
    let similarity = in_order.unwrap_or_else(|| assets.search.run());
    let claims = if in_order.is_some() { assets.rows(&similarity) } else { assets.nearest(&similarity) };
    let splats = assets.evidence(&claims);
    let matched = splats.response.iter().filter(|response| **response > 0.0).count();
    Ok(AssetEvidence { splats, matched, similarity })
}

/// Base colours, as seen from everywhere.
fn colours(gaussians: &Gaussians) -> Vec<[f64; CHANNELS]> {
    let rows = gaussians.sh_coeffs.chunks_exact(SH_FLOATS);
    rows.map(|row| std::array::from_fn(|channel| 0.5 + Y0 * f64::from(row[channel]))).collect()
}

impl Assets<'_> {
    /// The transform by which each row is near the same row of the original, if nearly all are.
    fn in_order(&self) -> Option<Similarity> {
        let (from, to) = (self.cloud.means(), self.search.means());
        if from.len() != to.len() {
            return None;
        }
        let pairs = from.iter().zip(to).map(|(from, to)| Pair { from: *from, to: *to });
        let mut pairs: Vec<Pair> = pairs.filter(|pair| pair.from.is_finite() && pair.to.is_finite()).collect();
        let first = Similarity::through(&pairs)?;
        // Once more without those that are farthest off.
        let off = |pair: &Pair| first.apply(pair.from).distance_squared(pair.to);
        pairs.sort_by(|a, b| off(a).total_cmp(&off(b)));
        pairs.truncate(pairs.len().div_ceil(2));
        let found = Similarity::through(&pairs)?;
        let rows = self.rows(&found);
        let near = rows.iter().filter(|claim| claim.distance <= NEAR * self.cloud.spacing(claim.original)).count();
        (near as f64 >= IN_ORDER * from.len() as f64).then_some(found)
    }

    /// Whether a claim is about two colours, and near enough.
    fn holds(&self, claim: &Claim) -> bool {
        let both = [self.original_colours[claim.original], self.leaked_colours[claim.leaked]];
        let reach = REACH * self.cloud.spacing(claim.original);
        both.as_flattened().iter().all(|colour| colour.is_finite()) && claim.distance <= reach
    }

    /// Each row as the original's same row.
    fn rows(&self, similarity: &Similarity) -> Vec<Claim> {
        let back = similarity.inverse();
        let claim = |row: usize| {
            let distance = back.apply(self.search.means()[row]).distance(self.cloud.means()[row]);
            Claim { leaked: row, original: row, distance }
        };
        let claims = (0..self.search.means().len()).map(claim);
        claims.filter(|claim| self.holds(claim)).collect()
    }

    /// Each splat as the one of the original that is nearest, in place and then in colour too: where positions are
    /// rounded, more than one may be meant.
    fn nearest(&self, similarity: &Similarity) -> Vec<Claim> {
        let back = similarity.inverse();
        let claims = |choice: usize, better: &(dyn Fn(&Claim) -> f64 + Sync)| -> Vec<Claim> {
            let best = |leaked: usize, mean| {
                let found = self.cloud.nearest(back.apply(mean), choice).into_iter();
                let claims = found.map(|near| Claim { leaked, original: near.row, distance: near.distance });
                claims.filter(|claim| self.holds(claim)).min_by(|a, b| better(a).total_cmp(&better(b)))
            };
            let means = self.search.means();
            means.par_iter().enumerate().filter_map(|(leaked, mean)| best(leaked, *mean)).collect()
        };
        let first = claims(1, &|claim| claim.distance);
        let (error, exposure) = (typical_distance(&first), self.exposure(&first));
        let mut second = claims(CHOICE, &|claim| {
            let off = exposure.deviations(self.original_colours[claim.original], self.leaked_colours[claim.leaked]);
            let painted = off.into_iter().map(|off| off.abs().min(PAINTED).powi(2)).sum::<f64>();
            (claim.distance / error).powi(2) + painted
        });
        let mut least = vec![f64::INFINITY; self.original_colours.len()];
        for claim in &second {
            least[claim.original] = least[claim.original].min(claim.distance);
        }
        second.retain(|claim| claim.distance <= least[claim.original] + SAME_PLACE * error);
        second
    }

    /// What became of colours on the whole.
    fn exposure(&self, claims: &[Claim]) -> Exposure {
        let colours = |claim: &Claim| [self.original_colours[claim.original], self.leaked_colours[claim.leaked]];
        Exposure::of(&claims.iter().map(colours).collect::<Vec<_>>())
    }

    fn evidence(&self, claims: &[Claim]) -> SplatEvidence {
        let exposure = self.exposure(claims);
        let count = self.original_colours.len();
        let (mut sums, mut claimed) = (vec![[0.0; CHANNELS]; count], vec![0.0; count]);
        for claim in claims {
            claimed[claim.original] += 1.0;
            for (sum, colour) in sums[claim.original].iter_mut().zip(self.leaked_colours[claim.leaked]) {
                *sum += colour;
            }
        }
        let mut splats = SplatEvidence::none(count);
        for row in (0..count).filter(|row| claimed[*row] > 0.0) {
            let became = exposure.apply(self.original_colours[row]);
            let off = sums[row].iter().zip(became).map(|(sum, became)| sum / claimed[row] - became);
            let difference = off.map(|off| off.clamp(-LIMIT, LIMIT)).sum::<f64>() / CHANNELS as f64;
            splats.residual[row] = difference;
            splats.response[row] = 1.0;
            splats.samples += 1;
            splats.squares += difference * difference;
        }
        splats
    }
}

/// Half of all claims are nearer; more than 0, so that it can be a unit.
fn typical_distance(claims: &[Claim]) -> f64 {
    let mut distances: Vec<f64> = claims.iter().map(|claim| claim.distance).collect();
    let middle = distances.len() / 2;
    let typical = if distances.is_empty() { 0.0 } else { *distances.select_nth_unstable_by(middle, f64::total_cmp).1 };
    typical.max(f64::MIN_POSITIVE)
}
