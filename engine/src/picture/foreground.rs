//! What stands out from a plain background, found from a frame alone.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::fmt;

use serde::Serialize;

use crate::media::Frame;

/// Pixels along the border that tell what colour lies beyond it.
const BORDER_PX: usize = 2;
/// Distance from the border's colour, in levels of 8 bits, up to which a pixel is background and from which on it is
/// foreground. Codecs move a plain background by up to 4; in between a pixel counts in part, so that nothing jumps.
const LEVELS: [f64; 2] = [8.0, 32.0];
/// Cells along the longer side of a frame, in which things are told apart.
const CELLS: usize = 64;
/// Share of a cell's pixels that makes it part of a thing.
const OCCUPIED: f64 = 0.02;
/// Things smaller than this share of the largest are dropped: logos, specks, noise of a codec.
const SPECK: f64 = 0.05;
/// A second thing of this share of the largest leaves open which of them is the asset.
const RIVAL: f64 = 0.4;
/// Least share of the frame that stands out: 0.7 % of the side in each direction.
const LEAST_SHARE: f64 = 5e-5;
/// Most of the border that a thing covers, in spreads: half a disc has 3 to 4.
const MOST_CUT_SPREADS: f64 = 1.5;
/// Largest share of the border that stands out. At 0.07 the square was within 4 % of where it belongs (measured: robot
/// from 0.7 times the distance).
const MOST_CUT: f64 = 0.15;
/// Side of the corners that tell what a turned picture was put on.
const CORNER_PX: usize = 4;
/// Distance from the colour of the corners, in levels, up to which a pixel belongs to them: what codecs do to a plain
/// colour, with some room.
const SAME_LEVELS: u8 = 12;
/// Largest share of a frame that lies outside of a picture that was turned in it, with some room: 17 % at 45 degrees.
const MOST_OUTSIDE: f64 = 0.2;
/// Pixels between what lies outside and the picture, in which codecs and sampling mix both.
const BLENDED_PX: usize = 3;

/// A thing in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thing {
    /// Its centroid: pixels right of the frame's left edge, and below its upper edge.
    pub middle: [f64; 2],
    /// Root of the trace of its covariance, in pixels: 0.71 R for a disc of radius R.
    pub spread: f64,
    /// The border's median colour, from which it stands out.
    pub background: [u8; 3],
}

/// Why nothing is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NotFound {
    /// Nothing stands out from the border.
    Nothing,
    /// What stands out is cut by the frame's edge, or there is no plain background.
    Cut,
    /// Several things stand out, and any of them could be the asset.
    Several,
}

impl fmt::Display for NotFound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Nothing => "nothing stands out",
            Self::Cut => "the asset is cut by the edge, or has no plain background",
            Self::Several => "several things stand out",
        })
    }
}

/// Median of each channel along the border: what continues there is more likely its commonest colour than a mean of
/// thing and background.
#[must_use]
pub fn border_colour(frame: &Frame) -> [u8; 3] {
    let along: Vec<&[u8]> =
        frame.rgb().chunks_exact(3).zip(on_border(frame)).filter_map(|(p, on)| on.then_some(p)).collect();
    median(&along).expect("a frame has a border")
}

fn on_border(frame: &Frame) -> impl Iterator<Item = bool> {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let is_near = |at: usize, side: usize| at < BORDER_PX || side - at <= BORDER_PX;
    (0..width * height).map(move |i| is_near(i % width, width) || is_near(i / width, height))
}

/// The frame without what a picture was put on that was turned in it: where all four corners have one colour, which is
/// not that of the border between them, what of this colour hangs together with a corner gets the border's.
///
/// ```
/// # use guard4d_engine::media::Frame;
/// # use guard4d_engine::picture::foreground::without_corners;
/// let plain = Frame::new(8, 8, vec![200; 8 * 8 * 3]).expect("a frame");
/// assert_eq!(*without_corners(&plain), plain);
/// ```
#[must_use]
pub fn without_corners(frame: &Frame) -> Cow<'_, Frame> {
    let Some(outside) = outside(frame) else { return Cow::Borrowed(frame) };
    let border = frame.rgb().chunks_exact(3).zip(on_border(frame)).zip(&outside);
    let seen: Vec<&[u8]> = border.filter_map(|((pixel, on), out)| (on && !out).then_some(pixel)).collect();
    let (Some(ground), corner) = (median(&seen), &frame.rgb()[..3]) else { return Cow::Borrowed(frame) };
    if largest_difference(&ground, corner) <= SAME_LEVELS {
        return Cow::Borrowed(frame);
    }
    let mut rgb = frame.rgb().to_vec();
    rgb.chunks_exact_mut(3)
        .zip(&outside)
        .filter(|(_, out)| **out)
        .for_each(|(pixel, _)| pixel.copy_from_slice(&ground));
    Frame::new(frame.width(), frame.height(), rgb).map_or(Cow::Borrowed(frame), Cow::Owned)
}

/// Pixels that hang together with a corner and have its colour, and those next to them; none if the corners differ, or
/// if it is most of the frame, as where the corners are background.
fn outside(frame: &Frame) -> Option<Vec<bool>> {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let pixel = |at: usize| &frame.rgb()[3 * at..3 * at + 3];
    let corners = [0, width - 1, (height - 1) * width, height * width - 1];
    let colour = median(&corners.map(pixel))?;
    let in_corner = |at: &usize| {
        let near = |at: usize, side: usize| at < CORNER_PX || side - at <= CORNER_PX;
        near(at % width, width) && near(at / width, height)
    };
    if !(0..width * height).filter(in_corner).all(|at| largest_difference(&colour, pixel(at)) <= SAME_LEVELS) {
        return None;
    }
    let mut outside = vec![false; width * height];
    let (mut waiting, mut beside, mut count) = (VecDeque::from(corners), Vec::new(), 0.0);
    while let Some(at) = waiting.pop_front() {
        if outside[at] {
            continue;
        }
        if largest_difference(&colour, pixel(at)) > SAME_LEVELS {
            beside.push(at);
            continue;
        }
        outside[at] = true;
        count += 1.0;
        if count > MOST_OUTSIDE * (width * height) as f64 {
            return None;
        }
        let (column, row) = (at % width, at / width);
        waiting.extend((column > 0).then(|| at - 1));
        waiting.extend((column + 1 < width).then_some(at + 1));
        waiting.extend((row > 0).then(|| at - width));
        waiting.extend((row + 1 < height).then_some(at + width));
    }
    let reach = |at: usize, side: usize| at.saturating_sub(BLENDED_PX)..(at + BLENDED_PX + 1).min(side);
    for at in beside {
        for row in reach(at / width, height) {
            reach(at % width, width).for_each(|column| outside[row * width + column] = true);
        }
    }
    Some(outside)
}

fn largest_difference(a: &[u8], b: &[u8]) -> u8 {
    a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}

/// Of each channel by itself; none of no pixel.
fn median(pixels: &[&[u8]]) -> Option<[u8; 3]> {
    (!pixels.is_empty()).then(|| {
        std::array::from_fn(|channel| {
            let mut levels: Vec<u8> = pixels.iter().map(|rgb| rgb[channel]).collect();
            let middle = levels.len() / 2;
            *levels.select_nth_unstable(middle).1
        })
    })
}

/// Finds the thing that a frame shows.
///
/// A pixel stands out by how far it is from the border's median colour, in the channel that differs most. What stands
/// out is taken apart into pieces that touch; specks are dropped, and the rest is the thing.
///
/// # Errors
/// Why there is none.
pub fn find(frame: &Frame) -> Result<Thing, NotFound> {
    let grid = Grid::of(frame);
    if grid.cut > MOST_CUT {
        return Err(NotFound::Cut);
    }
    let mut pieces = grid.pieces();
    pieces.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let largest = pieces.first().copied().ok_or(NotFound::Nothing)?;
    if largest.weight < LEAST_SHARE * f64::from(frame.width()) * f64::from(frame.height()) {
        return Err(NotFound::Nothing);
    }
    if pieces.get(1).is_some_and(|second| second.weight >= RIVAL * largest.weight) {
        return Err(NotFound::Several);
    }
    let kept = pieces.into_iter().filter(|piece| piece.weight >= SPECK * largest.weight);
    let Moments { weight, x, y, square } = kept.fold(Moments::default(), Moments::with);
    let middle = [x / weight, y / weight];
    let spread = (square / weight - middle[0] * middle[0] - middle[1] * middle[1]).max(0.0).sqrt();
    if grid.cut_px > MOST_CUT_SPREADS * spread {
        return Err(NotFound::Cut);
    }
    // A single pixel has no spread, but a side.
    Ok(Thing { middle, spread: spread.max(0.5), background: grid.background })
}

/// Weights of pixels, summed with their places.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    weight: f64,
    x: f64,
    y: f64,
    /// Of the squared distance from the corner.
    square: f64,
}

impl Moments {
    fn with(self, more: Self) -> Self {
        Self {
            weight: self.weight + more.weight,
            x: self.x + more.x,
            y: self.y + more.y,
            square: self.square + more.square,
        }
    }
}

/// A frame in cells.
struct Grid {
    columns: usize,
    rows: usize,
    cells: Vec<Moments>,
    /// The border's median colour.
    background: [u8; 3],
    /// Pixels of a whole cell.
    area: f64,
    /// Mean weight of the border's pixels.
    cut: f64,
    /// Length of the border that stands out.
    cut_px: f64,
}

impl Grid {
    fn of(frame: &Frame) -> Self {
        let (width, height) = (frame.width() as usize, frame.height() as usize);
        let cell = width.max(height).div_ceil(CELLS);
        let (columns, rows) = (width.div_ceil(cell), height.div_ceil(cell));
        let background = border_colour(frame);
        let mut cells = vec![Moments::default(); columns * rows];
        let (mut border, mut border_px) = (0.0, 0.0);
        for ((i, pixel), on_border) in frame.rgb().chunks_exact(3).enumerate().zip(on_border(frame)) {
            let distance = largest_difference(pixel, &background);
            let weight = ((f64::from(distance) - LEVELS[0]) / (LEVELS[1] - LEVELS[0])).clamp(0.0, 1.0);
            if on_border {
                border += weight;
                border_px += 1.0;
            }
            if weight > 0.0 {
                let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
                let at = &mut cells[i / width / cell * columns + i % width / cell];
                *at = at.with(Moments { weight, x: weight * x, y: weight * y, square: weight * (x * x + y * y) });
            }
        }
        Self {
            columns,
            rows,
            cells,
            background,
            area: (cell * cell) as f64,
            cut: border / border_px,
            cut_px: border / BORDER_PX as f64,
        }
    }

    /// Sums over what touches, corner to corner at least.
    fn pieces(&self) -> Vec<Moments> {
        let mut is_open: Vec<bool> = self.cells.iter().map(|cell| cell.weight >= OCCUPIED * self.area).collect();
        let mut pieces = Vec::new();
        let mut waiting = VecDeque::new();
        for start in 0..is_open.len() {
            if !std::mem::take(&mut is_open[start]) {
                continue;
            }
            let mut piece = Moments::default();
            waiting.push_back(start);
            while let Some(at) = waiting.pop_front() {
                piece = piece.with(self.cells[at]);
                for near in self.around(at) {
                    if std::mem::take(&mut is_open[near]) {
                        waiting.push_back(near);
                    }
                }
            }
            pieces.push(piece);
        }
        pieces
    }

    /// A cell and those around it.
    fn around(&self, at: usize) -> impl Iterator<Item = usize> {
        let (column, row) = (at % self.columns, at / self.columns);
        let (columns, last_row) = (self.columns, (row + 1).min(self.rows - 1));
        let across = column.saturating_sub(1)..=(column + 1).min(columns - 1);
        (row.saturating_sub(1)..=last_row).flat_map(move |row| across.clone().map(move |column| row * columns + column))
    }
}
