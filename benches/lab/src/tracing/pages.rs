//! Pages of what was measured: T over codecs and strengths, seconds against T, and who is named of mixtures.

use std::path::{Path, PathBuf};

use guard4d_engine::error::EngineError;

use super::film::FILMS;
use super::measure::Reading;
use crate::chart::{Axis, Chart, Point, Series};
use crate::report::{Origin, Report};
use crate::table::{Table, distinct};

const RULES: &str = "T is the score of the copy that leaked, in deviations of scores by chance; where several \
contributed, of the best. To name one of a million copies with a p-value of 1e-6 takes 7.5. Films are decoded 8-bit \
frames from cameras and at times of their own. Cells are medians over keys and the least in brackets.";
/// The strength that copies are stamped with unless something else is asked for, and the usual length of films.
const USUAL: (f64, u32) = (49.0, 24);
/// What names a copy.
const NAMED_FROM: f64 = 7.5;
/// H.264 by its quality; pictures without a codec stand at 0.
const BY_CRF: [(&str, f64); 4] = [("png", 0.0), ("h264 23", 23.0), ("h264 28", 28.0), ("h264 35", 35.0)];

/// Writes a page for each part of which there are readings. Says where they are.
///
/// # Errors
/// When they cannot be written.
pub fn write(out: &Path, rows: &[Reading], command: &str, devices: Vec<String>) -> Result<Vec<PathBuf>, EngineError> {
    let parts = [
        ("tracing", films(rows)),
        ("stamping", strengths(rows)),
        ("frames", lengths(rows)),
        ("collusion", mixtures(rows)),
    ];
    let mut pages = Vec::new();
    for (name, report) in parts {
        let Some(report) = report else { continue };
        let readings = serde_json::to_value(rows).expect("numbers and words are valid JSON");
        let origin = Origin { command, rules: RULES, devices: devices.clone(), readings };
        pages.push(report.write(out, name, &origin)?);
    }
    Ok(pages)
}

/// T over the quality of a codec, and all films.
fn films(rows: &[Reading]) -> Option<Report> {
    let rows: Vec<&Reading> = rows.iter().filter(|row| row.leak == "copy" && is_usual(row)).collect();
    let of = |asset: &str| {
        let at = |(film, crf): (&str, f64)| point(&rows, crf, |row| row.asset == asset && row.film == film);
        Series { name: asset.to_owned(), points: BY_CRF.into_iter().filter_map(at).collect(), joined: true }
    };
    let names = distinct(rows.iter().map(|row| &row.asset));
    let line = |film: &str| -> Option<Vec<String>> {
        let ts = |asset: &str| -> Vec<f64> {
            rows.iter().filter(|row| row.asset == asset && row.film == film).map(|row| row.t).collect()
        };
        let all: Vec<Vec<f64>> = names.iter().map(|asset| ts(asset)).collect();
        let whole = median(&mut all.iter().filter_map(|ts| median(&mut ts.clone())).collect::<Vec<_>>())?;
        let cells = all.into_iter().map(|ts| cell(&ts));
        Some(std::iter::once(film.to_owned()).chain(cells).chain([format!("{whole:.1}")]).collect())
    };
    let named = rows.iter().filter(|row| row.named > 0).count();
    (!rows.is_empty()).then(|| Report {
        title: "Copies told apart".to_owned(),
        intro: format!("{named} of {} films named the right copy among a million.", rows.len()),
        charts: vec![Chart {
            title: "T over the quality of H.264 (0: pictures)".to_owned(),
            x: Axis::linear("CRF"),
            y: Axis::logarithmic("T"),
            series: names.iter().map(|asset| of(asset)).chain([threshold(0.0, 35.0)]).collect(),
        }],
        tables: vec![Table {
            title: "T".to_owned(),
            note: "The median is of the assets'.".to_owned(),
            head: head("film", names.iter().cloned().chain(["median".to_owned()])),
            rows: FILMS.iter().filter_map(|film| line(film.name)).collect(),
        }],
    })
}

/// T over the PSNR that was asked for.
fn strengths(rows: &[Reading]) -> Option<Report> {
    let rows: Vec<&Reading> = rows.iter().filter(|row| row.leak == "copy" && row.frames == USUAL.1).collect();
    let mut asked: Vec<f64> = rows.iter().map(|row| row.asked_db).collect();
    sort(&mut asked);
    asked.dedup();
    // A single strength is no curve.
    let [first, .., last] = asked[..] else { return None };
    let of = |film: &str| {
        let at = |db: &f64| point(&rows, *db, |row| row.film == film && row.asked_db == *db);
        Series { name: film.to_owned(), points: asked.iter().filter_map(at).collect(), joined: true }
    };
    let series = BY_CRF.iter().map(|(film, _)| of(film));
    Some(Report {
        title: "How strong a stamp is".to_owned(),
        intro: "Copies stamped for several fidelities; points are medians over assets and keys.".to_owned(),
        charts: vec![Chart {
            title: "T over PSNR".to_owned(),
            x: Axis::linear("PSNR asked for, dB"),
            y: Axis::logarithmic("T"),
            series: series.chain([threshold(first, last)]).collect(),
        }],
        tables: Vec::new(),
    })
}

/// Seconds against T, by how many frames are read.
fn lengths(rows: &[Reading]) -> Option<Report> {
    let is_it = |row: &&Reading| row.leak == "copy" && row.film == "h264 23" && row.asked_db == USUAL.0;
    let rows: Vec<&Reading> = rows.iter().filter(is_it).collect();
    let frames = sorted(rows.iter().map(|row| row.frames));
    let [_, .., _] = frames[..] else { return None };
    let of = |asset: &String| {
        let at = |frames: &u32| {
            let is_it = |row: &Reading| row.asset == *asset && row.frames == *frames;
            let seconds = median(&mut rows.iter().filter(|row| is_it(row)).map(|row| row.seconds).collect::<Vec<_>>())?;
            Some(Point { label: frames.to_string(), ..point(&rows, seconds, is_it)? })
        };
        Series { name: asset.clone(), points: frames.iter().filter_map(at).collect(), joined: true }
    };
    Some(Report {
        title: "Speed against accuracy".to_owned(),
        intro: "Films through H.264 at CRF 23 of several lengths; the words are frames.".to_owned(),
        charts: vec![Chart {
            title: "T over the seconds that a trace takes".to_owned(),
            x: Axis::logarithmic("seconds"),
            y: Axis::logarithmic("T"),
            series: distinct(rows.iter().map(|row| &row.asset)).iter().map(of).collect(),
        }],
        tables: Vec::new(),
    })
}

/// The best of those who contributed to a mixture.
fn mixtures(rows: &[Reading]) -> Option<Report> {
    let rows: Vec<&Reading> = rows.iter().filter(|row| row.contributed > 1).collect();
    let rules = sorted(rows.iter().filter_map(|row| rule_of(row)));
    let sizes = sorted(rows.iter().map(|row| row.contributed));
    let end = *sizes.last()? as f64;
    let is_film = |row: &Reading| row.film != "asset";
    let of = |rule: &&str| {
        let is_it = |row: &Reading, size| is_film(row) && rule_of(row) == Some(*rule) && row.contributed == size;
        let at = |size: &usize| point(&rows, *size as f64, |row| is_it(row, *size));
        Series { name: (*rule).to_owned(), points: sizes.iter().filter_map(at).collect(), joined: true }
    };
    let columns: Vec<Mixture> =
        [true, false].into_iter().flat_map(|film| sizes.iter().map(move |&size| Mixture { film, size })).collect();
    let line = |rule: &&str| {
        let of_rule: Vec<&Reading> = rows.iter().copied().filter(|row| rule_of(row) == Some(*rule)).collect();
        let cells = columns.iter().map(|column| column.cell(&of_rule));
        std::iter::once((*rule).to_owned()).chain(cells).collect()
    };
    Some(Report {
        title: "Copies that were mixed".to_owned(),
        intro: "T of the best, and how many of those who contributed are named.".to_owned(),
        charts: vec![Chart {
            title: "T over the number of copies that were mixed".to_owned(),
            x: Axis::linear("copies"),
            y: Axis::logarithmic("T"),
            series: rules.iter().map(of).chain([threshold(sizes[0] as f64, end)]).collect(),
        }],
        tables: vec![Table {
            title: "Mixtures".to_owned(),
            note: String::new(),
            head: head("rule", columns.iter().map(Mixture::name)),
            rows: rules.iter().map(line).collect(),
        }],
    })
}

/// A column of the mixtures' table.
struct Mixture {
    film: bool,
    size: usize,
}

impl Mixture {
    fn name(&self) -> String {
        format!("{}, {}", self.size, if self.film { "film" } else { "asset" })
    }

    fn cell(&self, of_rule: &[&Reading]) -> String {
        let is_it = |row: &&&Reading| (row.film != "asset") == self.film && row.contributed == self.size;
        let of: Vec<&&Reading> = of_rule.iter().filter(is_it).collect();
        let named: usize = of.iter().map(|row| row.named).sum();
        match of.is_empty() {
            true => String::new(),
            false => {
                let ts: Vec<f64> = of.iter().map(|row| row.t).collect();
                format!("{}; {named} of {}", cell(&ts), of.len() * self.size)
            }
        }
    }
}

/// The rule of "RULE COPIES".
fn rule_of(row: &Reading) -> Option<&str> {
    row.leak.rsplit_once(' ').map(|(rule, _)| rule)
}

fn sorted<T: Ord>(all: impl Iterator<Item = T>) -> Vec<T> {
    let mut all: Vec<T> = all.collect();
    all.sort_unstable();
    all.dedup();
    all
}

fn is_usual(row: &Reading) -> bool {
    (row.asked_db, row.frames) == USUAL
}

fn head(first: &str, rest: impl Iterator<Item = String>) -> Vec<String> {
    std::iter::once(first.to_owned()).chain(rest).collect()
}

/// The median T of some rows, with the range.
fn point(rows: &[&Reading], x: f64, is_it: impl Fn(&Reading) -> bool) -> Option<Point> {
    let mut ts: Vec<f64> = rows.iter().filter(|row| is_it(row)).map(|row| row.t).collect();
    let y = median(&mut ts)?;
    Some(Point { x, y, range: (ts[0], ts[ts.len() - 1]), label: String::new() })
}

/// What names a copy, as a line.
fn threshold(from: f64, to: f64) -> Series {
    let at = |x| Point { x, y: NAMED_FROM, range: (NAMED_FROM, NAMED_FROM), label: String::new() };
    Series { name: "names a copy".to_owned(), points: vec![at(from), at(to)], joined: true }
}

/// The median, and the least of several.
fn cell(ts: &[f64]) -> String {
    let mut ts = ts.to_vec();
    match (median(&mut ts), ts.len()) {
        (None, _) => String::new(),
        (Some(one), 1) => format!("{one:.1}"),
        (Some(median), _) => format!("{median:.1} ({:.1})", ts[0]),
    }
}

fn sort(numbers: &mut [f64]) {
    numbers.sort_by(f64::total_cmp);
}

/// The middle one, or the mean of both; they are sorted then.
fn median(numbers: &mut [f64]) -> Option<f64> {
    sort(numbers);
    let middle = numbers.get(numbers.len() / 2)?;
    Some(if numbers.len() % 2 == 1 { *middle } else { f64::midpoint(*middle, numbers[numbers.len() / 2 - 1]) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_drawn_of_what_was_measured_and_no_others() {
        let row = |asset: &str, film: &str, t| Reading {
            asset: asset.to_owned(),
            leak: "copy".to_owned(),
            film: film.to_owned(),
            frames: USUAL.1,
            asked_db: USUAL.0,
            contributed: 1,
            named: 1,
            t,
            ..Reading::default()
        };
        let rows = [row("a", "h264 23", 30.0), row("a", "h264 23", 20.0), row("b", "h264 23", 40.0)];
        let report = films(&rows).expect("there are films");
        assert_eq!(report.tables[0].rows, [["h264 23", "25.0 (20.0)", "40.0", "32.5"]]);
        assert_eq!(report.charts[0].series[0].points[0].range, (20.0, 30.0));
        assert!(strengths(&rows).is_none() && lengths(&rows).is_none(), "one strength, or length, is no curve");
        let fainter = Reading { asked_db: 52.0, ..row("a", "h264 23", 9.0) };
        let curve = strengths(&[rows[0].clone(), fainter]).expect("two strengths").charts.remove(0).series.remove(1);
        assert_eq!(curve.points.iter().map(|point| point.y).collect::<Vec<_>>(), [30.0, 9.0]);
        let mixed = Reading { leak: "min 3".to_owned(), contributed: 3, named: 2, ..row("a", "h264 23", 9.0) };
        assert_eq!(mixtures(&[mixed]).expect("a mixture").tables[0].rows, [["min", "9.0; 2 of 3", ""]]);
        assert!(mixtures(&rows).is_none() && films(&[]).is_none());
    }
}
