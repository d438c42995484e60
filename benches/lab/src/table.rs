//! Tables of words.

use maud::{Markup, Render, html};
use serde::Serialize;

/// A table of words.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Heading.
    pub title: String,
    /// What its columns mean.
    pub note: String,
    /// Names of the columns.
    pub head: Vec<String>,
    /// Cells, line by line.
    pub rows: Vec<Vec<String>>,
}

/// Each name once, in the order in which they come first.
pub(crate) fn distinct<'a>(all: impl Iterator<Item = &'a String>) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for name in all {
        if !names.contains(name) {
            names.push(name.clone());
        }
    }
    names
}

/// As part of a page.
impl Render for Table {
    fn render(&self) -> Markup {
        html! {
            h2 { (self.title) }
            p { (self.note) }
            table {
                tr { @for name in &self.head { th { (name) } } }
                @for row in &self.rows {
                    tr { @for cell in row { td { (cell) } } }
                }
            }
        }
    }
}
