//! What part of a video's frames is the picture: known parts, bars, and stretching.

use std::str::FromStr;

use image::RgbImage;
use image::imageops::{FilterType, resize};
use serde::Serialize;

use super::frames::{Frame, MAX_SIDE_PX};
use crate::error::EngineError;

/// A part of a frame, in pixels from its upper left corner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Rect {
    /// Columns left of it.
    pub x: u32,
    /// Rows above it.
    pub y: u32,
    /// Columns, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
}

/// What to keep of every frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Crop {
    /// All of it.
    #[default]
    Whole,
    /// What lies between bars, if [`BarFinder`] finds any. It looks at pictures alone, never at a key: one clip is read
    /// in one way, so that a p-value needs no correction for a search.
    Auto,
    /// This part. Whoever tries several parts has to multiply the p-value by their number.
    Region(Rect),
}

/// `auto`, or `X,Y,W,H` in pixels.
impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let numbers: Option<Vec<u32>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[x, y, width, height]) if width > 0 && height > 0 => Ok(Self::Region(Rect { x, y, width, height })),
            _ => Err("auto or X,Y,W,H in pixels, W and H at least 1, is expected".to_owned()),
        }
    }
}

/// What is made of every frame before anyone sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Framing {
    /// What is kept.
    pub crop: Crop,
    /// Width and height in pixels that this is resampled to; none leaves it as it is.
    pub size_px: Option<(u32, u32)>,
}

impl Frame {
    /// The part of the picture that `rect` names.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if it is not inside.
    pub fn cut(&self, rect: Rect) -> Result<Self, EngineError> {
        let Rect { x, y, width, height } = rect;
        let ends_inside = |from: u32, length: u32, side: u32| from.checked_add(length).is_some_and(|end| end <= side);
        if !ends_inside(x, width, self.width()) || !ends_inside(y, height, self.height()) {
            return Err(EngineError::Usage {
                what: "part of a frame".to_owned(),
                got: format!("{width} x {height} px at ({x}, {y})"),
                expected: format!("a part of {} x {} px", self.width(), self.height()),
            });
        }
        let rows = self.rgb().chunks_exact(3 * self.width() as usize).skip(y as usize).take(height as usize);
        let columns = 3 * x as usize..3 * (x + width) as usize;
        Self::new(width, height, rows.flat_map(|row| &row[columns.clone()]).copied().collect())
    }

    /// The picture resampled to `size_px` (Catmull-Rom, antialiased, rounded to 8 bits).
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a side of 0 or more than 16,384 px.
    pub fn resized(&self, size_px: (u32, u32)) -> Result<Self, EngineError> {
        let (width, height) = size_px;
        let is_sound = |side| (1..=MAX_SIDE_PX).contains(&side);
        if !is_sound(width) || !is_sound(height) {
            return Err(EngineError::Usage {
                what: "size of frames".to_owned(),
                got: format!("{width} x {height} px"),
                expected: format!("sides of 1 to {MAX_SIDE_PX} px"),
            });
        }
        let picture = RgbImage::from_raw(self.width(), self.height(), self.rgb().to_vec());
        let picture = picture.expect("a frame holds three samples per pixel");
        Self::new(width, height, resize(&picture, width, height, FilterType::CatmullRom).into_raw())
    }
}

/// Largest mean distance of a line of a bar from the bar's luma, in levels of 8 bits. Codecs add up to 4 next to the
/// picture and less elsewhere (measured: H.264, H.265, VP9 and AV1 at the factors that videos of the web have).
const BAR_NOISE: f64 = 4.0;
/// Distance from the bar's luma, in levels, from which a pixel surely belongs to a picture.
const PICTURE_LEVELS: f64 = 24.0;
/// Share of such pixels in a picture's outermost line.
const EDGE_SHARE: f64 = 0.5;
/// Most lines between a quiet bar and a picture's outermost line: codecs ring over so many.
const BLURRED_LINES: usize = 2;
/// Most lines by which the two bars differ: one where the picture's size is odd, and one more where chroma has half the
/// resolution.
const BAR_DIFFERENCE: usize = 2;
/// How far behind a picture's outermost line another says how wide what it shows is, lines; and what share of that the
/// outermost one has at least where a picture is cut off straight. What ends by itself over the bars' colour is round:
/// a disk has half as much in its first line as in its fourth.
const BEHIND_LINES: usize = 8;
const CUT_SHARE: f64 = 0.7;
/// Fewest lines of a bar; thinner ones are edges of a codec or a scanner, which do no harm.
const MIN_BAR: usize = 2;
/// Smallest share of a side that is a picture.
const MIN_PICTURE: f64 = 0.25;
/// Side of the corners that tell the luma of bars.
const CORNER_PX: u32 = 4;

/// Finds bars above and below a picture, or left and right of it, from pictures alone.
///
/// A bar is where all lines of all frames have one luma. (Colour would not do: video has chroma of half resolution,
/// which bleeds into bars.) That alone would eat a dark scene's background, so bars count only in pairs of the same
/// width, and only where a picture begins with a straight edge: its outermost line differs clearly from the bar in half
/// of its pixels, in one frame at least. A thing rendered over black has no such edge, nor a picture that fades to
/// black at its borders; nothing is cut off then. A video over black within black bars cannot be told from one without:
/// its bars have to be named.
#[derive(Clone, Debug, Default)]
pub struct BarFinder {
    /// Mean luma of the corners of the first frame.
    luma: Option<f64>,
    rows: Vec<Line>,
    columns: Vec<Line>,
}

/// A row or a column over all frames.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    /// Largest mean distance from the bars' luma in a frame, in levels.
    distance: f64,
    /// Largest share of pixels in a frame that surely belong to a picture.
    share: f64,
}

impl BarFinder {
    /// Looks at a frame; all have one size.
    pub fn look(&mut self, frame: &Frame) {
        let (width, height) = (frame.width() as usize, frame.height() as usize);
        let bar = *self.luma.get_or_insert_with(|| corners(frame));
        self.rows.resize(height, Line::default());
        self.columns.resize(width, Line::default());
        let mut rows = vec![(0.0, 0_u32); height];
        let mut columns = vec![(0.0, 0_u32); width];
        for (at, pixel) in frame.rgb().chunks_exact(3).enumerate() {
            let distance = (luma(pixel) - bar).abs();
            for (sum, count) in [&mut rows[at / width], &mut columns[at % width]] {
                *sum += distance;
                *count += u32::from(distance > PICTURE_LEVELS);
            }
        }
        let merge = |lines: &mut [Line], seen: &[(f64, u32)], length: usize| {
            for (line, &(sum, count)) in lines.iter_mut().zip(seen) {
                line.distance = line.distance.max(sum / length as f64);
                line.share = line.share.max(f64::from(count) / length as f64);
            }
        };
        merge(&mut self.rows, &rows, width);
        merge(&mut self.columns, &columns, height);
    }

    /// The picture between bars; none if there are no bars.
    #[must_use]
    pub fn find(&self) -> Option<Rect> {
        let (rows, columns) = (bars(&self.rows), bars(&self.columns));
        if rows.is_none() && columns.is_none() {
            return None;
        }
        let [(y, height), (x, width)] = [(rows, self.rows.len()), (columns, self.columns.len())]
            .map(|(found, side)| found.map_or((0, side), |(before, after)| (before, side - before - after)));
        let px = |length: usize| u32::try_from(length).ok();
        Some(Rect { x: px(x)?, y: px(y)?, width: px(width)?, height: px(height)? })
    }

    /// The part about the middle of frames that bars of one height on both sides leave, for those who ask where the
    /// middle is and not where a picture ends: all of a frame that has none.
    ///
    /// Of a thing over black within black bars, too: what is cut off straight on one side, and is no nearer to the edge
    /// on the other, says how high the bars of both are. Where that is not so but looks like it, nothing is cut off but
    /// what has one luma in all frames. None where no frame was looked at.
    #[must_use]
    pub fn middle(&self) -> Option<Rect> {
        if self.rows.is_empty() {
            return None;
        }
        let px = |length: usize| u32::try_from(length).ok();
        let [y, x] = [&self.rows, &self.columns].map(|lines| even_bars(lines));
        let [height, width] = [self.rows.len() - 2 * y, self.columns.len() - 2 * x];
        Some(Rect { x: px(x)?, y: px(y)?, width: px(width)?, height: px(height)? })
    }
}

/// Luma of BT.709, in levels.
fn luma(pixel: &[u8]) -> f64 {
    let weights = [0.2126, 0.7152, 0.0722];
    pixel.iter().zip(weights).map(|(&level, weight)| f64::from(level) * weight).sum()
}

/// Mean luma of the four corners, which belong to bars wherever there are any.
fn corners(frame: &Frame) -> f64 {
    let (width, height) = (frame.width(), frame.height());
    let near = |at: u32, side: u32| at < CORNER_PX || side - at <= CORNER_PX;
    let pixels = (0..).zip(frame.rgb().chunks_exact(3));
    let in_corners = pixels.filter(|(at, _)| near(at % width, width) && near(at / width, height));
    let (sum, count) = in_corners.fold((0.0, 0.0), |(sum, count), (_, pixel)| (sum + luma(pixel), count + 1.0));
    sum / count
}

/// Lines of the bars before and after a picture.
fn bars(lines: &[Line]) -> Option<(usize, usize)> {
    let before = bar(lines.iter())?;
    let after = bar(lines.iter().rev())?;
    let picture = lines.len().checked_sub(before + after)?;
    let fits = before.abs_diff(after) <= BAR_DIFFERENCE && picture as f64 >= MIN_PICTURE * lines.len() as f64;
    fits.then_some((before, after))
}

/// Lines of bars of one height on both sides; 0 if there are none.
fn even_bars(lines: &[Line]) -> usize {
    let sides = [cut_bar(lines.iter()), cut_bar(lines.iter().rev())];
    let least = sides.iter().map(|(quiet, _)| *quiet).min().filter(|least| *least >= MIN_BAR);
    let is_least = |quiet: usize| least.is_some_and(|least| quiet <= least + BAR_DIFFERENCE);
    let bar = sides.into_iter().filter_map(|(quiet, bar)| bar.filter(|_| is_least(quiet))).min();
    bar.filter(|bar| 2.0 * *bar as f64 <= lines.len() as f64 * (1.0 - MIN_PICTURE)).unwrap_or(0)
}

/// Lines of a bar at the beginning, if a picture with a straight edge follows.
fn bar<'a>(lines: impl Iterator<Item = &'a Line> + Clone) -> Option<usize> {
    let quiet = lines.clone().take_while(|line| line.distance <= BAR_NOISE).count();
    let blurred = lines.skip(quiet).take(BLURRED_LINES + 1).position(|line| line.share >= EDGE_SHARE)?;
    Some(quiet + blurred).filter(|_| quiet >= MIN_BAR)
}

/// Lines of one luma at the beginning, and of the bar if a picture follows that is cut off straight.
fn cut_bar<'a>(lines: impl Iterator<Item = &'a Line> + Clone) -> (usize, Option<usize>) {
    let quiet = lines.clone().take_while(|line| line.distance <= BAR_NOISE).count();
    let mut behind = lines.skip(quiet);
    let inside = behind.clone().nth(BLURRED_LINES + BEHIND_LINES).map_or(1.0, |line| line.share);
    let least = (CUT_SHARE * inside).clamp(f64::MIN_POSITIVE, EDGE_SHARE);
    (quiet, behind.by_ref().take(BLURRED_LINES + 1).position(|line| line.share >= least).map(|blurred| quiet + blurred))
}
