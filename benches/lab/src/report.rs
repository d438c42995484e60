//! What people read of measurements: one page, one picture, and all of it as JSON.

use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::error::EngineError;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde::Serialize;
use serde_json::Value;

use crate::chart::Chart;
use crate::table::Table;

/// All that is said of what was measured together.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Heading.
    pub title: String,
    /// What was done.
    pub intro: String,
    /// Charts; the first is the picture of it all.
    pub charts: Vec<Chart>,
    /// Tables.
    pub tables: Vec<Table>,
}

/// A picture and what it shows.
#[derive(Clone, Debug)]
pub struct Pictured {
    /// In words.
    pub caption: String,
    /// The file.
    pub png: Vec<u8>,
}

/// The whole as JSON.
#[derive(Serialize)]
struct Printed<'a> {
    command: &'a str,
    #[serde(flatten)]
    report: &'a Report,
    readings: &'a Value,
}

const STYLE: &str = "body{font-family:sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;line-height:1.45}\
table{border-collapse:collapse;margin:.6em 0 1.6em}td,th{border:1px solid #ccc;padding:.25em .6em;text-align:left}\
th{background:#f3f3f3}code{background:#f3f3f3}svg,img{max-width:100%;height:auto}figure{margin:1em 0}";

/// Where figures come from.
#[derive(Clone, Debug)]
pub struct Origin<'a> {
    /// What was typed.
    pub command: &'a str,
    /// What holds for every figure.
    pub rules: &'a str,
    /// On what they were measured.
    pub devices: Vec<String>,
    /// All of them.
    pub readings: Value,
}

impl Report {
    /// Writes `NAME.json`, `.svg` and `.html`; says where the page is.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn write(&self, out: &Path, name: &str, origin: &Origin<'_>) -> Result<PathBuf, EngineError> {
        self.write_illustrated(out, name, origin, &[])
    }

    /// The same, with pictures at the end of the page.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn write_illustrated(
        &self,
        out: &Path,
        name: &str,
        origin: &Origin<'_>,
        pictures: &[Pictured],
    ) -> Result<PathBuf, EngineError> {
        let printed = Printed { command: origin.command, report: self, readings: &origin.readings };
        let json = serde_json::to_string_pretty(&printed).expect("numbers and words are valid JSON");
        let charts: Vec<String> = self.charts.iter().map(Chart::svg).collect();
        let html = self.page(origin, &charts, pictures).into_string();
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
    fn page(&self, origin: &Origin<'_>, charts: &[String], pictures: &[Pictured]) -> Markup {
        let Origin { command, rules, devices, .. } = origin;
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
                    p { (rules) }
                    p { code { (command) } br; (devices.join("; ")) }
                    @for chart in charts { (PreEscaped(chart)) }
                    @for table in &self.tables { (table) }
                    @for Pictured { caption, png } in pictures {
                        figure {
                            img src={ "data:image/png;base64," (BASE64_STANDARD.encode(png)) } alt=(caption);
                            figcaption { (caption) }
                        }
                    }
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
        let origin = Origin { command: &words(), rules: &words(), devices: vec![words()], readings: Value::Null };
        let page = report
            .page(&origin, &["<svg></svg>".to_owned()], &[Pictured { caption: words(), png: vec![1] }])
            .into_string();
        assert!(!page.contains("<b>") && page.contains("<td>&lt;b&gt;&amp;&quot;</td>"), "{page}");
        assert!(page.contains("src=\"data:image/png;base64,AQ==\""), "{page}");
        assert!(page.contains("<svg></svg>") && page.contains("td,th{"), "pictures and style are themselves: {page}");
    }
}
