//! What people read of a study: one page, one picture, and the figures as CSV and JSON.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::chart::Chart;
use super::row::Row;
use super::summary::{Findings, Found};
use super::svg::escaped;
use super::table::Table;
use crate::error::EngineError;
use crate::output::{AtomicFile, Existing};

/// All that is said of a sub-study.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Heading.
    pub title: String,
    /// What was done.
    pub intro: String,
    /// Charts; the first is the picture of the sub-study.
    pub charts: Vec<Chart>,
    /// Tables.
    pub tables: Vec<Table>,
}

/// One row with the name of its arm, as files have it.
#[derive(Serialize)]
struct Named<'a> {
    arm: &'a str,
    #[serde(flatten)]
    row: &'a Row,
}

/// The whole as JSON.
#[derive(Serialize)]
struct Printed<'a> {
    command: &'a str,
    #[serde(flatten)]
    report: &'a Report,
    readings: Vec<Named<'a>>,
}

const STYLE: &str = "body{font-family:sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;line-height:1.45}\
table{border-collapse:collapse;margin:.6em 0 1.6em}td,th{border:1px solid #ccc;padding:.25em .6em;text-align:left}\
th{background:#f3f3f3}code{background:#f3f3f3}svg{max-width:100%}";

/// What holds for every figure.
const RULES: &str = "Every figure is read from decoded 8-bit frames of views and times that training never saw; seeds differ \
in key, message, views, times and noise. A clip's bits come from its mean logits. Shares of bits in unmarked clips \
should be 50 %; in brackets how many embeddings keep to the two-sided 99 % band of as many coin flips (bits of one scene and \
key depend on one another, so chance leaves that band more often than that). Ranges are least and greatest over scenes \
and seeds. PSNR is of marked 8-bit frames against clean float renders, mean over views.";

impl Report {
    /// Writes `NAME.csv`, `.json`, `.svg` and `.html`; says where the page is.
    pub(super) fn write(
        &self,
        out: &Path,
        name: &str,
        (findings, command): (&Findings, &str),
    ) -> Result<PathBuf, EngineError> {
        let named: Vec<Named<'_>> = findings.rows().map(|Found { arm, row }| Named { arm, row }).collect();
        let arms: Vec<&str> = named.iter().map(|named| named.arm).collect();
        let rows: Vec<Row> = named.iter().map(|named| named.row.clone()).collect();
        let csv = with_arms(&Row::csv(&rows, true)?, &arms)?;
        let printed = Printed { command, report: self, readings: named };
        let json = serde_json::to_string_pretty(&printed).expect("numbers and words are valid JSON");
        let svg = self.charts.first().map(Chart::svg).unwrap_or_default();
        let page = super::page(out, name);
        for (path, text) in [
            (out.join(format!("{name}.csv")), csv),
            (out.join(format!("{name}.json")), json),
            (out.join(format!("{name}.svg")), svg),
            (page.clone(), self.html(command, &rows)),
        ] {
            AtomicFile::write(&path, Existing::Replace, text.as_bytes())?;
        }
        Ok(page)
    }

    /// One page that needs no other file.
    fn html(&self, command: &str, rows: &[Row]) -> String {
        let title = escaped(&self.title);
        let mut devices: Vec<String> =
            rows.iter().map(|row| format!("{}; version {}", row.device, row.version)).collect();
        devices.dedup();
        let mut out = format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\n\
             <style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n<p>{}</p>\n<p>{}</p>\n\
             <p><code>{}</code><br>{}</p>\n",
            escaped(&self.intro),
            escaped(RULES),
            escaped(command),
            escaped(&devices.join("; ")),
        );
        self.charts.iter().for_each(|chart| out.push_str(&chart.svg()));
        self.tables.iter().for_each(|table| table.html(&mut out));
        out.push_str("</body></html>\n");
        out
    }
}

/// CSV with one more column in front.
fn with_arms(csv: &str, arms: &[&str]) -> Result<String, EngineError> {
    let io = |error: csv::Error| EngineError::Io { path: "rows of a study".into(), source: error.into() };
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(csv.as_bytes());
    let mut writer = csv::Writer::from_writer(Vec::new());
    for (record, arm) in reader.records().zip(std::iter::once(&"arm").chain(arms)) {
        let record = record.map_err(io)?;
        writer.write_record(std::iter::once(*arm).chain(&record)).map_err(io)?;
    }
    let bytes = writer.into_inner().map_err(|error| io(error.into_error().into()))?;
    Ok(String::from_utf8(bytes).expect("made of strings"))
}
