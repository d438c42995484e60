//! What a film is made of: shots between cuts, and pictures that come twice.

use std::ops::Range;

use super::gray::{Gray, correlation};

/// Width at which neighbours are compared, px.
const COMPARED_PX: usize = 64;
/// Likeness of neighbours under which there may be a cut, and of what is usual beside it.
const CUT: f64 = 0.35;
const CUT_OF_USUAL: f64 = 0.5;
/// Neighbours on each side that say what is usual.
const BESIDE: usize = 4;
/// Largest difference between two pictures that are one, of 1: less than a level and a half, as coding leaves of a
/// picture that is repeated.
const SAME: f32 = 1.4 / 255.0;

/// The shots of a film, in order; none of them is empty.
#[must_use]
pub fn shots<'a>(frames: impl Iterator<Item = &'a Gray>) -> Vec<Range<usize>> {
    let small: Vec<Gray> = frames.map(small).collect();
    let alike: Vec<f64> = small.windows(2).map(|pair| correlation(&pair[0], &pair[1])).collect();
    let mut shots = Vec::new();
    let mut start = 0;
    for (at, likeness) in alike.iter().enumerate() {
        let (from, to) = (at.saturating_sub(BESIDE), (at + 1 + BESIDE).min(alike.len()));
        let mut beside: Vec<f64> = alike[from..at].iter().chain(&alike[at + 1..to]).copied().collect();
        beside.sort_by(f64::total_cmp);
        let usual = beside.get(beside.len() / 2).copied().unwrap_or(1.0);
        if *likeness < CUT && *likeness < CUT_OF_USUAL * usual {
            shots.push(start..at + 1);
            start = at + 1;
        }
    }
    if start < small.len() {
        shots.push(start..small.len());
    }
    shots
}

/// Whether two pictures of one size show the same: a frame that was repeated.
#[must_use]
pub fn is_same(a: &Gray, b: &Gray) -> bool {
    a.values.iter().zip(&b.values).all(|(a, b)| (a - b).abs() <= SAME)
}

/// Those of `len` frames that follow one, and those before it, each from it on.
pub(super) fn both_ways(from: usize, len: usize) -> [Vec<usize>; 2] {
    [(from + 1..len).collect(), (0..from).rev().collect()]
}

fn small(frame: &Gray) -> Gray {
    let width = COMPARED_PX.min(frame.width);
    let height = (frame.height * width / frame.width).max(1);
    frame.resized(width, height)
}
