//! Tables of words.

use std::fmt::Write as _;

use serde::Serialize;

use super::svg::escaped;

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

impl Table {
    /// As part of a page.
    pub(super) fn html(&self, out: &mut String) {
        let cells = |tag: &str, cells: &[String]| -> String {
            cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect()
        };
        let (title, note) = (escaped(&self.title), escaped(&self.note));
        write!(out, "<h2>{title}</h2>\n<p>{note}</p>\n<table>\n<tr>{}</tr>\n", cells("th", &self.head))
            .expect("a string takes any text");
        for row in &self.rows {
            writeln!(out, "<tr>{}</tr>", cells("td", row)).expect("a string takes any text");
        }
        out.push_str("</table>\n");
    }
}
