//! How a leaked asset was moved as a whole: the similarity that carries the original onto it.
//!
//! Most leaks are not moved, so that is tried first. Then splats are found again by their looks, and three of them at a
//! time tell a transform; and where looks were changed, the shape of both is laid upon each other, whose axes can be
//! taken for each other in 24 ways. Whatever is proposed is judged by the share of splats that it brings to one of the
//! original's.

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;

use super::cloud::{Cloud, below, position, shuffled};
use super::looks::{Alike, Looks, Units};
use super::similarity::{Pair, Similarity};
use crate::scene::Gaussians;

/// Distance to a splat of the original, in terms of how far apart those stand, below which a position is that splat's.
/// By chance 3 % of all are so near in space and 15 % on a surface: 4·0.2³ and 4·0.2².
pub(super) const NEAR: f64 = 0.2;
/// Share of near splats that leaves no doubt: three times what chance brings on a surface.
const CONVINCING: f64 = 0.5;
/// Splats that a proposal is judged by: a share is right to 0.03.
const JUDGES: usize = 300;
/// Splats that the last steps look at: enough that their mean is a sixtieth of a single one's error.
const REFINERS: usize = 4000;
/// Rounds of the last steps; they end after two or three where the start was good.
const REFINEMENTS: usize = 12;

/// Splats that a proposal has to persuade first, and the share of them: fewer than one in ten does so by chance, and
/// hardly any fails that brings half of all splats near.
const FIRST_JUDGES: usize = 20;
const PERSUADED: f64 = 0.3;

/// Splats that are looked for by their looks.
const LOOKED_FOR: usize = 4000;
/// Threes of them that are tried at most, of which one is right where a hundredth of all splats was found again.
const THREES: u64 = 1_000_000;
/// Threes that are tried in one go; where a fifth of all splats was found again, that is all.
const THREES_AT_ONCE: usize = 2000;
/// How far the ratios of three sides may be apart: positions are rounded to a thousandth of such a side or less.
const SAME_RATIO: f64 = 0.01;
/// Shortest side of three splats in terms of the asset's radius: short ones tell no direction.
const SHORTEST: f64 = 0.3;

/// Percent of splats that are the shape: the others may be far away, or somebody else's.
const SHAPE: usize = 80;
/// Rounds in which the middle of these is found.
const CENTRINGS: usize = 8;
/// Steps that a proposal by shape gets before it is judged: it starts off by some spacings.
const STEPS: usize = 15;
/// Percent of the splats that such a step follows: the others may be somebody else's.
const FOLLOWED: usize = 70;

/// A transform and the share of splats that it brings near to one of the original's.
#[derive(Clone, Copy, Debug)]
struct Proposal {
    similarity: Similarity,
    share: f64,
}

impl Proposal {
    /// The better one; the first where both are as good.
    fn or(self, other: Self) -> Self {
        if other.share > self.share { other } else { self }
    }
}

/// Whether three splats are as far apart as they were, up to one factor; `shortest` is what their sides have to have.
fn is_rigid(three: &[Pair; 3], shortest: f64) -> bool {
    let ratios = [[0, 1], [1, 2], [2, 0]].map(|[a, b]| {
        let [a, b]: [Pair; 2] = [three[a], three[b]];
        let from = a.from.distance(b.from);
        if from >= shortest { a.to.distance(b.to) / from } else { 0.0 }
    });
    let [low, high] = [f64::min, f64::max].map(|extreme| ratios.into_iter().fold(ratios[0], extreme));
    low > 0.0 && high <= (1.0 + SAME_RATIO) * low
}

/// Both assets while they are laid upon each other.
pub(super) struct Search<'a> {
    original: &'a Gaussians,
    cloud: &'a Cloud,
    leaked: &'a Gaussians,
    means: Vec<DVec3>,
    /// Splats of the leaked asset that lie somewhere, in no order.
    rows: Vec<usize>,
}

impl<'a> Search<'a> {
    /// `cloud` holds the positions of `original`.
    pub(super) fn new(original: &'a Gaussians, cloud: &'a Cloud, leaked: &'a Gaussians) -> Self {
        let means: Vec<DVec3> = leaked.means.iter().map(|mean| position(*mean)).collect();
        let rows = shuffled(means.len()).into_iter().filter(|row| means[*row].is_finite()).collect();
        Self { original, cloud, leaked, means, rows }
    }

    /// Whether the leaked asset lies nowhere.
    pub(super) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Where the splats of the leaked asset are.
    pub(super) fn means(&self) -> &[DVec3] {
        &self.means
    }

    /// The first `count` of the splats that are looked at.
    fn some(&self, count: usize) -> &[usize] {
        &self.rows[..count.min(self.rows.len())]
    }

    /// The best transform that was found.
    pub(super) fn run(&self) -> Similarity {
        let mut best = self.judged(Similarity::IDENTITY, JUDGES);
        // In units of each asset's own, which edits of the whole leave as they are; and in those of the original, which
        // splats of somebody else leave.
        let own = Units::of(self.original);
        for [here, there] in [[Units::of(self.leaked), own], [own.without_size(); 2]] {
            if best.share < CONVINCING {
                let here = Looks::new(self.leaked, &here);
                best = self.by_looks(best, &here.alike(&Looks::new(self.original, &there), self.some(LOOKED_FOR)));
            }
        }
        if best.share < CONVINCING {
            best = self.by_shape(best);
        }
        self.refined(best)
    }

    fn judged(&self, similarity: Similarity, judges: usize) -> Proposal {
        let judges = self.some(judges);
        let near = self.pairs(&similarity, judges).into_iter().filter(|(_, away)| *away <= NEAR).count();
        Proposal { similarity, share: near as f64 / judges.len().max(1) as f64 }
    }

    /// Each of these splats with the original's that is nearest under a transform, and how far that is in spacings.
    fn pairs(&self, similarity: &Similarity, rows: &[usize]) -> Vec<(Pair, f64)> {
        let back = similarity.inverse();
        let nearest = |row: &usize| {
            let to = self.means[*row];
            let found = *self.cloud.nearest(back.apply(to), 1).first()?;
            let spacing = self.cloud.spacing(found.row).max(f64::MIN_POSITIVE);
            Some((Pair { from: self.cloud.means()[found.row], to }, found.distance / spacing))
        };
        rows.iter().filter_map(nearest).collect()
    }

    /// A proposal after some steps by the splats that it brings near (Besl and McKay, PAMI 14, 1992).
    fn refined(&self, start: Proposal) -> Similarity {
        let rows = self.some(REFINERS);
        let mut similarity = start.similarity;
        for _ in 0..REFINEMENTS {
            let near = self.pairs(&similarity, rows).into_iter().filter(|(_, away)| *away <= NEAR);
            let near: Vec<Pair> = near.map(|(pair, _)| pair).collect();
            match Similarity::through(&near) {
                Some(next) if next != similarity => similarity = next,
                _ => break,
            }
        }
        if self.judged(similarity, JUDGES).share >= start.share { similarity } else { start.similarity }
    }

    /// The better of `best` and the best of those that three splats tell, found again by their looks.
    fn by_looks(&self, best: Proposal, alike: &[Alike]) -> Proposal {
        let pair = |alike: &Alike| Pair { from: self.cloud.means()[alike.there], to: self.means[alike.here] };
        let pairs: Vec<Pair> = alike.iter().map(pair).filter(|pair| pair.from.is_finite()).collect();
        let Some(shape) = Shape::of(self.cloud.means()) else { return best };
        if pairs.is_empty() {
            return best;
        }
        for tried in (0..THREES).step_by(THREES_AT_ONCE) {
            let told = (tried..tried + THREES_AT_ONCE as u64).into_par_iter().filter_map(|number| {
                // A stream for each, so that it does not matter who draws first.
                let mut rng = ChaCha8Rng::seed_from_u64(number);
                let three = std::array::from_fn(|_| pairs[below(&mut rng, pairs.len())]);
                let similarity = is_rigid(&three, SHORTEST * shape.radius).then(|| Similarity::through(&three))??;
                let is_worth_it = self.judged(similarity, FIRST_JUDGES).share >= PERSUADED;
                is_worth_it.then(|| self.judged(similarity, JUDGES))
            });
            let found = told.collect::<Vec<_>>().into_iter().reduce(Proposal::or);
            // By all judges, no wrong one comes so far: seven deviations from what chance brings on a surface.
            if let Some(found) = found.filter(|found| found.share >= PERSUADED) {
                return best.or(found);
            }
        }
        best
    }

    /// The better of `best` and the best of those that lay the axes of both shapes upon each other.
    fn by_shape(&self, best: Proposal) -> Proposal {
        let [Some(original), Some(leaked)] = [self.cloud.means(), self.means.as_slice()].map(Shape::of) else {
            return best;
        };
        let turns: Vec<DMat3> = axis_turns().collect();
        let followed = |turn| self.judged(self.followed(original.onto(&leaked, turn)), JUDGES);
        turns.into_par_iter().map(followed).collect::<Vec<_>>().into_iter().fold(best, Proposal::or)
    }

    /// A transform after [`STEPS`] by whatever is nearest, however far.
    fn followed(&self, mut similarity: Similarity) -> Similarity {
        for _ in 0..STEPS {
            let mut pairs = self.pairs(&similarity, self.some(JUDGES));
            pairs.sort_by(|a, b| a.1.total_cmp(&b.1));
            pairs.truncate((pairs.len() * FOLLOWED).div_ceil(100));
            let pairs: Vec<Pair> = pairs.into_iter().map(|(pair, _)| pair).collect();
            similarity = Similarity::through(&pairs).unwrap_or(similarity);
        }
        similarity
    }
}

/// Where most splats are and how they are spread.
struct Shape {
    centre: DVec3,
    /// Median distance from the centre.
    radius: f64,
    /// Right-handed, the longest first.
    axes: DMat3,
}

impl Shape {
    /// `None` where there is none, as of a single splat. The same for an asset however it is turned.
    fn of(means: &[DVec3]) -> Option<Self> {
        let mut kept: Vec<DVec3> = means.iter().copied().filter(|mean| mean.is_finite()).collect();
        let last = kept.len().checked_sub(1)?;
        let mut centre = kept.iter().sum::<DVec3>() / kept.len() as f64;
        for _ in 0..CENTRINGS {
            let distance = |mean: &DVec3| mean.distance_squared(centre);
            kept.select_nth_unstable_by(last * SHAPE / 100, |a, b| distance(a).total_cmp(&distance(b)));
            let inner = &kept[..=last * SHAPE / 100];
            centre = inner.iter().sum::<DVec3>() / inner.len() as f64;
        }
        let mut covariance = Matrix3::zeros();
        for mean in &kept[..=last * SHAPE / 100] {
            let arm = Vector3::from((*mean - centre).to_array());
            covariance += arm * arm.transpose();
        }
        let mut distances: Vec<f64> = kept.iter().map(|mean| mean.distance(centre)).collect();
        let radius = *distances.select_nth_unstable_by(last / 2, f64::total_cmp).1;
        if !(radius > 0.0 && covariance.iter().all(|value| value.is_finite())) {
            return None;
        }
        let eigen = SymmetricEigen::new(covariance);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let [x, y, _] = order.map(|axis| DVec3::from_slice(eigen.eigenvectors.column(axis).as_slice()));
        Some(Self { centre, radius, axes: DMat3::from_cols(x, y, x.cross(y)) })
    }

    /// The transform that carries this shape onto `other`, with its axes turned by `turn` before.
    fn onto(&self, other: &Self, turn: DMat3) -> Similarity {
        let scale = other.radius / self.radius;
        let rotation = DQuat::from_mat3(&(other.axes * turn * self.axes.transpose())).normalize();
        Similarity { scale, rotation, translation: other.centre - scale * (rotation * self.centre) }
    }
}

/// The 24 turns that carry axes to axes.
fn axis_turns() -> impl Iterator<Item = DMat3> {
    let signed = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
    signed.clone().flat_map(move |x| {
        signed.clone().filter(move |y| x.dot(*y) == 0.0).map(move |y| DMat3::from_cols(x, y, x.cross(y)))
    })
}
