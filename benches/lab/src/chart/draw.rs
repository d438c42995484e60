//! Charts as pictures.

use std::ops::Range;

use plotters::backend::SVGBackend;
use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::drawing::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea};
use plotters::element::{Circle, PathElement, Rectangle, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{
    BLACK, Color, FontFamily, FontStyle, FontTransform, IntoTextStyle, RGBColor, ShapeStyle, TextStyle, WHITE,
};

use super::data::{Chart, Series};
use super::labels::{Place, Toward};
use super::layout::{Aside, BOTTOM_PX, LEGEND_MARK_PX, Layout, TICK_PX, TOP_PX};
use super::span::{Span, Tick};
use super::words::{Area, FONT_PX, LINE_PX, Line};

/// Radius of points, px.
const DOT_PX: u32 = 4;
/// Okabe and Ito's colours, which the colour-blind can tell apart.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0x00, 0x00, 0x00),
];
const GRID: RGBColor = RGBColor(0xe2, 0xe2, 0xe2);
const LEADER: RGBColor = RGBColor(0x99, 0x99, 0x99);
/// The library makes words smaller than it was asked to.
const FONT_SHRINKS: f64 = 1.24;

type Picture<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Frame<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Ticked, Ticked>>;
type Drawing = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// An axis as the library wants it.
struct Ticked {
    span: Span,
    ticks: Vec<Tick>,
}

impl Ranged for Ticked {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, ends: (i32, i32)) -> i32 {
        let (first, last) = ends;
        first + whole(self.span.part(*value) * f64::from(last - first))
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() { Vec::new() } else { self.ticks.iter().map(|tick| tick.at).collect() }
    }

    fn range(&self) -> Range<f64> {
        self.span.low..self.span.high
    }
}

impl ValueFormatter<f64> for Ticked {
    fn format_ext(&self, value: &f64) -> String {
        let tick = self.ticks.iter().find(|tick| tick.at == *value);
        tick.map(|tick| tick.words.clone()).unwrap_or_default()
    }
}

impl Chart {
    /// As a picture in SVG that needs no other file.
    ///
    /// # Panics
    /// Never: a string takes any picture.
    #[must_use]
    pub fn svg(&self) -> String {
        let layout = Layout::of(self);
        let mut out = String::new();
        draw(self, &layout, &mut out).expect("a string takes any picture");
        out
    }
}

fn draw(chart: &Chart, layout: &Layout<'_>, out: &mut String) -> Drawing {
    let size = (whole(layout.width).unsigned_abs(), whole(layout.height).unsigned_abs());
    let picture = SVGBackend::with_string(out, size).into_drawing_area();
    picture.fill(&WHITE)?;
    let title = style(1.2 * FONT_PX, HPos::Left);
    picture.draw(&Text::new(chart.title.as_str(), (whole(0.5 * TOP_PX), whole(0.5 * TOP_PX)), title))?;
    let mut frame = frame(layout, &picture)?;
    mesh(&mut frame)?;
    axis_names(layout, &picture)?;
    for (number, series) in chart.series.iter().enumerate() {
        points(layout, number, series, &frame)?;
    }
    for (number, name) in layout.legend.iter().enumerate() {
        let at = (whole(name.x - LEGEND_MARK_PX + f64::from(DOT_PX)), whole(name.y));
        picture.draw(&Circle::new(at, DOT_PX, mark(number)))?;
        words(&picture, name)?;
    }
    labels(layout, &picture)?;
    picture.present()
}

/// Words of points, over all lines that lead to some.
fn labels(layout: &Layout<'_>, picture: &Picture<'_>) -> Drawing {
    let inside = layout.labels.iter().filter_map(|(_, place)| place.leader);
    for Line { x0, y0, x1, y1 } in inside.chain(layout.left_over.iter().filter_map(|label| label.leader)) {
        picture.draw(&PathElement::new(vec![(whole(x0), whole(y0)), (whole(x1), whole(y1))], LEADER))?;
    }
    for (label, Place { area, toward, .. }) in &layout.labels {
        let corners = [(whole(area.left), whole(area.top)), (whole(area.right), whole(area.bottom))];
        picture.draw(&Rectangle::new(corners, WHITE.mix(0.8).filled()))?;
        // In a font with narrower letters the words still begin or end at their point.
        let (x, anchor) = match toward {
            Toward::Left => (area.left, HPos::Left),
            Toward::Middle => (f64::midpoint(area.left, area.right), HPos::Center),
            Toward::Right => (area.right, HPos::Right),
        };
        let at = (whole(x), whole(f64::midpoint(area.top, area.bottom)));
        picture.draw(&Text::new(*label, at, style(FONT_PX, anchor)))?;
    }
    layout.left_over.iter().try_for_each(|label| words(picture, label))
}

/// Axes at the place of the frame.
fn frame<'b>(
    layout: &Layout<'_>,
    picture: &Picture<'b>,
) -> Result<Frame<'b, 'b>, DrawingAreaErrorKind<std::io::Error>> {
    let ticked = |span: &Span, ticks: &[Tick]| Ticked { span: span.clone(), ticks: ticks.to_vec() };
    ChartBuilder::on(picture)
        .margin_top(layout.frame.top)
        .margin_right(layout.width - layout.frame.right)
        .margin_bottom(layout.height - layout.frame.bottom - BOTTOM_PX)
        .x_label_area_size(BOTTOM_PX)
        .y_label_area_size(layout.frame.left)
        .build_cartesian_2d(ticked(&layout.across, &layout.across_ticks), ticked(&layout.up, &layout.up_ticks))
}

/// Names of both axes, in the middle of their sides.
fn axis_names(layout: &Layout<'_>, picture: &Picture<'_>) -> Drawing {
    let Area { left, top, right, bottom } = layout.frame;
    let below = (whole(f64::midpoint(left, right)), whole(bottom + BOTTOM_PX - LINE_PX));
    picture.draw(&Text::new(layout.across_name, below, style(FONT_PX, HPos::Center)))?;
    let beside = (whole(LINE_PX), whole(f64::midpoint(top, bottom)));
    let upwards = style(FONT_PX, HPos::Center).transform(FontTransform::Rotate270);
    picture.draw(&Text::new(layout.up_name, beside, upwards))
}

/// Grid, and the numbers or names at it.
fn mesh(frame: &mut Frame<'_, '_>) -> Drawing {
    frame
        .configure_mesh()
        .bold_line_style(GRID)
        .light_line_style(WHITE.mix(0.0))
        .axis_style(LEADER)
        .set_all_tick_mark_size(whole(TICK_PX))
        .label_style(style(FONT_PX, HPos::Left))
        .draw()
}

/// Line, ranges and points of a series.
fn points(layout: &Layout<'_>, number: usize, series: &Series, frame: &Frame<'_, '_>) -> Drawing {
    let area = frame.plotting_area();
    let spots: Vec<_> = series.shown().map(|point| layout.spot(number, point)).collect();
    let at = |[x, y]: [f64; 2]| (x, y);
    let colour = COLOURS[number % COLOURS.len()];
    if series.joined {
        area.draw(&PathElement::new(spots.iter().map(|spot| at(spot.mean)).collect::<Vec<_>>(), colour.mix(0.8)))?;
    }
    for spot in &spots {
        if spot.least != spot.most {
            area.draw(&PathElement::new(vec![at(spot.least), at(spot.most)], colour.mix(0.5)))?;
        }
    }
    spots.iter().try_for_each(|spot| area.draw(&Circle::new(at(spot.mean), DOT_PX, mark(number))))
}

/// How the points of a series look: when the colours are used up they come again as rings.
fn mark(number: usize) -> ShapeStyle {
    let colour = COLOURS[number % COLOURS.len()];
    if (number / COLOURS.len()).is_multiple_of(2) { colour.filled() } else { colour.stroke_width(2) }
}

fn words(picture: &Picture<'_>, aside: &Aside<'_>) -> Drawing {
    picture.draw(&Text::new(aside.words, (whole(aside.x), whole(aside.y)), style(FONT_PX, HPos::Left)))
}

/// Words of a size in px, whose place is at the middle of their height.
fn style(size_px: f64, across: HPos) -> TextStyle<'static> {
    let font = (FontFamily::SansSerif, FONT_SHRINKS * size_px, FontStyle::Normal, &BLACK);
    font.into_text_style(&(0, 0)).pos(Pos::new(across, VPos::Center))
}

/// The nearest pixel.
#[allow(clippy::cast_possible_truncation, reason = "pictures have a few thousand pixels")]
fn whole(px: f64) -> i32 {
    px.round() as i32
}

#[cfg(test)]
mod tests {
    use roxmltree::{Document, Node};

    use super::*;
    use crate::chart::words::width;
    use crate::chart::{Axis, Point};

    fn point(x: f64, y: f64, label: &str) -> Point {
        Point { x, y, range: (y - 3.0, y + 2.0), label: label.to_owned() }
    }

    fn series(name: &str, points: Vec<Point>) -> Series {
        Series { name: name.to_owned(), points, joined: false }
    }

    /// Words of a picture and the room that they take.
    fn words_of(svg: &str) -> Vec<(String, Area)> {
        let document = Document::parse(svg).expect("a picture is XML");
        let texts = document.descendants().filter(|node| node.has_tag_name("text"));
        texts.map(|node| (node.text().unwrap_or_default().trim().to_owned(), area_of(&node))).collect()
    }

    fn area_of(node: &Node<'_, '_>) -> Area {
        let number = |name: &str| node.attribute(name).and_then(|v| v.parse::<f64>().ok()).expect("a number");
        let scale = number("font-size") / FONT_PX;
        let (wide, high) = (scale * width(node.text().unwrap_or_default().trim()), scale * LINE_PX);
        let before = match node.attribute("text-anchor") {
            Some("start") => 0.0,
            Some("middle") => 0.5,
            _ => 1.0,
        };
        // Below and above the middle of small letters, or of a line.
        let above = match node.attribute("dy") {
            Some("0.5ex") => 0.5,
            Some("-0.5ex") => 1.0,
            _ => 0.0,
        };
        let (x, y) = (number("x"), number("y"));
        if node.attribute("transform").is_some_and(|turn| turn.starts_with("rotate(270")) {
            let (left, bottom) = (x - above * high, y + before * wide);
            return Area { left, top: bottom - wide, right: left + high, bottom };
        }
        let (left, top) = (x - before * wide, y - above * high);
        Area { left, top, right: left + wide, bottom: top + high }
    }

    /// Fails unless all words of a chart are there, inside the picture and apart.
    fn check(chart: &Chart) -> String {
        let svg = chart.svg();
        let layout = Layout::of(chart);
        let picture = Area { left: 0.0, top: 0.0, right: layout.width, bottom: layout.height };
        let words = words_of(&svg);
        for (i, (one, area)) in words.iter().enumerate() {
            assert!(picture.holds(area), "`{one}` leaves the picture: {area:?}");
            for (other, beside) in &words[..i] {
                assert!(!area.meets(beside), "`{one}` lies over `{other}`: {area:?} {beside:?}");
            }
        }
        for label in chart.series.iter().flat_map(|s| s.shown()).map(|p| &p.label).filter(|label| !label.is_empty()) {
            assert_eq!(words.iter().filter(|(words, _)| words == label).count(), 1, "`{label}` is there");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        svg
    }

    #[test]
    fn a_chart_without_points_and_one_with_a_single_point_are_pictures() {
        let (x, y) = (Axis::logarithmic("s"), Axis::linear("%"));
        let mut chart = Chart { title: "a < b".to_owned(), x, y, series: Vec::new() };
        assert!(check(&chart).contains("a &lt; b"), "title");
        let known = Point { x: 3.0, y: 0.5, range: (0.0, 1.0), label: String::new() };
        let unknown = Point { y: f64::NAN, ..known.clone() };
        chart.series.push(Series { joined: true, ..series("one", vec![unknown, known]) });
        assert_eq!(check(&chart).matches("<circle").count(), 2, "what is not a number is not drawn: legend and point");
    }

    #[test]
    fn words_of_dense_points_do_not_lie_over_each_other() {
        // Forty settings within a few seconds and percent of each other, some of them twice at one place.
        let of = |i: u32| {
            let (x, y) = (f64::from(i * 37 % 40), f64::from(i * 17 % 40));
            point(11.0 + 0.05 * x, 90.0 + 0.1 * (y - y % 3.0), &format!("a setting, number {i}"))
        };
        let names = ["on the front", "beaten", "no exact p-value, or other bits"];
        let dense = |count: u32| {
            let points = |k: u32| (0..count).filter(|i| i % 3 == k).map(of).collect();
            let series = (0u32..).zip(names).map(|(k, name)| series(name, points(k))).collect();
            let (x, y) = (Axis::logarithmic("CPU seconds"), Axis::linear("bits right, %"));
            Chart { title: "bits right against CPU seconds".to_owned(), x, y, series }
        };
        check(&dense(40));
        // More than any frame holds: what is left over stands beside it.
        let crowd = dense(240);
        assert!(!Layout::of(&crowd).left_over.is_empty(), "a crowd");
        check(&crowd);
    }

    #[test]
    fn names_stand_down_the_side_however_many_and_long() {
        let of = |names: usize, joined: bool| {
            let names: Vec<_> = (0..names).map(|i| format!("a distortion with a long name, number {i}")).collect();
            let points = || (0u32..).zip(&names).map(|(i, _)| point(i.into(), 50.0, "")).collect();
            let series = (0..8).map(|k| Series { joined, ..series(&format!("arm {k}"), points()) }).collect();
            let (x, y) = (Axis::of_names(names.clone()), Axis::linear("bits right, %"));
            Chart { title: "bits right".to_owned(), x, y, series }
        };
        for names in [1, 3, 24, 60] {
            for joined in [false, true] {
                let words = words_of(&check(&of(names, joined)));
                let rows: Vec<f64> = (0..names)
                    .map(|i| format!("a distortion with a long name, number {i}"))
                    .filter_map(|name| words.iter().find(|(words, _)| *words == name).map(|(_, area)| area.top))
                    .collect();
                assert!(rows.len() == names && rows.is_sorted(), "from the top: {rows:?}");
            }
        }
    }

    #[test]
    fn numbers_of_axes_keep_apart() {
        for values in [[1e-9, 1e9], [0.98, 1.01], [1e-3, 2e-3], [123_456.0, 123_457.0], [-5.0, 5e5]] {
            for x in [Axis::linear("x"), Axis::logarithmic("x")] {
                let points = values.map(|v| point(v, v, "")).to_vec();
                check(&Chart { title: String::new(), x, y: Axis::linear("y"), series: vec![series("s", points)] });
            }
        }
    }
}
