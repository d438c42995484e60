//! The chart: how near every row comes to its limit.

use plotters::backend::SVGBackend;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea};
use plotters::element::{PathElement, Rectangle, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{BLACK, Color, FontFamily, FontStyle, IntoTextStyle, RGBColor, TextStyle, WHITE};

/// Space around everything, px.
const MARGIN: i32 = 8;
/// Room for the bars (100 %), and for a figure behind a full bar.
const SCALE: i32 = 400;
const FIGURES: i32 = 60;
/// Above the first row: legend and axis.
const TOP: i32 = 62;
const ROW: i32 = 26;
const BAR: i32 = 8;
/// Distance of the grid lines in percent.
const GRID: usize = 20;
/// Sizes of names, and of the figures behind the bars, px.
const NAME_PX: f64 = 12.0;
const FIGURE_PX: f64 = 9.0;
/// Room that a letter of a name takes at most on average, px: 0.65 of its size, as in the wide DejaVu Sans.
const LETTER: i32 = 8;
/// The library makes words smaller than it was asked to.
const FONT_SHRINKS: f64 = 1.24;
const GREY: RGBColor = RGBColor(0xdd, 0xdd, 0xdd);
/// Okabe and Ito's blue and orange, which the colour-blind can tell apart.
const COLOURS: [RGBColor; 2] = [RGBColor(0x00, 0x72, 0xb2), RGBColor(0xd5, 0x5e, 0x00)];

type Picture<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawing = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// One row: percent of the limits of the legend, where it has them.
#[derive(Clone, Debug)]
pub(crate) struct Bars {
    pub(crate) name: String,
    pub(crate) shares: [Option<f64>; 2],
}

/// Horizontal bars. A bar ends at 100 %, as data that stays in a cache can pass it; its figure does not.
pub(crate) fn svg(legend: [&str; 2], rows: &[Bars]) -> String {
    let mut out = String::new();
    draw(legend, rows, &mut out).expect("a string takes any picture");
    out
}

fn draw(legend: [&str; 2], rows: &[Bars], out: &mut String) -> Drawing {
    // Where bars begin: behind the longest name.
    let left = 2 * MARGIN + rows.iter().map(|row| room(&row.name)).max().unwrap_or(0);
    let bottom = TOP + rows.iter().map(|_| ROW).sum::<i32>();
    let legend_right = legend.map(|words| 4 * MARGIN + room(words)).into_iter().max().unwrap_or(0);
    let width = (left + SCALE + FIGURES).max(legend_right);
    let size = (width.unsigned_abs(), (bottom + MARGIN).unsigned_abs());
    let picture = SVGBackend::with_string(out, size).into_drawing_area();
    picture.fill(&WHITE)?;
    for ((words, colour), y) in legend.into_iter().zip(COLOURS).zip([12, 28]) {
        bar(&picture, MARGIN, y, 12, colour)?;
        text(&picture, 3 * MARGIN, y, style(NAME_PX, HPos::Left), words)?;
    }
    for percent in (0..=100).step_by(GRID) {
        let x = left + length(percent as f64);
        picture.draw(&PathElement::new(vec![(x, TOP), (x, bottom)], GREY))?;
        text(&picture, x, TOP - 11, style(NAME_PX, HPos::Center), &format!("{percent} %"))?;
    }
    let mut middle = TOP + ROW / 2;
    for row in rows {
        text(&picture, left - MARGIN, middle, style(NAME_PX, HPos::Right), &row.name)?;
        for ((share, colour), y) in row.shares.into_iter().zip(COLOURS).zip([middle - 5, middle + 5]) {
            let Some(share) = share.filter(|s| s.is_finite()) else { continue };
            let wide = length(share);
            bar(&picture, left, y, wide, colour)?;
            text(&picture, left + wide + 4, y, style(FIGURE_PX, HPos::Left), &format!("{share:.0} %"))?;
        }
        middle += ROW;
    }
    picture.present()
}

/// Length of a bar.
#[allow(clippy::cast_possible_truncation, reason = "a bar has at most a few hundred pixels")]
fn length(percent: f64) -> i32 {
    (f64::from(SCALE) * percent.clamp(0.0, 100.0) / 100.0).round() as i32
}

/// Room for words of the size of names.
fn room(words: &str) -> i32 {
    words.chars().map(|_| LETTER).sum()
}

/// A bar around the height `y`.
fn bar(picture: &Picture<'_>, x: i32, y: i32, width: i32, colour: RGBColor) -> Drawing {
    let top = y - BAR / 2;
    picture.draw(&Rectangle::new([(x, top), (x + width, top + BAR)], colour.filled()))
}

fn text(picture: &Picture<'_>, x: i32, y: i32, style: TextStyle<'_>, words: &str) -> Drawing {
    picture.draw(&Text::new(words, (x, y), style))
}

/// Words of a size in px, whose place is at the middle of their height.
fn style(size_px: f64, across: HPos) -> TextStyle<'static> {
    let font = (FontFamily::SansSerif, FONT_SHRINKS * size_px, FontStyle::Normal, &BLACK);
    font.into_text_style(&(0, 0)).pos(Pos::new(across, VPos::Center))
}
