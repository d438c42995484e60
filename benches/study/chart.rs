//! The chart: bits right in marked clips against measured PSNR, a curve for each model, mode and number of steps.

use std::fmt::Write;

use crate::ledger::Ledger;
use crate::summary::Group;
use crate::svg::{drawing, text};

/// Picture, and margins for the labels: left, top, right, bottom.
const SIZE: (f64, f64) = (940.0, 460.0);
const MARGIN: (f64, f64, f64, f64) = (56.0, 16.0, 280.0, 44.0);
/// Range of the accuracy axis in percent: all of it, because wrong bits can outnumber right ones.
const ACCURACY: (f64, f64) = (0.0, 100.0);
/// Distance of the grid lines: dB, percent.
const GRID: (f64, f64) = (2.0, 10.0);
const LEGEND_LINE: f64 = 18.0;
/// Okabe and Ito's colours, which the colour-blind can tell apart.
const COLOURS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
/// Lines of the models, in SVG's terms.
const DASHES: [&str; 4] = ["none", "7 4", "2 3", "10 3 2 3"];

/// Where values go.
struct Axes {
    /// Smallest and largest PSNR shown.
    db: (f64, f64),
}

impl Axes {
    fn x(&self, db: f64) -> f64 {
        MARGIN.0 + (db - self.db.0) / (self.db.1 - self.db.0) * (SIZE.0 - MARGIN.0 - MARGIN.2)
    }

    fn y(&self, percent: f64) -> f64 {
        let share = (percent.clamp(ACCURACY.0, ACCURACY.1) - ACCURACY.0) / (ACCURACY.1 - ACCURACY.0);
        SIZE.1 - MARGIN.3 - share * (SIZE.1 - MARGIN.1 - MARGIN.3)
    }
}

/// `study.svg`
pub(crate) fn svg(ledger: &Ledger) -> String {
    let groups = Group::all(ledger);
    let all: Vec<f64> = groups.iter().flat_map(|g| g.values("psnr_db")).filter(|db| db.is_finite()).collect();
    let low = all.iter().copied().fold(f64::INFINITY, f64::min);
    let high = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if all.is_empty() {
        return drawing(SIZE, "");
    }
    let db = ((low / GRID.0).floor() * GRID.0, ((high / GRID.0).floor() + 1.0) * GRID.0);
    let axes = Axes { db };
    let mut body = grid(&axes);
    let mut curves: Vec<(Style, Vec<&Group<'_>>)> = Vec::new();
    let (mut kinds, mut models) = (Vec::new(), Vec::new());
    for group in &groups {
        let cell = |name| group.cell(name).to_owned();
        let kind = position(&mut kinds, [cell("mode"), cell("bits"), cell("steps")]);
        let style = Style { kind, model: position(&mut models, cell("model")), is_own: group.is_own() };
        match curves.iter_mut().find(|(s, _)| *s == style) {
            Some((_, points)) => points.push(group),
            None => curves.push((style, vec![group])),
        }
    }
    for (i, (style, points)) in curves.iter().enumerate() {
        let ([mode, bits, steps], model) = (&kinds[style.kind], &models[style.model]);
        let rescaled = if style.is_own { "" } else { ", rescaled" };
        let name = format!("{model} {mode}, {bits} bits, {steps} steps{rescaled}");
        curve(&mut body, &axes, (i, *style, &name), points);
    }
    drawing(SIZE, &body)
}

/// How a curve looks: a colour for what was done, a kind of line for the model, thin for marks that were rescaled.
#[derive(Clone, Copy, PartialEq)]
struct Style {
    kind: usize,
    model: usize,
    is_own: bool,
}

impl Style {
    fn colour(self) -> &'static str {
        COLOURS[self.kind % COLOURS.len()]
    }

    /// Attributes of the line.
    fn stroke(self) -> String {
        let (dash, width) = (DASHES[self.model % DASHES.len()], if self.is_own { 2 } else { 1 });
        format!("stroke=\"{}\" stroke-width=\"{width}\" stroke-dasharray=\"{dash}\" fill=\"none\"", self.colour())
    }
}

/// Place of `value` in `seen`, where it is put if it is new.
fn position<T: PartialEq>(seen: &mut Vec<T>, value: T) -> usize {
    seen.iter().position(|v| *v == value).unwrap_or_else(|| {
        seen.push(value);
        seen.len() - 1
    })
}

fn grid(axes: &Axes) -> String {
    let mut out = String::new();
    let (left, right) = (MARGIN.0, SIZE.0 - MARGIN.2);
    let (top, bottom) = (MARGIN.1, SIZE.1 - MARGIN.3);
    let mut rule = |path: String, colour: &str| {
        writeln!(out, "<path d=\"{path}\" stroke=\"{colour}\" fill=\"none\"/>").expect("a string takes any text");
    };
    let steps = |(low, high): (f64, f64), step: f64| {
        std::iter::successors(Some(low), move |v| Some(v + step)).take_while(move |v| *v <= high)
    };
    for percent in steps(ACCURACY, GRID.1) {
        // Chance stands out.
        let colour = if percent == 50.0 { "#666" } else { "#ddd" };
        rule(format!("M{left} {y:.1}H{right}", y = axes.y(percent)), colour);
    }
    for db in steps(axes.db, GRID.0) {
        rule(format!("M{x:.1} {top}V{bottom}", x = axes.x(db)), "#ddd");
    }
    for percent in steps(ACCURACY, GRID.1) {
        text(&mut out, (left - 6.0, axes.y(percent) + 4.0), "end", &format!("{percent}"));
    }
    for db in steps(axes.db, GRID.0) {
        text(&mut out, (axes.x(db), bottom + 16.0), "middle", &format!("{db}"));
    }
    text(&mut out, (f64::midpoint(left, right), SIZE.1 - 8.0), "middle", "measured PSNR, dB");
    let middle = f64::midpoint(top, bottom);
    writeln!(out, "<text transform=\"translate(14 {middle}) rotate(-90)\" text-anchor=\"middle\">bits right, %</text>")
        .expect("a string takes any text");
    out
}

/// A line through the means over seeds, a circle for each seed, and the entry in the legend.
fn curve(out: &mut String, axes: &Axes, (number, style, name): (usize, Style, &str), points: &[&Group<'_>]) {
    let (colour, stroke) = (style.colour(), style.stroke());
    let means = points.iter().filter_map(|g| Some((g.mean("psnr_db")?, g.mean("marked")?)));
    let mut means: Vec<_> = means.filter(|(db, _)| db.is_finite()).collect();
    means.sort_by(|a, b| a.0.total_cmp(&b.0));
    let path: Vec<_> =
        means.iter().map(|(db, share)| format!("{:.1},{:.1}", axes.x(*db), axes.y(100.0 * share))).collect();
    let mut draw = |shape: String| writeln!(out, "{shape}").expect("a string takes any text");
    draw(format!("<polyline points=\"{}\" {stroke}/>", path.join(" ")));
    let radius = if style.is_own { 3 } else { 2 };
    for group in points {
        for (db, share) in group.values("psnr_db").into_iter().zip(group.values("marked")) {
            if db.is_finite() {
                let (x, y) = (axes.x(db), axes.y(100.0 * share));
                draw(format!(
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{colour}\" fill-opacity=\"0.6\"/>"
                ));
            }
        }
    }
    let (x, y) = (SIZE.0 - MARGIN.2 + 12.0, MARGIN.1 + 12.0 + number as f64 * LEGEND_LINE);
    draw(format!("<path d=\"M{x} {}h24\" {stroke}/>", y - 4.0));
    text(out, (x + 30.0, y), "start", name);
}
