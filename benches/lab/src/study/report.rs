//! What people read of a study: one page, one picture, and all of it as JSON.

use std::path::{Path, PathBuf};

use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::error::EngineError;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde::Serialize;

use super::found::Found;
use super::summary::Findings;
use super::table::Table;
use crate::chart::Chart;

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

/// The whole as JSON.
#[derive(Serialize)]
struct Printed<'a> {
    command: &'a str,
    #[serde(flatten)]
    report: &'a Report,
    readings: &'a [Found],
}

const STYLE: &str = "body{font-family:sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;line-height:1.45}\
table{border-collapse:collapse;margin:.6em 0 1.6em}td,th{border:1px solid #ccc;padding:.25em .6em;text-align:left}\
th{background:#f3f3f3}code{background:#f3f3f3}svg{max-width:100%;height:auto}";

/// What holds for every figure.
const RULES: &str = "Every figure is read from decoded 8-bit frames of views and times that training never saw; seeds \
differ in key, message, views, times and noise. A clip's bits come from its mean logits. Shares of bits in unmarked \
clips should be 50 %; in brackets how many embeddings keep to the two-sided 99 % band of as many coin flips (bits of \
one scene and key depend on one another, so chance leaves that band more often than that). Ranges are least and \
greatest over scenes and seeds. PSNR is of marked 8-bit frames against clean float renders, mean over views.";

impl Report {
    /// Writes `NAME.json`, `.svg` and `.html`; says where the page is.
    ///
    /// # Errors
    /// When they cannot be written.
    pub(super) fn write(
        &self,
        out: &Path,
        name: &str,
        findings: &Findings,
        command: &str,
    ) -> Result<PathBuf, EngineError> {
        let printed = Printed { command, report: self, readings: findings.rows() };
        let json = serde_json::to_string_pretty(&printed).expect("numbers and words are valid JSON");
        let charts: Vec<String> = self.charts.iter().map(Chart::svg).collect();
        let html = self.page(command, &charts, findings.rows()).into_string();
        let page = out.join(format!("{name}.html"));
        for (path, text) in [
            (&out.join(format!("{name}.json")), &json),
            (&out.join(format!("{name}.svg")), charts.first().unwrap_or(&String::new())),
            (&page, &html),
        ] {
            AtomicFile::write(path, Existing::Replace, text.as_bytes())?;
        }
        Ok(page)
    }

    /// One page that needs no other file; `charts` are pictures as SVG.
    fn page(&self, command: &str, charts: &[String], found: &[Found]) -> Markup {
        let told = found.iter().map(|found| &found.row).filter(|row| !row.device.is_empty());
        let mut devices: Vec<String> = told.map(|row| format!("{}; version {}", row.device, row.version)).collect();
        devices.dedup();
        html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    h1 { (self.title) }
                    p { (self.intro) }
                    p { (RULES) }
                    p { code { (command) } br; (devices.join("; ")) }
                    @for chart in charts { (PreEscaped(chart)) }
                    @for table in &self.tables { (table) }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_data_are_no_markup() {
        let words = || "<b>&\"".to_owned();
        let table = Table { title: words(), note: words(), head: vec![words()], rows: vec![vec![words()]] };
        let report = Report { title: words(), intro: words(), charts: Vec::new(), tables: vec![table] };
        let page = report.page(&words(), &["<svg></svg>".to_owned()], &[]).into_string();
        assert!(!page.contains("<b>") && page.contains("<td>&lt;b&gt;&amp;&quot;</td>"), "{page}");
        assert!(page.contains("<svg></svg>") && page.contains("td,th{"), "pictures and style are themselves: {page}");
    }
}
