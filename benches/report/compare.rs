//! Two runs side by side: what became slower, and by more than the runs themselves vary.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::stats::Quartiles;

/// Columns of `results.csv` that a comparison reads.
pub(crate) const NAME: &str = "name";
pub(crate) const JUDGED_BY: &str = "judged_by";
/// The clocks that a row can be judged by: of the processor, all threads, and of the device or the wall. Also the names
/// of their columns, to which [`QUARTILES`] are added.
pub(crate) const CORE_MS: &str = "core_ms";
pub(crate) const MS: &str = "ms";
/// Ends of the columns with the lower quartile, the median and the upper quartile.
pub(crate) const QUARTILES: [&str; 3] = ["_q1", "", "_q3"];

/// A row that takes this many times as long is flagged.
const FLAGGED: f64 = 1.1;

/// Times of one row, by the clock that it is judged by.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Entry {
    name: String,
    judged_by: String,
    time: Quartiles,
}

/// Where a results file is not one.
#[derive(Debug, PartialEq)]
pub(crate) struct Malformed {
    /// Counted from 1.
    pub(crate) line: usize,
    pub(crate) got: String,
    pub(crate) expected: String,
}

/// Rows of a `results.csv`.
pub(crate) fn parse(text: &str) -> Result<Vec<Entry>, Malformed> {
    let mut lines = text.lines().enumerate().map(|(i, line)| (i + 1, cells(line)));
    let columns = lines.next().map(|(_, cells)| cells).unwrap_or_default();
    lines.map(|(line, cells)| entry(&columns, line, &cells)).collect()
}

fn entry(columns: &[String], line: usize, cells: &[String]) -> Result<Entry, Malformed> {
    let cell = |column: &str| {
        let found = columns.iter().position(|c| c == column).ok_or_else(|| Malformed {
            line: 1,
            got: "no such column".to_owned(),
            expected: format!("{column}: run the benchmark again with this version"),
        })?;
        cells.get(found).cloned().ok_or_else(|| Malformed {
            line,
            got: format!("{} cells", cells.len()),
            expected: format!("{}", columns.len()),
        })
    };
    let judged_by = cell(JUDGED_BY)?;
    let number = |end: &str| {
        let column = format!("{judged_by}{end}");
        let text = cell(&column)?;
        text.parse().map_err(|_| Malformed { line, got: text, expected: format!("a number as {column}") })
    };
    let [low, median, high] = QUARTILES;
    let time = Quartiles { low: number(low)?, median: number(median)?, high: number(high)? };
    Ok(Entry { name: cell(NAME)?, judged_by, time })
}

/// Cells of a line; quotes keep commas inside a cell and stand in no name.
fn cells(line: &str) -> Vec<String> {
    let (mut cells, mut is_quoted) = (vec![String::new()], false);
    for letter in line.chars() {
        match letter {
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => cells.push(String::new()),
            other => cells.last_mut().expect("there is a first cell").push(other),
        }
    }
    cells
}

/// What a comparison says about one row.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Verdict {
    Slower,
    Faster,
    /// Within a tenth, or within the spread.
    Alike,
    /// A time that is no positive number, or two different clocks.
    Unclear,
}

impl Verdict {
    fn word(self) -> &'static str {
        match self {
            Self::Slower => "SLOWER",
            Self::Faster => "faster",
            Self::Alike => "",
            Self::Unclear => "no comparison",
        }
    }
}

/// Time of `b` by time of `a`, and how far it may be off: the sum of both spreads.
fn ratio(a: &Entry, b: &Entry) -> (f64, f64, Verdict) {
    let ratio = b.time.median / a.time.median;
    let spread = ratio * (a.time.spread() + b.time.spread());
    let is_known = ratio.is_finite() && ratio > 0.0 && spread.is_finite() && a.judged_by == b.judged_by;
    let verdict = if !is_known {
        Verdict::Unclear
    } else if ratio > FLAGGED && ratio - spread > 1.0 {
        Verdict::Slower
    } else if ratio < 1.0 / FLAGGED && ratio + spread < 1.0 {
        Verdict::Faster
    } else {
        Verdict::Alike
    };
    (ratio, spread, verdict)
}

/// Ratios of all rows of `b` to those of `a`, in `b`'s order.
pub(crate) fn table(a: &[Entry], b: &[Entry]) -> String {
    let before: BTreeMap<_, _> = a.iter().map(|entry| (entry.name.as_str(), entry)).collect();
    let after: BTreeMap<_, _> = b.iter().map(|entry| (entry.name.as_str(), entry)).collect();
    let mut out = format!("{:>7} {:>7} {:>12} {:>12}  {:<8} row\n", "B / A", "±", "A ms", "B ms", "clock");
    let mut counts = [Verdict::Slower, Verdict::Faster, Verdict::Unclear].map(|verdict| (verdict, 0));
    for entry in b {
        let Some(old) = before.get(entry.name.as_str()) else { continue };
        let (ratio, spread, verdict) = ratio(old, entry);
        let (was, is) = (old.time.median, entry.time.median);
        let clock = entry.judged_by.as_str();
        let line = format!("{ratio:>7.3} {spread:>7.3} {was:>12.4} {is:>12.4}  {clock:<8} {}", entry.name);
        writeln!(out, "{}", format!("{line}  {}", verdict.word()).trim_end()).expect("a string takes any text");
        for (_, count) in counts.iter_mut().filter(|(counted, _)| *counted == verdict) {
            *count += 1;
        }
    }
    for (side, entries, other) in [("A", a, &after), ("B", b, &before)] {
        for entry in entries.iter().filter(|entry| !other.contains_key(entry.name.as_str())) {
            writeln!(out, "only in {side}: {}", entry.name).expect("a string takes any text");
        }
    }
    let [(_, slower), (_, faster), (_, unclear)] = counts;
    let beyond = "by more than a tenth and the spread";
    writeln!(out, "\n{slower} rows slower and {faster} faster {beyond}; {unclear} without comparison")
        .expect("a string takes any text");
    out
}
