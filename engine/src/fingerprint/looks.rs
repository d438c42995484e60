//! What splats look like, whatever turns, scales or shifts an asset, so that a splat is found again by its looks alone.

use kdtree::KdTree;
use kdtree::distance::squared_euclidean;
use rayon::prelude::*;

use super::cloud::{Neighbour, shuffled};
use crate::scene::Gaussians;
use crate::scene::gaussians::{CHANNELS, SH_FLOATS};

/// Numbers that tell a splat's looks: the base colour, the opacity, the size, and how long it is to how wide and flat.
const NUMBERS: usize = 7;
/// Which of them is the size.
const SIZE: usize = 4;
/// Spreads from the middle that a number counts as at most: one of them should not outweigh all others.
const FARTHEST: f64 = 4.0;
/// Percent of all splats that lie below and above the spread, as one deviation of a normal distribution has them.
const SPREAD: usize = 16;

/// Two splats that look alike.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alike {
    pub(super) here: usize,
    pub(super) there: usize,
}

/// What numbers of looks are told in: where the middle of all splats is, and how far they spread from it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Units([Unit; NUMBERS]);

#[derive(Clone, Copy, Debug)]
struct Unit {
    middle: f64,
    /// 0 where a number tells nothing, because it is the same almost everywhere.
    per_spread: f64,
}

impl Units {
    /// Those of an asset. In its own units it looks the same after an exposure and contrast of all colours, a factor of
    /// all sizes and one of all opacities' logits.
    pub(super) fn of(gaussians: &Gaussians) -> Self {
        let raw: Vec<[f64; NUMBERS]> = (0..gaussians.len()).map(|row| raw(gaussians, row)).collect();
        Self(std::array::from_fn(|number| {
            let mut values: Vec<f64> = raw.iter().map(|l| l[number]).filter(|value| value.is_finite()).collect();
            values.sort_by(f64::total_cmp);
            let at = |percent: usize| values.get(values.len().saturating_sub(1) * percent / 100).copied();
            let [low, middle, high] = [SPREAD, 50, 100 - SPREAD].map(|percent| at(percent).unwrap_or_default());
            Unit { middle, per_spread: if high > low { 2.0 / (high - low) } else { 0.0 } }
        }))
    }

    /// The same in which sizes tell nothing: in units of another asset they depend on its scale.
    pub(super) fn without_size(mut self) -> Self {
        self.0[SIZE].per_spread = 0.0;
        self
    }
}

/// The looks of an asset's splats.
pub(super) struct Looks(Vec<[f64; NUMBERS]>);

impl Looks {
    pub(super) fn new(gaussians: &Gaussians, units: &Units) -> Self {
        let look = |row| {
            let raw = raw(gaussians, row);
            std::array::from_fn(|number| {
                let Unit { middle, per_spread } = units.0[number];
                let standard = (raw[number] - middle) * per_spread;
                if standard.is_nan() { 0.0 } else { standard.clamp(-FARTHEST, FARTHEST) }
            })
        };
        Self((0..gaussians.len()).map(look).collect())
    }

    fn tree(&self) -> KdTree<f64, usize, &[f64; NUMBERS]> {
        let mut tree = KdTree::new(NUMBERS);
        for row in shuffled(self.0.len()) {
            tree.add(&self.0[row], row).expect("as many numbers, all finite");
        }
        tree
    }

    /// Splats that look most like each other: of those of `rows` here and of all of `other`. Neither may have none.
    pub(super) fn alike(&self, other: &Self, rows: &[usize]) -> Vec<Alike> {
        let [own, others] = [self, other].map(Self::tree);
        let both = |row: &usize| {
            let there = nearest(&others, &self.0[*row]);
            let back = nearest(&own, &other.0[there.row]);
            // As near as any: a splat may be there twice.
            (there.distance <= back.distance).then_some(Alike { here: *row, there: there.row })
        };
        rows.par_iter().filter_map(both).collect()
    }
}

fn nearest(tree: &KdTree<f64, usize, &[f64; NUMBERS]>, look: &[f64; NUMBERS]) -> Neighbour {
    let found = tree.nearest(look, 1, &squared_euclidean).expect("as many numbers, all finite");
    let (distance, row) = found[0];
    Neighbour { row: *row, distance }
}

fn raw(gaussians: &Gaussians, row: usize) -> [f64; NUMBERS] {
    let dc: [f32; CHANNELS] = std::array::from_fn(|channel| gaussians.sh_coeffs[SH_FLOATS * row + channel]);
    let mut scales = gaussians.scales[row];
    scales.sort_by(f32::total_cmp);
    let [small, middle, large] = scales;
    [dc[0], dc[1], dc[2], gaussians.opacities[row], middle, large - middle, middle - small].map(f64::from)
}
