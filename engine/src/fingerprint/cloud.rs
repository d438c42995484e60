//! The splats of an asset by where they are: which are nearest, and how far apart they stand.

use std::collections::HashMap;

use glam::DVec3;
use kdtree::KdTree;
use kdtree::distance::squared_euclidean;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;

/// Splats at one position that can be found: more say nothing that one could tell apart, and would make a search long.
const AT_ONE_PLACE: usize = 4;
/// The neighbour that tells how far apart splats stand: one more than can be at a splat's own position.
const SPACING_RANK: usize = AT_ONE_PLACE;

/// A splat and how far it is away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Neighbour {
    pub(super) row: usize,
    pub(super) distance: f64,
}

/// Positions in a tree.
pub(super) struct Cloud {
    means: Vec<DVec3>,
    tree: KdTree<f64, usize, [f64; 3]>,
    /// Distance to the neighbour of [`SPACING_RANK`]; 0 where there is none.
    spacings: Vec<f64>,
}

impl Cloud {
    /// Of these positions; those that are not finite are found by nobody.
    pub(super) fn new(means: &[[f32; 3]]) -> Self {
        let means: Vec<DVec3> = means.iter().map(|mean| position(*mean)).collect();
        let mut tree = KdTree::new(3);
        let mut at_place: HashMap<[u64; 3], usize> = HashMap::new();
        for row in shuffled(means.len()) {
            // Zero of either sign is one number.
            let count = at_place.entry((means[row] + 0.0).to_array().map(f64::to_bits)).or_default();
            *count += 1;
            if *count <= AT_ONE_PLACE && means[row].is_finite() {
                tree.add(means[row].to_array(), row).expect("three finite numbers");
            }
        }
        let mut cloud = Self { means, tree, spacings: Vec::new() };
        let spacing = |mean: &DVec3| cloud.nearest(*mean, SPACING_RANK + 1).last().map_or(0.0, |last| last.distance);
        cloud.spacings = cloud.means.par_iter().map(spacing).collect();
        cloud
    }

    /// Whether there is nothing to find.
    pub(super) fn is_empty(&self) -> bool {
        self.tree.size() == 0
    }

    /// Where each splat is.
    pub(super) fn means(&self) -> &[DVec3] {
        &self.means
    }

    /// How far apart splats stand around that of row `row`.
    pub(super) fn spacing(&self, row: usize) -> f64 {
        self.spacings[row]
    }

    /// The `count` splats nearest to `point`, nearest first; none for a point that is nowhere.
    pub(super) fn nearest(&self, point: DVec3, count: usize) -> Vec<Neighbour> {
        let found = self.tree.nearest(&point.to_array(), count, &squared_euclidean).unwrap_or_default();
        found.into_iter().map(|(squared, row)| Neighbour { row: *row, distance: squared.sqrt() }).collect()
    }
}

/// A position in double precision.
pub(super) fn position(mean: [f32; 3]) -> DVec3 {
    glam::Vec3::from_array(mean).as_dvec3()
}

/// The numbers below `count` in an order that has nothing to do with that of splats, which often stands for where they
/// are: a tree that is filled in such an order would be a list.
pub(super) fn shuffled(count: usize) -> Vec<usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut rows: Vec<usize> = (0..count).collect();
    for row in (1..count).rev() {
        rows.swap(row, below(&mut rng, row + 1));
    }
    rows
}

/// A number below `count`, for what is no secret: that some are likelier by a part in 2^40 is no matter.
pub(super) fn below(rng: &mut ChaCha8Rng, count: usize) -> usize {
    usize::try_from(rng.next_u64() % count as u64).expect("below a number that is one")
}
