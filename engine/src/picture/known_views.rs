//! Framing films as training framed the asset, from the frames alone.
//!
//! From farther away, through another lens or aimed off the asset, a film shows CLIP the same asset in another size and
//! place, and the mark is lost to it though every pixel holds it. So an extractor remembers what the unmarked asset
//! looks like from the views it was fitted to: a thumbnail of each, and where in it the trained frame lies. A frame of
//! a film is compared with these, and cut as the nearest of them say. Nothing here knows a message: a frame is cut in
//! one way, and no p-value needs a correction.

use std::collections::BTreeMap;

use guard4d_kernels::image::resize::{ImageSize, Region};
use serde::Serialize;

use super::foreground::{NotFound, Thing, find};
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
const NEAREST: usize = 4;
/// How far a frame's own window may be from the median of the frames around it, in widths or as a logarithm: beyond, it
/// is of another shot.
const SAME_SHOT: f64 = 0.15;
/// Frames before and after one that are averaged with it: two seconds of most films.
const AROUND: usize = 48;
/// A window that is as near to the whole frame as this is taken for it, in sides and as a logarithm. Most films are
/// framed as training was, and nothing is to be lost there by measuring where the asset is; a mark bears to be off by
/// 8 % of a side in place and 12 % in size.
const USUAL: [f64; 2] = [0.06, 0.12];

/// What an asset looks like from the views that training took.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KnownViews {
    /// `[M, T, T, 3]`, as differences from the border's colour in \[-1, 1\].
    pub thumbnails: Vec<f32>,
    /// `[M, 4]`, see [`PLACEMENT_LEN`].
    pub placements: Vec<f32>,
}

/// A window in pixels from the upper left corner of a frame; it may reach beyond it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Its middle: right of the frame's left edge, and below its upper edge.
    pub middle: [f64; 2],
    /// Its width and height.
    pub sides: [f64; 2],
}

impl Window {
    /// The region of a frame that it covers.
    #[must_use]
    pub fn region(self) -> Region {
        let Self { middle: [x, y], sides: [width, height] } = self;
        Region { x: x - width / 2.0, y: y - height / 2.0, width, height }
    }

    /// Whether two windows are as near as `[places, sizes]`.
    fn is_near(self, other: Self, [places, sizes]: [f64; 2]) -> bool {
        (0..2).all(|i| {
            let off = (self.middle[i] - other.middle[i]).abs() <= places * other.sides[i];
            off && (self.sides[i] / other.sides[i]).ln().abs() <= sizes
        })
    }
}

/// The part of a frame that CLIP is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part {
    /// A window.
    Window(Window),
    /// All of it: it is framed as training was, or nothing else was asked for.
    All,
    /// All of it, since nothing was found to cut out.
    Fallback(NotFound),
}

impl Part {
    /// The region of a frame of this size.
    #[must_use]
    pub fn region(self, size: ImageSize) -> Region {
        match self {
            Self::Window(window) => window.region(),
            Self::All | Self::Fallback(_) => Region::whole(size),
        }
    }

    fn window(self) -> Option<Window> {
        if let Self::Window(window) = self { Some(window) } else { None }
    }
}

/// How the frames of a film were cut.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Framings {
    /// Frames that were cut to a window.
    pub cut: u32,
    /// Frames that are framed as training was.
    pub usual: u32,
    /// Frames in which the asset was not found, and which were shown whole, by the reason.
    pub not_found: BTreeMap<NotFound, u32>,
}

impl Framings {
    /// Counts the frames of a film.
    #[must_use]
    pub fn of(parts: &[Part]) -> Self {
        let mut all = Self::default();
        for part in parts {
            match *part {
                Part::Window(_) => all.cut += 1,
                Part::Fallback(why) => *all.not_found.entry(why).or_default() += 1,
                Part::All => all.usual += 1,
            }
        }
        all
    }
}

impl KnownViews {
    /// Adds the view of a frame that shows the asset as training does; whether the asset stands out in it.
    pub fn add(&mut self, frame: &Frame) -> bool {
        let Ok(thing) = find(frame) else { return false };
        self.thumbnails.extend(thumbnail(frame, thing));
        let sides = [frame.width(), frame.height()].map(f64::from);
        let place = |i: usize| (sides[i] / 2.0 - thing.middle[i]) / thing.spread;
        let size = |i: usize| (sides[i] / thing.spread).ln();
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
        settle(&frames.iter().map(|frame| self.part(frame)).collect::<Vec<_>>(), size)
    }

    /// The part of one frame by itself; [`settle`] makes use of those around it.
    #[must_use]
    pub fn part(&self, frame: &Frame) -> Part {
        let thing = match find(frame) {
            Ok(thing) => thing,
            Err(why) => return Part::Fallback(why),
        };
        let seen = thumbnail(frame, thing);
        let far = |known: &[f32]| seen.iter().zip(known).map(|(a, b)| f64::from((a - b) * (a - b))).sum::<f64>();
        let mut nearest: Vec<(f64, usize)> =
            self.thumbnails.chunks_exact(THUMBNAIL_LEN).enumerate().map(|(view, known)| (far(known), view)).collect();
        nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
        nearest.truncate(NEAREST);
        let Some(&(least, _)) = nearest.first() else { return Part::Fallback(NotFound::Nothing) };
        let (mut sum, mut place) = (0.0, [0.0; PLACEMENT_LEN]);
        for (distance, view) in nearest {
            // The nearest counts most; one twice as far, in squares, for e^-½ of it.
            let weight = (-0.5 * (distance - least) / least.max(f64::MIN_POSITIVE)).exp();
            sum += weight;
            let known = &self.placements[view * PLACEMENT_LEN..][..PLACEMENT_LEN];
            place.iter_mut().zip(known).for_each(|(p, k)| *p += weight * f64::from(*k));
        }
        let [x, y, width, height] = place.map(|p| p / sum);
        let middle = [thing.middle[0] + x * thing.spread, thing.middle[1] + y * thing.spread];
        Part::Window(Window { middle, sides: [width, height].map(|log| thing.spread * log.exp()) })
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

/// What the frames of a film, all of this size, are cut to: the mean of what those around each say, but for those that
/// are of another shot. What one frame says is off by a few hundredths of a side, as the asset is never quite as it was
/// in a known view; the errors of a film even out.
#[must_use]
pub fn settle(alone: &[Part], size: ImageSize) -> Vec<Part> {
    let [width, height] = [size.width, size.height].map(|n| n as f64);
    let whole = Window { middle: [width / 2.0, height / 2.0], sides: [width, height] };
    let settled = |(at, part): (usize, &Part)| {
        let Some(own) = part.window() else { return *part };
        let near = alone[at.saturating_sub(AROUND)..(at + AROUND + 1).min(alone.len())].iter();
        let near: Vec<Window> = near.filter_map(|part| part.window()).collect();
        let median = middle_of(&near);
        // A frame that is unlike those around it speaks for itself and for those that are like it.
        let centre = if own.is_near(median, [SAME_SHOT; 2]) { median } else { own };
        let window = mean_of(near.into_iter().filter(|window| window.is_near(centre, [SAME_SHOT; 2])));
        let window = window.unwrap_or(own);
        if window.is_near(whole, USUAL) { Part::All } else { Part::Window(window) }
    };
    alone.iter().enumerate().map(settled).collect()
}

/// Median of each number by itself.
fn middle_of(windows: &[Window]) -> Window {
    let median = |of: &dyn Fn(&Window) -> f64| {
        let mut values: Vec<f64> = windows.iter().map(of).collect();
        let at = values.len() / 2;
        *values.select_nth_unstable_by(at, f64::total_cmp).1
    };
    Window {
        middle: [median(&|w| w.middle[0]), median(&|w| w.middle[1])],
        sides: [median(&|w| w.sides[0]), median(&|w| w.sides[1])],
    }
}

fn mean_of(windows: impl Iterator<Item = Window>) -> Option<Window> {
    let mut mean = Window { middle: [0.0; 2], sides: [0.0; 2] };
    let mut count = 0.0;
    for Window { middle, sides } in windows {
        count += 1.0;
        for i in 0..2 {
            mean.middle[i] += (middle[i] - mean.middle[i]) / count;
            mean.sides[i] += (sides[i] - mean.sides[i]) / count;
        }
    }
    (count > 0.0).then_some(mean)
}

/// A thing and what is around it `[T, T, 3]`: mean differences from the border's colour in \[-1, 1\], 0 outside of the
/// frame.
fn thumbnail(frame: &Frame, thing: Thing) -> Vec<f32> {
    let Thing { middle, spread, background } = thing;
    let side = SPREADS * spread;
    let corner = middle.map(|m| m - side / 2.0);
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let mut sums = vec![0.0; THUMBNAIL_LEN];
    let mut counts = vec![0.0; THUMBNAIL_PX * THUMBNAIL_PX];
    let difference = |x: usize, y: usize, channel: usize| {
        let level = frame.rgb()[(y * width + x) * 3 + channel];
        (f64::from(level) - f64::from(background[channel])) / 255.0
    };
    let inside = |corner: f64, n: usize| pixels(corner, corner + side, n);
    for y in inside(corner[1], height) {
        for x in inside(corner[0], width) {
            let cell = |at: usize, corner: f64| index((at as f64 + 0.5 - corner) / side * THUMBNAIL_PX as f64);
            let cell = cell(y, corner[1]) * THUMBNAIL_PX + cell(x, corner[0]);
            counts[cell] += 1.0;
            (0..3).for_each(|channel| sums[cell * 3 + channel] += difference(x, y, channel));
        }
    }
    for (cell, count) in counts.iter().enumerate() {
        if *count > 0.0 {
            sums[cell * 3..][..3].iter_mut().for_each(|sum| *sum /= count);
            continue;
        }
        // A cell of less than a pixel shows the one that it lies in, if there is one.
        let place = |at: usize, corner: f64| corner + (at as f64 + 0.5) * side / THUMBNAIL_PX as f64;
        let (x, y) = (place(cell % THUMBNAIL_PX, corner[0]), place(cell / THUMBNAIL_PX, corner[1]));
        if (0.0..width as f64).contains(&x) && (0.0..height as f64).contains(&y) {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside of the frame")]
            let (x, y) = (x as usize, y as usize);
            (0..3).for_each(|channel| sums[cell * 3 + channel] = difference(x, y, channel));
        }
    }
    sums.into_iter().map(single).collect()
}

/// Pixels whose middle lies between two places along a side of `n`.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the side")]
fn pixels(from: f64, to: f64, n: usize) -> std::ops::Range<usize> {
    let at = |place: f64| (place - 0.5).ceil().clamp(0.0, n as f64) as usize;
    at(from)..at(to)
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a cell of a thumbnail")]
fn index(cell: f64) -> usize {
    (cell as usize).min(THUMBNAIL_PX - 1)
}
