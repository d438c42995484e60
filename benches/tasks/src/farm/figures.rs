//! What a check measured, as a table for people and as one for programs.

use std::fmt::Display;

/// Figures in the order in which they were measured.
#[derive(Default)]
pub(super) struct Figures(Vec<Figure>);

struct Figure {
    what: String,
    value: String,
    unit: &'static str,
}

impl Figures {
    /// Takes in a number, with its unit.
    pub(super) fn add(&mut self, what: &str, value: impl Display, unit: &'static str) {
        self.0.push(Figure { what: what.to_owned(), value: value.to_string(), unit });
    }

    /// The same to three digits after the point.
    pub(super) fn add_fine(&mut self, what: &str, value: f64, unit: &'static str) {
        self.add(what, format!("{value:.3}"), unit);
    }

    /// For people.
    pub(super) fn table(&self) -> String {
        let width = |text: fn(&Figure) -> &str| self.0.iter().map(|f| text(f).chars().count()).max().unwrap_or(0);
        let (what, value) = (width(|f| &f.what), width(|f| &f.value));
        let line = |f: &Figure| format!("  {:what$}  {:>value$} {}\n", f.what, f.value, f.unit);
        self.0.iter().map(line).collect()
    }

    /// For programs.
    pub(super) fn csv(&self) -> String {
        let line = |f: &Figure| format!("{},{},{}\n", f.what.replace(',', ";"), f.value, f.unit);
        std::iter::once("figure,value,unit\n".to_owned()).chain(self.0.iter().map(line)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_lined_up_and_listed() {
        let mut figures = Figures::default();
        figures.add("rows, of all", 40, "rows");
        figures.add_fine("time", 1.5, "s");
        assert_eq!(figures.table(), "  rows, of all     40 rows\n  time          1.500 s\n");
        assert_eq!(figures.csv(), "figure,value,unit\nrows; of all,40,rows\ntime,1.500,s\n");
    }
}
