//! Charts of means with ranges, drawn as SVG so that no words lie over others.

mod data;
mod draw;
mod labels;
mod layout;
mod span;
mod words;

pub use data::{Axis, Chart, Point, Series};
