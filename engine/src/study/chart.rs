//! Charts of means with ranges, as SVG.

use std::fmt::Write;

use serde::Serialize;

use super::svg::{drawing, text};

/// Picture, and margins for the labels: left, top, right, bottom.
const SIZE: (f64, f64) = (940.0, 460.0);
const MARGIN: (f64, f64, f64, f64) = (64.0, 30.0, 280.0, 92.0);
/// Names on an axis beyond which they stand steeper, and what they take below besides.
const CROWD: usize = 12;
const CROWD_BELOW: f64 = 60.0;
/// About so many grid lines on an axis.
const GRID_LINES: f64 = 7.0;
const LEGEND_LINE: f64 = 17.0;
/// Radii of points in the chart and in the legend.
const DOT: &str = "3.5";
const LEGEND_DOT: &str = "4.5";
/// Okabe and Ito's colours, which the colour-blind can tell apart.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

/// One point with the range of what it is the mean of.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Abscissa.
    pub x: f64,
    /// Mean.
    pub y: f64,
    /// Least and greatest.
    pub range: (f64, f64),
    /// Words beside it.
    pub label: String,
}

/// Points of one colour.
#[derive(Clone, Debug, Serialize)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// Its points.
    pub points: Vec<Point>,
    /// Whether a line joins them.
    pub joined: bool,
}

/// What an axis shows.
#[derive(Clone, Debug, Serialize)]
pub struct Axis {
    /// Quantity and unit.
    pub name: String,
    /// Names of the points 0, 1, 2 and so on, instead of numbers.
    pub names: Vec<String>,
    /// Whether equal ratios take equal space.
    pub logarithmic: bool,
}

impl Axis {
    /// An axis of numbers.
    #[must_use]
    pub fn linear(name: &str) -> Self {
        Self { name: name.to_owned(), names: Vec::new(), logarithmic: false }
    }

    /// An axis of positive numbers by their ratios.
    #[must_use]
    pub fn logarithmic(name: &str) -> Self {
        Self { logarithmic: true, ..Self::linear(name) }
    }

    /// An axis of names.
    #[must_use]
    pub fn of_names(names: Vec<String>) -> Self {
        Self { names, ..Self::linear("") }
    }

    /// Degrees by which its words are turned, and room that they take below the usual.
    fn slant(&self) -> (f64, f64) {
        match self.names.len() {
            0 => (0.0, 0.0),
            1..=CROWD => (-28.0, 0.0),
            _ => (-60.0, CROWD_BELOW),
        }
    }
}

/// A chart.
#[derive(Clone, Debug, Serialize)]
pub struct Chart {
    /// What it shows.
    pub title: String,
    /// Abscissa.
    pub x: Axis,
    /// Ordinate.
    pub y: Axis,
    /// What is drawn.
    pub series: Vec<Series>,
}

/// Where the values of an axis go.
struct Span {
    values: (f64, f64),
    pixels: (f64, f64),
    logarithmic: bool,
}

impl Span {
    fn of(axis: &Axis, values: impl Iterator<Item = f64>, pixels: (f64, f64)) -> Self {
        let bend = |v: f64| if axis.logarithmic { v.max(f64::MIN_POSITIVE).ln() } else { v };
        let bounds = values.filter(|v| v.is_finite()).map(bend);
        let (low, high) = bounds.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = match (low <= high, axis.names.len()) {
            (_, names) if names > 0 => (0.0, names as f64 - 1.0),
            (true, _) => (low, high),
            (false, _) => (0.0, 1.0),
        };
        // Points do not sit on the frame, and a single value has room.
        let room = if high > low { 0.06 * (high - low) } else { 0.5 };
        Self { values: (low - room, high + room), pixels, logarithmic: axis.logarithmic }
    }

    fn at(&self, value: f64) -> f64 {
        let value = if self.logarithmic { value.max(f64::MIN_POSITIVE).ln() } else { value };
        let share = (value - self.values.0) / (self.values.1 - self.values.0);
        self.pixels.0 + share * (self.pixels.1 - self.pixels.0)
    }

    /// Values with a grid line.
    fn ticks(&self, axis: &Axis) -> Vec<(f64, String)> {
        if !axis.names.is_empty() {
            return (0..axis.names.len()).map(|i| (i as f64, axis.names[i].clone())).collect();
        }
        let (low, high) = self.values;
        if self.logarithmic {
            let inside = |v: &f64| (low..=high).contains(&v.ln());
            let decades = (-12..12).flat_map(|e| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(e)));
            return decades.filter(inside).map(|v| (v, format!("{v}"))).collect();
        }
        let raw = (high - low) / GRID_LINES;
        let decade = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|s| *s >= raw).unwrap_or(raw);
        let first = (low / step).ceil() * step;
        let lines = std::iter::successors(Some(first), |v| Some(v + step)).take_while(|v| *v <= high);
        // Steps are 1, 2 or 5 times a power of ten: as many decimals as make them whole.
        let decimals = (0..12).find(|digits| (step * 10f64.powi(*digits)).fract() < 1e-6).unwrap_or(0);
        lines.map(|v| (v, format!("{v:.*}", usize::try_from(decimals).unwrap_or(0)))).collect()
    }
}

impl Chart {
    /// As a picture that needs no other file.
    #[must_use]
    pub fn svg(&self) -> String {
        let points = || self.series.iter().flat_map(|s| &s.points);
        let x = Span::of(&self.x, points().map(|p| p.x), (MARGIN.0, SIZE.0 - MARGIN.2));
        let heights = points().flat_map(|p| [p.y, p.range.0, p.range.1]);
        let y = Span::of(&self.y, heights, (SIZE.1 - MARGIN.3, MARGIN.1));
        let mut body = String::new();
        text(&mut body, (MARGIN.0, 18.0), "start", &self.title);
        self.grid(&mut body, &x, &y);
        for (number, series) in self.series.iter().enumerate() {
            draw(&mut body, (&x, &y), number, series);
        }
        drawing((SIZE.0, SIZE.1 + self.x.slant().1), &body)
    }

    fn grid(&self, out: &mut String, x: &Span, y: &Span) {
        let (left, right, top, bottom) = (MARGIN.0, SIZE.0 - MARGIN.2, MARGIN.1, SIZE.1 - MARGIN.3);
        let mut rule = |path: String| line(out, &format!("<path d=\"{path}\" stroke=\"#ddd\" fill=\"none\"/>"));
        y.ticks(&self.y).iter().for_each(|(v, _)| rule(format!("M{left} {:.1}H{right}", y.at(*v))));
        x.ticks(&self.x).iter().for_each(|(v, _)| rule(format!("M{:.1} {top}V{bottom}", x.at(*v))));
        for (v, words) in y.ticks(&self.y) {
            text(out, (left - 6.0, y.at(v) + 4.0), "end", &words);
        }
        let (turn, _) = self.x.slant();
        for (v, words) in x.ticks(&self.x) {
            // Names are long: they stand aslant.
            let anchor = if self.x.names.is_empty() { "middle" } else { "end" };
            let words = super::svg::escaped(&words);
            let (at, below) = (x.at(v), bottom + 16.0);
            line(
                out,
                &format!(
                    "<text transform=\"translate({at:.1} {below}) rotate({turn})\" text-anchor=\"{anchor}\">{words}</text>"
                ),
            );
        }
        text(out, (f64::midpoint(left, right), bottom + 38.0), "middle", &self.x.name);
        let (middle, name) = (f64::midpoint(top, bottom), super::svg::escaped(&self.y.name));
        line(
            out,
            &format!("<text transform=\"translate(16 {middle}) rotate(-90)\" text-anchor=\"middle\">{name}</text>"),
        );
    }
}

/// Line, ranges, points, and the entry in the legend.
fn draw(out: &mut String, (x, y): (&Span, &Span), number: usize, series: &Series) {
    let colour = COLOURS[number % COLOURS.len()];
    // When the colours are used up they come again as rings.
    let fill = if (number / COLOURS.len()).is_multiple_of(2) { colour } else { "white" };
    let dot = |(x, y): (f64, f64), size: &str| {
        format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{size}\" fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"2\"/>"
        )
    };
    let shown: Vec<&Point> = series.points.iter().filter(|p| p.x.is_finite() && p.y.is_finite()).collect();
    if series.joined {
        let path: Vec<String> = shown.iter().map(|p| format!("{:.1},{:.1}", x.at(p.x), y.at(p.y))).collect();
        line(out, &format!("<polyline points=\"{}\" stroke=\"{colour}\" fill=\"none\"/>", path.join(" ")));
    }
    for point in shown {
        let (at, mean) = (x.at(point.x), y.at(point.y));
        let (low, high) = (y.at(point.range.0), y.at(point.range.1));
        line(out, &format!("<path d=\"M{at:.1} {low:.1}V{high:.1}\" stroke=\"{colour}\" stroke-opacity=\"0.5\"/>"));
        line(out, &dot((at, mean), DOT));
        text(out, (at + 6.0, mean - 5.0), "start", &point.label);
    }
    let (left, top) = (SIZE.0 - MARGIN.2 + 12.0, MARGIN.1 + 12.0 + number as f64 * LEGEND_LINE);
    line(out, &dot((left, top - 4.0), LEGEND_DOT));
    text(out, (left + 12.0, top), "start", &series.name);
}

fn line(out: &mut String, words: &str) {
    writeln!(out, "{words}").expect("a string takes any text");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_without_points_and_one_with_a_single_point_are_pictures() {
        let mut chart =
            Chart { title: "a < b".to_owned(), x: Axis::logarithmic("s"), y: Axis::linear("%"), series: Vec::new() };
        assert!(chart.svg().contains("a &lt; b"), "title");
        let point = Point { x: 3.0, y: f64::NAN, range: (0.0, 1.0), label: String::new() };
        let name = "one".to_owned();
        chart.series.push(Series { name, points: vec![point.clone(), Point { y: 0.5, ..point }], joined: true });
        let svg = chart.svg();
        assert_eq!(svg.matches(&format!("r=\"{DOT}\"")).count(), 1, "what is not a number is not drawn");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }

    #[test]
    fn many_names_stand_steeper_and_have_room() {
        let of = |names: usize| {
            let names = (0..names).map(|i| format!("name {i}")).collect();
            let x = Axis::of_names(names);
            Chart { title: String::new(), x, y: Axis::linear("%"), series: Vec::new() }.svg()
        };
        let (few, many) = (of(CROWD), of(CROWD + 1));
        assert!(few.contains("rotate(-28)") && !few.contains("rotate(-60)"), "{few}");
        assert!(many.contains("rotate(-60)") && !many.contains("rotate(-28)"), "{many}");
        let below = |svg: &str| svg.contains(&format!(" {}", SIZE.1 + CROWD_BELOW));
        assert!(below(&many) && !below(&few), "a taller picture: {many}");
    }

    #[test]
    fn ticks_are_round_numbers_inside() {
        let axis = Axis::linear("x");
        let span = Span::of(&axis, [41.0, 50.0].into_iter(), (0.0, 100.0));
        let ticks: Vec<String> = span.ticks(&axis).into_iter().map(|(_, words)| words).collect();
        assert_eq!(ticks, ["42", "44", "46", "48", "50"], "every other decibel");
        let axis = Axis::logarithmic("s");
        let span = Span::of(&axis, [9.0, 120.0].into_iter(), (0.0, 100.0));
        let ticks: Vec<String> = span.ticks(&axis).into_iter().map(|(_, words)| words).collect();
        assert_eq!(ticks, ["10", "20", "50", "100"], "seconds");
    }
}
