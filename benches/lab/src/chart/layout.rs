//! Where all parts of a chart go, before anything is drawn.

use super::data::{Axis, Chart, Point, Series};
use super::labels::{self, Drawn, Place, Wanted};
use super::span::{Span, Tick};
use super::words::{Area, LINE_PX, Line, width};

/// Size of the frame with numbers on both axes, px.
const PLOT_PX: [f64; 2] = [620.0, 340.0];
/// What the frame grows by for every point with words, px.
const LABEL_PX: f64 = 8.0;
/// Width of the frame with names down the side, and height of a line of it, px.
const NAMED_PX: f64 = 560.0;
const ROW_PX: f64 = 18.0;
/// Distance of points of several series on one line, px.
const DODGE_PX: f64 = 7.0;
/// Above the frame: the title.
pub(super) const TOP_PX: f64 = 34.0;
/// Left of the frame: a name, and room beside the numbers.
const LEFT_PX: f64 = 36.0;
/// Between a name down the side and the frame.
pub(super) const TICK_PX: f64 = 5.0;
/// Below the frame: numbers and a name.
pub(super) const BOTTOM_PX: f64 = 50.0;
/// Between frame and legend: a number may reach in.
const LEGEND_GAP_PX: f64 = 34.0;
/// A line of the legend, and its mark.
const LEGEND_LINE_PX: f64 = 18.0;
pub(super) const LEGEND_MARK_PX: f64 = 14.0;
/// At the right and lower edges.
const EDGE_PX: f64 = 10.0;
/// Between the words of two ticks.
const APART_PX: f64 = 8.0;

/// A point as the axes count.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    pub(super) mean: [f64; 2],
    pub(super) least: [f64; 2],
    pub(super) most: [f64; 2],
}

/// Words in the column beside the frame: of the legend, or of a point that has no room for them.
#[derive(Clone, Debug)]
pub(super) struct Aside<'a> {
    pub(super) words: &'a str,
    /// Left end of the words, and their middle.
    pub(super) x: f64,
    pub(super) y: f64,
    /// From the point, if it is one's.
    pub(super) leader: Option<Line>,
}

/// The parts of a picture, px.
#[derive(Debug)]
pub(super) struct Layout<'a> {
    pub(super) width: f64,
    pub(super) height: f64,
    pub(super) frame: Area,
    /// From left to right, and from bottom to top.
    pub(super) across: Span,
    pub(super) up: Span,
    pub(super) across_ticks: Vec<Tick>,
    pub(super) up_ticks: Vec<Tick>,
    pub(super) across_name: &'a str,
    pub(super) up_name: &'a str,
    /// Names of series, in their order.
    pub(super) legend: Vec<Aside<'a>>,
    /// Words of points, inside the frame and beside it.
    pub(super) labels: Vec<(&'a str, Place)>,
    pub(super) left_over: Vec<Aside<'a>>,
    is_named: bool,
    /// Distance of the points of two series on one line of names, in lines.
    dodge: f64,
    num_series: usize,
}

impl<'a> Layout<'a> {
    pub(super) fn of(chart: &'a Chart) -> Self {
        let mut layout = if chart.x.names.is_empty() { Self::numbers(chart) } else { Self::names(chart) };
        layout.column(chart);
        layout
    }

    /// Numbers on both axes.
    fn numbers(chart: &'a Chart) -> Self {
        let points = || chart.series.iter().flat_map(Series::shown);
        let across = Span::of(&chart.x, points().map(|p| p.x));
        let up = Span::of(&chart.y, points().flat_map(|p| [p.y, p.range.0, p.range.1]));
        let labels = points().filter(|p| !p.label.is_empty()).count();
        let height = PLOT_PX[1] + LABEL_PX * labels as f64;
        let up_ticks = up.ticks(|ticks| stand_apart(ticks, &up, height, |_| LINE_PX));
        let numbers = up_ticks.iter().map(|tick| width(&tick.words)).fold(0.0, f64::max);
        let left = LEFT_PX + numbers;
        let frame = Area { left, top: TOP_PX, right: left + PLOT_PX[0], bottom: TOP_PX + height };
        Self::blank(chart, frame, across, up, up_ticks)
    }

    /// Names down the side.
    fn names(chart: &'a Chart) -> Self {
        let Axis { names, .. } = &chart.x;
        let is_dodged = chart.series.len() > 1 && chart.series.iter().all(|series| !series.joined);
        let row = if is_dodged { ROW_PX.max(DODGE_PX * (chart.series.len() as f64 + 1.0)) } else { ROW_PX };
        let left = names.iter().map(|name| width(name)).fold(0.0, f64::max) + 4.0 * TICK_PX;
        let bottom = TOP_PX + row * names.len() as f64;
        let frame = Area { left, top: TOP_PX, right: left + NAMED_PX, bottom };
        let values = chart.series.iter().flat_map(Series::shown).flat_map(|p| [p.y, p.range.0, p.range.1]);
        let across = Span::of(&chart.y, values);
        let up = Span::of_lines(names.len());
        let tick = |(i, name): (usize, &String)| Tick { at: -(i as f64), words: name.clone() };
        let up_ticks = names.iter().enumerate().map(tick).collect();
        let blank = Self::blank(chart, frame, across, up, up_ticks);
        Self {
            is_named: true,
            dodge: if is_dodged { DODGE_PX / row } else { 0.0 },
            across_name: &chart.y.name,
            up_name: &chart.x.name,
            ..blank
        }
    }

    /// A picture without legend and labels.
    fn blank(chart: &'a Chart, frame: Area, across: Span, up: Span, up_ticks: Vec<Tick>) -> Self {
        let wide = frame.right - frame.left;
        let across_ticks = across.ticks(|ticks| stand_apart(ticks, &across, wide, |words| width(words) + APART_PX));
        Self {
            width: frame.right + EDGE_PX,
            height: frame.bottom + BOTTOM_PX,
            frame,
            across,
            up,
            across_ticks,
            up_ticks,
            across_name: &chart.x.name,
            up_name: &chart.y.name,
            legend: Vec::new(),
            labels: Vec::new(),
            left_over: Vec::new(),
            is_named: false,
            dodge: 0.0,
            num_series: chart.series.len(),
        }
    }

    /// Adds legend and labels, and room for them.
    fn column(&mut self, chart: &'a Chart) {
        let x = self.frame.right + LEGEND_GAP_PX + LEGEND_MARK_PX;
        let line = |number: usize| TOP_PX + LEGEND_LINE_PX * (number as f64 + 0.5);
        let names = chart.series.iter().enumerate();
        self.legend = names.map(|(i, s)| Aside { words: &s.name, x, y: line(i), leader: None }).collect();
        let (wanted, drawn) = self.points(chart);
        let places = labels::places(&wanted, &drawn, &self.frame);
        // What finds no room goes below the legend, in the order of the points, so that lines cross less.
        let (mut number, mut left_over) = (self.legend.len() + 1, Vec::new());
        for (wanted, place) in wanted.into_iter().zip(places) {
            match place {
                Some(place) => self.labels.push((wanted.words, place)),
                None => left_over.push(wanted),
            }
        }
        left_over.sort_by(|a, b| a.y.total_cmp(&b.y));
        for Wanted { words, x: from_x, y: from_y } in left_over {
            let y = line(number);
            number += 1;
            let leader = Some(Line { x0: from_x, y0: from_y, x1: x - TICK_PX, y1: y });
            self.left_over.push(Aside { words, x, y, leader });
        }
        let beside = || self.legend.iter().chain(&self.left_over);
        self.width = beside().map(|aside| aside.x + width(aside.words) + EDGE_PX).fold(self.width, f64::max);
        self.width = self.width.max(EDGE_PX + 1.2 * width(&chart.title));
        self.height = beside().map(|aside| aside.y + LINE_PX).fold(self.height, f64::max);
    }

    /// Words that want a place, and what is drawn of the points.
    fn points(&self, chart: &'a Chart) -> (Vec<Wanted<'a>>, Drawn) {
        let (mut wanted, mut drawn) = (Vec::new(), Drawn::default());
        for (number, series) in chart.series.iter().enumerate() {
            let mut before = None;
            for point in series.shown() {
                let spot = self.spot(number, point);
                let [[x, y], [x0, y0], [x1, y1]] = [spot.mean, spot.least, spot.most].map(|at| self.pixels(at));
                drawn.dots.push([x, y]);
                drawn.lines.push(Line { x0, y0, x1, y1 });
                if let Some([x0, y0]) = before.replace([x, y]).filter(|_| series.joined) {
                    drawn.lines.push(Line { x0, y0, x1: x, y1: y });
                }
                if !point.label.is_empty() {
                    wanted.push(Wanted { words: &point.label, x, y });
                }
            }
        }
        (wanted, drawn)
    }

    /// Where a point of a series is, as the axes count.
    pub(super) fn spot(&self, series: usize, point: &Point) -> Spot {
        if self.is_named {
            let middle = 0.5 * (self.num_series as f64 - 1.0);
            let row = -point.x - self.dodge * (series as f64 - middle);
            let [mean, least, most] = [point.y, point.range.0, point.range.1].map(|v| [self.across.bent(v), row]);
            return Spot { mean, least, most };
        }
        let x = self.across.bent(point.x);
        let [mean, least, most] = [point.y, point.range.0, point.range.1].map(|v| [x, self.up.bent(v)]);
        Spot { mean, least, most }
    }

    /// Pixels of a place on the axes.
    fn pixels(&self, at: [f64; 2]) -> [f64; 2] {
        let Area { left, top, right, bottom } = self.frame;
        [left + self.across.part(at[0]) * (right - left), bottom - self.up.part(at[1]) * (bottom - top)]
    }
}

/// Whether the words of ticks, each of which takes so much `room`, keep apart on an axis of `length` px, and do not
/// reach far beyond its end.
fn stand_apart(ticks: &[Tick], span: &Span, length: f64, room: impl Fn(&str) -> f64) -> bool {
    let ends = |tick: &Tick| {
        let (at, half) = (length * span.part(tick.at), 0.5 * room(&tick.words));
        [at - half, at + half]
    };
    ticks.windows(2).all(|pair| ends(&pair[0])[1] <= ends(&pair[1])[0])
        && ticks.last().is_none_or(|tick| ends(tick)[1] <= length + LEGEND_GAP_PX)
}
