//! The page of leaks: where they were found to be filmed from, and who was named.

use std::path::{Path, PathBuf};

use guard4d_engine::base::files::read_file;
use guard4d_engine::error::EngineError;

use super::measure::LocatedRow;
use crate::chart::{Axis, Chart, Point, Series};
use crate::report::{Origin, Pictured, Report};
use crate::table::{Table, distinct};

/// Name of the page.
pub const NAME: &str = "leaks";
const RULES: &str = "Films are decoded 8-bit frames from cameras, lenses and moments drawn at random, which nothing \
    but the film tells. An error is the median over frames of the median distance of visible splats from where they \
    are. T is the score of the copy that leaked, in deviations of scores by chance; to name one of a million copies \
    with a p-value of 1e-6 takes 7.5.";

/// Writes the page, with those pictures that `folder` has. Says where it is.
///
/// # Errors
/// When it cannot be written.
pub fn write(
    out: &Path,
    rows: &[LocatedRow],
    folder: &Path,
    command: &str,
    devices: Vec<String>,
) -> Result<PathBuf, EngineError> {
    let mut pictures = Vec::new();
    for row in rows {
        let path = row.picture_in(folder);
        if path.exists() {
            let caption = format!(
                "{} {}, {}: the film, the original from where it was found to be taken, what differs (four times), and \
                 what the film says of each splat (fifteen times)",
                row.asset, row.film, row.attack
            );
            pictures.push(Pictured { caption, png: read_file(&path, "the picture of a leak")? });
        }
    }
    let readings = serde_json::to_value(rows).expect("numbers and words are valid JSON");
    report(rows).write_illustrated(out, NAME, &Origin { command, rules: RULES, devices, readings }, &pictures)
}

fn report(rows: &[LocatedRow]) -> Report {
    let found: Vec<&LocatedRow> = rows.iter().filter(|row| row.found).collect();
    let named = found.iter().filter(|row| row.named > 0).count();
    let wrong: usize = found.iter().map(|row| row.wrong).sum();
    let assets = distinct(rows.iter().map(|row| &row.asset));
    let attacks = distinct(rows.iter().map(|row| &row.attack));
    let of = |asset: &String| {
        let point = |row: &&&LocatedRow| Point { x: row.t_true, y: row.t, range: (row.t, row.t), label: String::new() };
        let points = found.iter().filter(|row| row.asset == *asset).collect::<Vec<_>>().iter().map(point).collect();
        Series { name: asset.clone(), points, joined: false }
    };
    let table = |title: &str, note: &str, cell: &dyn Fn(&[&LocatedRow]) -> String| {
        let line = |attack: &String| {
            let cells = assets.iter().map(|asset| {
                let of_both = rows.iter().filter(|row| row.asset == *asset && row.attack == *attack);
                cell(&of_both.collect::<Vec<_>>())
            });
            std::iter::once(attack.clone()).chain(cells).collect()
        };
        Table {
            title: title.to_owned(),
            note: note.to_owned(),
            head: std::iter::once("film".to_owned()).chain(assets.iter().cloned()).collect(),
            rows: attacks.iter().map(line).collect(),
        }
    };
    Report {
        title: "Leaks from unknown cameras".to_owned(),
        intro: format!(
            "{} of {} films were found, {named} named the right copy among a million, {wrong} another.",
            found.len(),
            rows.len()
        ),
        charts: vec![Chart {
            title: "T by the cameras that were found, over T by the true ones".to_owned(),
            x: Axis::linear("T by true cameras"),
            y: Axis::linear("T"),
            series: assets.iter().map(of).collect(),
        }],
        tables: vec![
            table("Found", "Films that were found, of all.", &|rows| {
                let found = rows.iter().filter(|row| row.found).count();
                if rows.is_empty() { String::new() } else { format!("{found} of {}", rows.len()) }
            }),
            table("Error, px", "Median of films, the worst in brackets.", &|rows| summary(rows, 2, |row| row.error_px)),
            table("T of T by true cameras", "Median of films.", &|rows| {
                summary(rows, 2, |row| Some(row.t / row.t_true))
            }),
            table("Seconds", "To locate a film; median, and the worst in brackets.", &|rows| {
                summary(rows, 0, |row| Some(row.seconds))
            }),
            films(rows),
        ],
    }
}

/// All films, a line each.
fn films(rows: &[LocatedRow]) -> Table {
    let head = ["asset", "number", "film", "px", "found", "error, px", "error of the moment", "T", "by true cameras"];
    let line = |row: &LocatedRow| {
        let known = |text: String| if row.found { text } else { String::new() };
        let name = match (row.wrong, row.named) {
            (0, 0) => "nobody",
            (0, _) => "the right one",
            _ => "another",
        };
        vec![
            row.asset.clone(),
            row.film.to_string(),
            row.attack.clone(),
            format!("{}x{}", row.width, row.height),
            if row.found { "yes" } else { "no" }.to_owned(),
            row.error_px.map(|px| format!("{px:.2}")).unwrap_or_default(),
            row.error_time.map(|time| format!("{time:.4}")).unwrap_or_default(),
            known(format!("{:.1}", row.t)),
            known(format!("{:.1}", row.t_true)),
            known(name.to_owned()),
            format!("{:.0}", row.seconds),
        ]
    };
    Table {
        title: "All films".to_owned(),
        note: String::new(),
        head: head.into_iter().chain(["named", "seconds"]).map(str::to_owned).collect(),
        rows: rows.iter().map(line).collect(),
    }
}

/// The median of those that were found and, of several, the largest.
fn summary(rows: &[&LocatedRow], digits: usize, figure: impl Fn(&LocatedRow) -> Option<f64>) -> String {
    let mut figures: Vec<f64> = rows.iter().filter(|row| row.found).filter_map(|row| figure(row)).collect();
    figures.sort_by(f64::total_cmp);
    match figures[..] {
        [] => String::new(),
        [one] => format!("{one:.digits$}"),
        [.., most] => format!("{:.digits$} ({most:.digits$})", figures[figures.len() / 2]),
    }
}
