//! Pictures of numbers, as SVG inside the page. Colours are those of the page: its style sheet names these by their
//! values here.

use plotters::backend::SVGBackend;
use plotters::chart::ChartBuilder;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea};
use plotters::element::{Circle, PathElement, Rectangle, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{BLACK, Color, FontFamily, FontStyle, IntoTextStyle, RGBColor, TextStyle};

/// Width of every chart, px: of a narrow screen, so that words stay large enough there.
const WIDTH_PX: u32 = 360;
/// What is good, what is bad, and what chance does; Okabe and Ito's blue, orange and a grey.
const GOOD: RGBColor = RGBColor(0x00, 0x72, 0xb2);
const BAD: RGBColor = RGBColor(0xd5, 0x5e, 0x00);
const CHANCE: RGBColor = RGBColor(0xcc, 0xcc, 0xcc);
const FONT_PX: f64 = 13.0;

type Picture<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawing = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// Draws into a picture of `height` px.
fn svg(height: u32, draw: impl FnOnce(&Picture<'_>) -> Drawing) -> String {
    let mut out = String::new();
    {
        let picture = SVGBackend::with_string(&mut out, (WIDTH_PX, height)).into_drawing_area();
        draw(&picture).and_then(|()| picture.present()).expect("a string takes any picture");
    }
    out
}

fn style(across: HPos) -> TextStyle<'static> {
    let font = (FontFamily::SansSerif, FONT_PX, FontStyle::Normal, &BLACK);
    font.into_text_style(&(0, 0)).pos(Pos::new(across, VPos::Center))
}

/// The nearest pixel.
#[allow(clippy::cast_possible_truncation, reason = "charts have a few hundred pixels")]
fn px(at: f64) -> i32 {
    at.round() as i32
}

/// How rare something is, in heads in a row, beside what the rule asks for.
pub(super) struct Rarity {
    /// Of the claim.
    pub(super) p: f64,
    /// Threshold.
    pub(super) fpr: f64,
    /// The least that this message could reach.
    pub(super) least: f64,
}

impl Rarity {
    /// Heads in a row that are as rare as `p`.
    pub(super) fn heads(p: f64) -> f64 {
        -p.clamp(f64::MIN_POSITIVE, 1.0).log2()
    }

    /// A bar from "always" to `p`, with the threshold as a line.
    pub(super) fn svg(&self) -> String {
        let [p, threshold, least] = [self.p, self.fpr, self.least].map(Self::heads);
        let most = p.max(threshold).max(least) * 1.05;
        let (left, right) = (8.0, f64::from(WIDTH_PX) - 8.0);
        let at = |heads: f64| px(left + heads / most * (right - left));
        svg(86, |picture| {
            picture.draw(&Rectangle::new([(px(left), 30), (px(right), 50)], CHANCE.filled()))?;
            let colour = if p >= threshold { GOOD } else { BAD };
            picture.draw(&Rectangle::new([(px(left), 30), (at(p), 50)], colour.filled()))?;
            picture.draw(&PathElement::new([(at(threshold), 22), (at(threshold), 58)], BLACK.stroke_width(2)))?;
            let toward = if at(threshold) > px(right) - 90 { HPos::Right } else { HPos::Center };
            picture.draw(&Text::new("threshold", (at(threshold), 12), style(toward)))?;
            for (power, words) in [(0.0, "1"), (3.0, "1e-3"), (6.0, "1e-6"), (9.0, "1e-9"), (18.0, "1e-18")] {
                let heads = power * std::f64::consts::LOG2_10;
                if heads <= most * 0.93 {
                    let anchor = if power == 0.0 { HPos::Left } else { HPos::Center };
                    picture.draw(&Text::new(words, (at(heads), 74), style(anchor)))?;
                    picture.draw(&PathElement::new([(at(heads), 50), (at(heads), 62)], BLACK))?;
                }
            }
            Ok(())
        })
    }
}

/// Matching bits of one reading, on a line from none to all.
pub(super) struct Share {
    pub(super) matches: u32,
    pub(super) num_bits: u32,
    /// Fewest and most matches that chance keeps to; none where there is no band.
    pub(super) band: Option<(u32, u32)>,
    /// Whether the dot is where it should be.
    pub(super) good: bool,
}

impl Share {
    pub(super) fn svg(&self) -> String {
        let (left, right) = (8.0, f64::from(WIDTH_PX) - 8.0);
        let at = |bits: u32| px(left + f64::from(bits) / f64::from(self.num_bits.max(1)) * (right - left));
        svg(24, |picture| {
            picture.draw(&PathElement::new([(px(left), 12), (px(right), 12)], BLACK))?;
            if let Some((low, high)) = self.band {
                picture.draw(&Rectangle::new([(at(low) - 3, 4), (at(high) + 3, 20)], CHANCE.filled()))?;
            }
            let colour = if self.good { GOOD } else { BAD };
            picture.draw(&Circle::new((at(self.matches), 12), 6, colour.filled()))
        })
    }
}

/// Signed margins of all bits: up where a bit reads as claimed.
pub(super) fn margins(margins: &[f64]) -> String {
    let far = margins.iter().map(|m| m.abs()).fold(f64::MIN_POSITIVE, f64::max);
    svg(150, |picture| {
        let mut chart = ChartBuilder::on(picture).margin(8).build_cartesian_2d(0.0..margins.len() as f64, -far..far)?;
        let bar = |(bit, &margin): (usize, &f64)| {
            let colour = if margin > 0.0 { GOOD } else { BAD };
            Rectangle::new([(bit as f64 + 0.1, 0.0), (bit as f64 + 0.9, margin)], colour.filled())
        };
        chart.draw_series(margins.iter().enumerate().map(bar))?;
        chart.draw_series([PathElement::new([(0.0, 0.0), (margins.len() as f64, 0.0)], BLACK)])?;
        Ok(())
    })
}

/// What copies score that were never made, and those that are named.
pub(super) struct Scores<'a> {
    /// How many decoys there are in each step of half a deviation, half of the steps below 0.
    pub(super) decoys: &'a [u64],
    /// In deviations.
    pub(super) named: &'a [f64],
    /// What names a copy, in deviations.
    pub(super) required: Option<f64>,
}

impl Scores<'_> {
    /// A histogram with a line for the threshold, and a dot for each named copy.
    pub(super) fn svg(&self) -> String {
        let half = self.decoys.len() as f64 / 4.0;
        let most = self.named.iter().copied().chain(self.required).fold(half, f64::max) * 1.05;
        let (left, right, floor) = (8.0, f64::from(WIDTH_PX) - 8.0, 100.0);
        let at = |score: f64| px(left + (score + half) / (most + half) * (right - left));
        let tallest = self.decoys.iter().copied().max().unwrap_or(0).max(1) as f64;
        svg(140, |picture| {
            for (count, step) in self.decoys.iter().zip(0u32..) {
                let from = f64::from(step) / 2.0 - half;
                let top = px(floor - 80.0 * *count as f64 / tallest);
                picture.draw(&Rectangle::new([(at(from), top), (at(from + 0.5), px(floor))], CHANCE.filled()))?;
            }
            picture.draw(&PathElement::new([(px(left), px(floor)), (px(right), px(floor))], BLACK))?;
            if let Some(required) = self.required {
                let line = PathElement::new([(at(required), 22), (at(required), px(floor))], BLACK.stroke_width(2));
                picture.draw(&line)?;
                picture.draw(&Text::new("names a copy", (at(required), 12), style(HPos::Center)))?;
            }
            for score in self.named {
                picture.draw(&Circle::new((at(*score), 92), 6, BAD.filled()))?;
            }
            picture.draw(&Text::new("0", (at(0.0), 116), style(HPos::Center)))?;
            picture.draw(&Text::new(format!("{most:.0}"), (px(right), 116), style(HPos::Right)))
        })
    }
}

/// Something that took its time.
pub(super) struct Bar {
    /// Which line it stands in, from 0.
    pub(super) line: usize,
    /// When it began, seconds.
    pub(super) from: f64,
    /// When it ended, seconds.
    pub(super) to: f64,
    /// Whether it ended well.
    pub(super) good: bool,
}

/// Bars in `lines` lines, over the seconds from 0 to the last end.
pub(super) fn timeline(bars: &[Bar], lines: usize) -> String {
    const LINE_PX: usize = 14;
    let last = bars.iter().map(|bar| bar.to).fold(f64::MIN_POSITIVE, f64::max);
    let (left, right) = (8.0, f64::from(WIDTH_PX) - 8.0);
    let at = |second: f64| px(left + second / last * (right - left));
    let below = u32::try_from(lines * LINE_PX).unwrap_or(u32::MAX);
    let row = i32::try_from(below).unwrap_or(i32::MAX);
    svg(below.saturating_add(28), |picture| {
        for Bar { line, from, to, good } in bars {
            let top = i32::try_from(line * LINE_PX).unwrap_or(i32::MAX);
            let colour = if *good { GOOD } else { BAD };
            // One of no length is seen, too.
            picture.draw(&Rectangle::new(
                [(at(*from), top + 2), (at(*to).max(at(*from) + 1), top + 12)],
                colour.filled(),
            ))?;
        }
        picture.draw(&PathElement::new([(px(left), row), (px(right), row)], BLACK))?;
        picture.draw(&Text::new("0 s", (px(left), row + 14), style(HPos::Left)))?;
        picture.draw(&Text::new(format!("{last:.0} s"), (px(right), row + 14), style(HPos::Right)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn charts_are_drawn_of_extreme_numbers() {
        for p in [1.0, 0.0, 2.0_f64.powi(-128), f64::NAN] {
            let picture = Rarity { p, fpr: 1e-6, least: 1e-4 }.svg();
            assert!(picture.contains("threshold") && !picture.contains("NaN"), "{p}: {picture}");
        }
        for (matches, num_bits) in [(0, 0), (0, 16), (16, 16)] {
            let picture = Share { matches, num_bits, band: Some((0, num_bits)), good: false }.svg();
            assert!(picture.contains("circle"), "{matches} of {num_bits}");
        }
        for (to, lines) in [(0.0, 1), (1e7, 40)] {
            let picture = timeline(&[Bar { line: lines - 1, from: 0.0, to, good: true }], lines);
            assert!(picture.contains("<rect") && !picture.contains("NaN"), "{to}: {picture}");
        }
        for (named, required) in [(vec![], None), (vec![1e6], Some(7.5)), (vec![8.0, f64::NAN], Some(0.0))] {
            let picture = Scores { decoys: &[0, 5, 9, 0], named: &named, required }.svg();
            assert!(picture.matches("<circle").count() == named.len() && !picture.contains("NaN"), "{picture}");
        }
        for signed in [vec![0.0; 16], vec![1.0, -2.0], vec![3.0; 128]] {
            let picture = margins(&signed);
            assert!(picture.matches("<rect").count() >= signed.len() && !picture.contains("NaN"), "{picture}");
        }
    }
}
