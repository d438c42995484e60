//! Framing films as training framed the asset, from the frames alone.
//!
//! From farther away, through another lens or aimed off the asset, a film shows CLIP the same asset in another size and
//! place, and the mark is lost to it though every pixel holds it. So an extractor remembers what the unmarked asset
//! looks like from the views it was fitted to: a thumbnail of each, and where in it the trained frame lies. A frame of
//! a film is compared with these, and cut as the nearest of them say. Nothing here knows a message: a frame is cut in
//! one way, and no p-value needs a correction.

use guard4d_kernels::image::resize::ImageSize;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::foreground::{NotFound, Thing, find, without_corners};
use super::part::{Fit, Look, Part, TURNS_DEG, Window, turned};
use super::settle::settle;
use crate::base::matrix::{share_apart, single};
use crate::media::Frame;

/// Side of thumbnails in pixels.
pub const THUMBNAIL_PX: usize = 12;
/// Floats of a thumbnail.
pub const THUMBNAIL_LEN: usize = THUMBNAIL_PX * THUMBNAIL_PX * 3;
/// Floats of a placement: the middle of the trained frame right of and below that of the thing, in spreads of the
/// thing, and the logarithms of its width and height in spreads.
pub const PLACEMENT_LEN: usize = 4;
/// Side of what a thumbnail shows, in spreads of the thing. Figures reach up to 0.8 of it.
const SPREADS: f64 = 4.5;
/// Views that a frame is compared with, at most: more take more room and tell no more.
pub const MOST_VIEWS: usize = 256;
/// Nearest views that say how a frame is cut.
const NEAREST: usize = 16;
/// Share of the mean squared distance that keeps the shares of these views small.
const RIDGE: f64 = 0.05;
/// Samples of a frame along a side of a cell of a thumbnail.
const SAMPLES: usize = 8;

/// What an asset looks like from the views that training took.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KnownViews {
    /// `[M, T, T, 3]`, as differences from the border's colour in \[-1, 1\].
    pub thumbnails: Vec<f32>,
    /// `[M, 4]`, see [`PLACEMENT_LEN`].
    pub placements: Vec<f32>,
}

impl KnownViews {
    /// Adds the view of a frame that shows the asset as training does, but this many times as much of it in both
    /// directions; whether the asset stands out in it.
    pub fn add(&mut self, frame: &Frame, times: f64) -> bool {
        let Ok(thing) = find(frame) else { return false };
        self.thumbnails.extend(thumbnail(frame, thing, 0.0));
        let sides = [frame.width(), frame.height()].map(f64::from);
        let place = |i: usize| (sides[i] / 2.0 - thing.middle[i]) / thing.spread;
        let size = |i: usize| (sides[i] / times / thing.spread).ln();
        self.placements.extend([place(0), place(1), size(0), size(1)].map(single));
        true
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.placements.len() / PLACEMENT_LEN
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.placements.is_empty()
    }

    /// The parts of the frames of one film, all of one size.
    #[must_use]
    pub fn parts(&self, frames: &[Frame]) -> Vec<Part> {
        let Some(first) = frames.first() else { return Vec::new() };
        let size = ImageSize { height: first.height() as usize, width: first.width() as usize };
        settle(&frames.par_iter().map(|frame| self.look(frame)).collect::<Vec<_>>(), size)
    }

    /// What one frame by itself says; [`settle`] makes use of those around it.
    #[must_use]
    pub fn look(&self, frame: &Frame) -> Look {
        let frame = &*without_corners(frame);
        match find(frame) {
            Ok(_) if self.is_empty() => Look::Nothing(NotFound::Nothing),
            Ok(thing) => Look::Fits(TURNS_DEG.iter().map(|turn_deg| self.fit(frame, thing, *turn_deg)).collect()),
            Err(why) => Look::Nothing(why),
        }
    }

    /// The window of a frame that is turned like this, as the nearest views say.
    fn fit(&self, frame: &Frame, thing: Thing, turn_deg: f64) -> Fit {
        let seen = thumbnail(frame, thing, turn_deg);
        let far = |known: &[f32]| seen.iter().zip(known).map(|(a, b)| f64::from((a - b) * (a - b))).sum::<f64>();
        let mut nearest: Vec<(f64, usize)> =
            self.thumbnails.chunks_exact(THUMBNAIL_LEN).enumerate().map(|(view, known)| (far(known), view)).collect();
        nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
        nearest.truncate(NEAREST);
        let apart = DMatrix::from_fn(nearest.len(), THUMBNAIL_LEN, |i, j| {
            f64::from(seen[j]) - f64::from(self.thumbnails[nearest[i].1 * THUMBNAIL_LEN + j])
        });
        let gram = &apart * apart.transpose();
        let weights = weights(&gram);
        let mut place = [0.0; PLACEMENT_LEN];
        for ((_, view), weight) in nearest.iter().zip(&weights) {
            let known = &self.placements[view * PLACEMENT_LEN..][..PLACEMENT_LEN];
            place.iter_mut().zip(known).for_each(|(p, k)| *p += weight * f64::from(*k));
        }
        let [x, y, width, height] = place;
        let off = turned([x * thing.spread, y * thing.spread], turn_deg);
        let middle = [thing.middle[0] + off[0], thing.middle[1] + off[1]];
        let window = Window { middle, sides: [width, height].map(|log| thing.spread * log.exp()), turn_deg };
        Fit { distance: weights.dot(&(gram * &weights)), window }
    }

    /// How far these are from `other`, as a share of their size; infinite for another number of them.
    #[must_use]
    pub fn share_apart(&self, other: &Self) -> f64 {
        let thumbnails = share_apart(&self.thumbnails, &other.thumbnails);
        let placements = share_apart(&self.placements, &other.placements);
        // A NaN stays one.
        if thumbnails >= placements { thumbnails } else { placements + 0.0 * thumbnails }
    }
}

/// Shares of the views in a frame between them: those with which they add up to what is nearest to it, where `gram`
/// holds the products of their differences from it (locally linear embedding: Roweis and Saul, Science 290, 2000).
fn weights(gram: &DMatrix<f64>) -> DVector<f64> {
    let views = gram.nrows();
    let even = DVector::from_element(views, 1.0);
    let held = gram + DMatrix::identity(views, views) * (RIDGE * gram.trace() / views as f64);
    let weights = held.cholesky().map_or_else(|| even.clone(), |cholesky| cholesky.solve(&even));
    &weights / weights.sum()
}

/// A thing and what is around it `[T, T, 3]`, turned upright from so many degrees counterclockwise: mean differences
/// from the border's colour in \[-1, 1\], 0 outside of the frame.
fn thumbnail(frame: &Frame, thing: Thing, turn_deg: f64) -> Vec<f32> {
    let Thing { middle, spread, background } = thing;
    let across = THUMBNAIL_PX * SAMPLES;
    let place = |i: usize| ((i as f64 + 0.5) / across as f64 - 0.5) * SPREADS * spread;
    let mut sums = vec![0.0; THUMBNAIL_LEN];
    let mut counts = vec![0.0; THUMBNAIL_PX * THUMBNAIL_PX];
    for (row, column) in (0..across).flat_map(|row| (0..across).map(move |column| (row, column))) {
        let off = turned([place(column), place(row)], turn_deg);
        let Some(pixel) = pixel_at(frame, [middle[0] + off[0], middle[1] + off[1]]) else { continue };
        let cell = row / SAMPLES * THUMBNAIL_PX + column / SAMPLES;
        counts[cell] += 1.0;
        for (channel, sum) in sums[cell * 3..][..3].iter_mut().enumerate() {
            *sum += (f64::from(pixel[channel]) - f64::from(background[channel])) / 255.0;
        }
    }
    for (sums, count) in sums.chunks_exact_mut(3).zip(&counts) {
        sums.iter_mut().for_each(|sum| *sum /= f64::max(*count, 1.0));
    }
    sums.into_iter().map(single).collect()
}

/// The pixel that a place lies in, if any.
fn pixel_at(frame: &Frame, [x, y]: [f64; 2]) -> Option<&[u8]> {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    if !(0.0..width as f64).contains(&x) || !(0.0..height as f64).contains(&y) {
        return None;
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside of the frame")]
    let at = y as usize * width + x as usize;
    frame.rgb().get(at * 3..at * 3 + 3)
}
