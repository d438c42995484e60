//! Smoothing the gradient of the offsets over splats that are near each other, which biases the mark towards low spatial
//! frequencies: neighbours are pushed alike, and what compression takes first is not there to lose.

use std::cmp::Ordering;
use std::ops::Range;
use std::time::Instant;

use guard4d_kernels::optim::neighbour_mean::{self, Neighbourhood};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::Embedding;
use super::config::EmbedConfig;
use crate::error::EngineError;
use crate::render::OffsetBases;

/// Splats that each one is smoothed over.
const NEIGHBOURS: usize = 8;

/// Neighbours of all splats, and room for what their gradient becomes.
pub(super) struct Smoothing {
    /// `[N, K]`, each row in ascending order.
    neighbours: Buffer<u32>,
    /// Share of the neighbours' mean.
    share: f32,
    bases: OffsetBases,
    smoothed: Buffer<f32>,
    /// What finding the neighbours took.
    pub(super) search_seconds: f64,
}

impl Smoothing {
    /// Finds the neighbours. `None` where nothing is smoothed, or there is no splat beside one.
    pub(super) fn new(device: &Device, means: &[[f32; 3]], config: &EmbedConfig) -> Result<Option<Self>, EngineError> {
        if config.smooth == 0.0 || means.len() < 2 {
            return Ok(None);
        }
        let started = Instant::now();
        let neighbours = nearest(means);
        let search_seconds = started.elapsed().as_secs_f64();
        tracing::debug!(splats = means.len(), seconds = search_seconds, "neighbours found");
        Ok(Some(Self {
            neighbours: device.buffer_from("smoothing.neighbours", &neighbours)?,
            share: config.smooth,
            bases: config.bases,
            smoothed: room(device, means.len(), config.bases)?,
            search_seconds,
        }))
    }

    /// The gradient of the offsets mixed with the mean of its neighbours'.
    pub(super) fn smooth(&mut self, rec: &mut Recorder, v_offsets: &Buffer<f32>) -> Result<&Buffer<f32>, KernelError> {
        let Self { neighbours, share, bases, smoothed, .. } = self;
        let near = Neighbourhood { neighbours, row: bases.floats(), share: *share };
        neighbour_mean::mix(rec, v_offsets, &near, smoothed)?;
        Ok(smoothed)
    }
}

/// Room for the smoothed gradient.
fn room(device: &Device, splats: usize, bases: OffsetBases) -> Result<Buffer<f32>, KernelError> {
    device.buffer("smoothing.smoothed", splats * bases.floats())
}

impl Embedding<'_> {
    /// Gives the smoothed gradient the rows of the offsets, which a rung of the ladder may just have widened.
    pub(super) fn keep_up_smoothing(&mut self) -> Result<(), EngineError> {
        let (device, stage) = (self.subject.device, &mut self.stage);
        if let Some(smoothing) = stage.smoothing.as_mut().filter(|smoothing| smoothing.bases != stage.bases) {
            let wider = || Ok(room(device, stage.num_splats, stage.bases)?);
            smoothing.smoothed = self.clips.with_room_beside_one(wider)?;
            smoothing.bases = stage.bases;
        }
        Ok(())
    }
}

/// Splats at one position: a range of the order by position.
struct Place {
    position: [f32; 3],
    splats: Range<usize>,
}

/// The nearest splats of each by Euclidean distance, without itself, in ascending order: `[N, K]` with K of 8, or N − 1 where
/// that is less. Of several that are equally far the tree says which come first, the same for the same means.
///
/// However many splats share a position, each finds its neighbours without looking at all of them: those at its own
/// position come first, and the tree holds each position once.
fn nearest(means: &[[f32; 3]]) -> Vec<u32> {
    let k = NEIGHBOURS.min(means.len().saturating_sub(1));
    // The order also has queries near each other follow each other.
    let mut order: Vec<u32> = (0..).take(means.len()).collect();
    order.sort_by(|a, b| compare(&means[*a as usize], &means[*b as usize]));
    let mut places = Vec::new();
    for alike in order.chunk_by(|a, b| compare(&means[*a as usize], &means[*b as usize]) == Ordering::Equal) {
        let first = places.last().map_or(0, |place: &Place| place.splats.end);
        places.push(Place { position: means[alike[0] as usize], splats: first..first + alike.len() });
    }
    let tree = RTree::bulk_load((0..).zip(&places).map(|(i, p)| GeomWithData::new(p.position, i)).collect());
    let row = |place: usize, member: usize| {
        let own = &order[places[place].splats.clone()];
        let after = (member + 1..member + own.len()).map(|at| own[at % own.len()]);
        let others = tree.nearest_neighbor_iter(places[place].position).filter(|other| other.data != place);
        let elsewhere = others.flat_map(|other: &GeomWithData<_, usize>| &order[places[other.data].splats.clone()]);
        let mut row: Vec<u32> = after.chain(elsewhere.copied()).take(k).collect();
        row.sort_unstable();
        row
    };
    let of_place = |place: usize| (0..places[place].splats.len()).map(move |member| (place, member));
    let found: Vec<u32> =
        (0..places.len()).into_par_iter().flat_map_iter(of_place).flat_map_iter(|(p, m)| row(p, m)).collect();
    let mut neighbours = vec![0; found.len()];
    for (splat, row) in order.iter().zip(found.chunks_exact(k.max(1))) {
        let at = *splat as usize * k;
        neighbours[at..at + k].copy_from_slice(row);
    }
    neighbours
}

/// By x, then y, then z, where both zeros are one.
fn compare(a: &[f32; 3], b: &[f32; 3]) -> Ordering {
    let pairs = a.iter().zip(b).map(|(a, b)| (a + 0.0).total_cmp(&(b + 0.0)));
    pairs.fold(Ordering::Equal, Ordering::then)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers in [0, 1) from a linear congruential generator (Knuth's MMIX).
    fn points(n: usize) -> Vec<[f32; 3]> {
        let mut state = 7u64;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / 16_777_216.0
        };
        (0..n).map(|_| [draw(), draw(), draw()]).collect()
    }

    fn distance(a: &[f32; 3], b: &[f32; 3]) -> f32 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
    }

    /// Checks rows against all distances.
    fn check(means: &[[f32; 3]]) {
        let k = NEIGHBOURS.min(means.len() - 1);
        let found = nearest(means);
        assert_eq!(found.len(), means.len() * k, "K for each of {}", means.len());
        for (i, row) in found.chunks_exact(k).enumerate() {
            assert!(row.is_sorted_by(|a, b| a < b), "splat {i}: ascending, none twice: {row:?}");
            assert!(row.iter().all(|j| *j as usize != i && (*j as usize) < means.len()), "splat {i}: others: {row:?}");
            let mut all: Vec<f32> =
                (0..means.len()).filter(|j| *j != i).map(|j| distance(&means[i], &means[j])).collect();
            all.sort_by(f32::total_cmp);
            let mut got: Vec<f32> = row.iter().map(|j| distance(&means[i], &means[*j as usize])).collect();
            got.sort_by(f32::total_cmp);
            assert_eq!(got, all[..k], "splat {i} of {}: the nearest", means.len());
        }
    }

    #[test]
    fn the_nearest_are_found_however_few_there_are() {
        for n in [2, 3, 8, 9, 10, 257] {
            check(&points(n));
        }
        assert!(nearest(&[]).is_empty() && nearest(&[[1.0, 2.0, 3.0]]).is_empty(), "nobody is beside one");
    }

    #[test]
    fn splats_at_one_position_are_neighbours_first() {
        let mut means = points(40);
        // Few at one position, more than K at another, and a zero of either sign.
        (1..5).for_each(|i| means[i] = means[0]);
        (11..31).for_each(|i| means[i] = means[10]);
        (means[31], means[32]) = ([0.0, 0.5, -0.0], [-0.0, 0.5, 0.0]);
        check(&means);
        let plane: Vec<_> = (0..100u8).map(|i| [f32::from(i % 10), f32::from(i / 10), 0.0]).collect();
        check(&plane);
        check(&[[0.25, -1.0, 3.0]; 30]);
    }

    #[test]
    fn very_many_at_one_position_take_no_longer() {
        // All distances between them would be ten thousand million.
        let found = nearest(&[[1.0; 3]; 100_000]);
        assert_eq!(found.len(), 800_000);
        assert!(found.chunks_exact(8).enumerate().all(|(i, row)| row.iter().all(|j| *j as usize != i)), "others");
    }
}
