//! What a chart shows.

use serde::Serialize;

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

impl Point {
    /// Whether it has a place.
    pub(super) fn is_shown(&self) -> bool {
        self.x.is_finite() && self.y.is_finite()
    }
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

impl Series {
    /// Points that have a place.
    pub(super) fn shown(&self) -> impl Iterator<Item = &Point> {
        self.points.iter().filter(|point| point.is_shown())
    }
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
}

/// A chart.
///
/// An abscissa of names is drawn down the side, a line for each, because names are long; the ordinate then runs from
/// left to right.
#[derive(Clone, Debug, Serialize)]
pub struct Chart {
    /// What it shows.
    pub title: String,
    /// Abscissa.
    pub x: Axis,
    /// Ordinate, of numbers.
    pub y: Axis,
    /// What is drawn.
    pub series: Vec<Series>,
}
