//! What stands out from a plain background, found from a frame alone.

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
    std::array::from_fn(|channel| {
        let mut levels: Vec<u8> = along.iter().map(|rgb| rgb[channel]).collect();
        let middle = levels.len() / 2;
        *levels.select_nth_unstable(middle).1
    })
}

fn on_border(frame: &Frame) -> impl Iterator<Item = bool> {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let is_near = |at: usize, side: usize| at < BORDER_PX || side - at <= BORDER_PX;
    (0..width * height).map(move |i| is_near(i % width, width) || is_near(i / width, height))
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
            let distance = pixel.iter().zip(background).map(|(level, b)| level.abs_diff(b)).max().unwrap_or(0);
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
