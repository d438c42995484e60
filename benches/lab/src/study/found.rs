//! Rows under the names of their arms, as reports leave them.

use std::path::Path;

use csv::StringRecord;
use guard4d_engine::base::files::{bad_data, read_file};
use guard4d_engine::base::ledger::{self, Head};
use guard4d_engine::error::EngineError;
use serde::Serialize;

use super::row::Row;

/// Name of the column in front of those of [`Row`].
const ARM: &str = "arm";
/// Name of a column that tells sub-studies apart where the rows of several were put into one file.
const PART: &str = "part";

/// One row under the name of its arm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Found {
    pub(super) arm: String,
    #[serde(flatten)]
    pub(super) row: Row,
}

impl Found {
    /// Rows as CSV, arms first.
    ///
    /// # Errors
    /// None that rows can cause; [`EngineError::Io`] otherwise.
    pub(super) fn to_csv(found: &[Self]) -> Result<String, EngineError> {
        let io = |error: csv::Error| EngineError::Io { path: "rows of a study".into(), source: error.into() };
        let rows: Vec<&Row> = found.iter().map(|found| &found.row).collect();
        let csv = ledger::lines(&rows, Head::With)?;
        let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(csv.as_bytes());
        let mut writer = csv::Writer::from_writer(Vec::new());
        let arms = std::iter::once(ARM).chain(found.iter().map(|found| found.arm.as_str()));
        for (record, arm) in reader.records().zip(arms) {
            let record = record.map_err(io)?;
            writer.write_record(std::iter::once(arm).chain(&record)).map_err(io)?;
        }
        let bytes = writer.into_inner().map_err(|error| io(error.into_error().into()))?;
        Ok(String::from_utf8(bytes).expect("made of strings"))
    }

    /// Reads what [`Self::to_csv`] wrote; where a column `part` tells sub-studies apart, the rows of the one named
    /// `part`. Figures that an older version did not have are such as were not measured.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] without the file, [`EngineError::BadData`] when a row is not one of a study, or
    /// there is none.
    pub(super) fn read_csv(path: &Path, part: &str) -> Result<Vec<Self>, EngineError> {
        let table = Table::read(path)?;
        let Some(arm) = table.column(ARM) else {
            return Err(bad_data(path, "columns", "none of them", format!("`{ARM}`")));
        };
        let of_part = table.records.iter().filter(|record| table.is_of(record, part));
        let row = |record: &StringRecord| {
            let row = record.deserialize(Some(&table.head)).map_err(|error| bad_rows(path, error))?;
            Ok(Self { arm: record[arm].to_owned(), row })
        };
        let found = of_part.map(row).collect::<Result<Vec<_>, EngineError>>()?;
        if found.is_empty() {
            Err(bad_data(path, "rows", format!("none of `{part}`"), "one at least"))
        } else {
            Ok(found)
        }
    }

    /// Of which of `parts` a file has rows: of all without a column that tells, and of none without arms.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] without the file, [`EngineError::BadData`] when it is no table.
    pub(super) fn parts_in<P>(path: &Path, parts: Vec<P>, name: impl Fn(&P) -> &str) -> Result<Vec<P>, EngineError> {
        let table = Table::read(path)?;
        let has = |part: &P| table.records.iter().any(|record| table.is_of(record, name(part)));
        Ok(parts.into_iter().filter(|part| table.column(ARM).is_some() && has(part)).collect())
    }
}

/// A CSV file.
struct Table {
    head: StringRecord,
    records: Vec<StringRecord>,
}

impl Table {
    fn read(path: &Path) -> Result<Self, EngineError> {
        let bytes = read_file(path, "the rows of a study, as it writes them")?;
        let bad = |error| bad_rows(path, error);
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        let head = reader.headers().map_err(bad)?.clone();
        Ok(Self { head, records: reader.records().collect::<Result<_, _>>().map_err(bad)? })
    }

    fn column(&self, wanted: &str) -> Option<usize> {
        self.head.iter().position(|name| name == wanted)
    }

    fn is_of(&self, record: &StringRecord, part: &str) -> bool {
        self.column(PART).is_none_or(|place| &record[place] == part)
    }
}

fn bad_rows(path: &Path, error: csv::Error) -> EngineError {
    bad_data(path, "rows", error, "the columns of this version")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_as_they_were() {
        let row =
            Row { scene: "a, \"b\"".to_owned(), marked: Some(0.1), psnr_db: Some(f64::INFINITY), ..Row::default() };
        let found = [Found { arm: "one, two".to_owned(), row }, Found { arm: String::new(), row: Row::default() }];
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("part.csv");
        let csv = Found::to_csv(&found).expect("rows are flat");
        assert!(csv.starts_with("arm,embedding,take,"), "{csv}");
        std::fs::write(&path, &csv).expect("writable");
        assert_eq!(Found::read_csv(&path, "fit").expect("just written"), found, "{csv}");
        let parts = ["part", "fit", "pareto"].iter().zip(csv.lines()).map(|(part, line)| format!("{part},{line}\n"));
        std::fs::write(&path, parts.collect::<String>()).expect("writable");
        assert_eq!(Found::read_csv(&path, "fit").expect("rows of two parts"), found[..1], "those of one");
        let of = |parts: [&'static str; 2]| Found::parts_in(&path, parts.to_vec(), |part| part).expect("a table");
        assert_eq!(of(["attacks", "pareto"]), ["pareto"], "of one of them");
        let refused = Found::read_csv(&path, "attacks").expect_err("rows of others").to_string();
        assert!(refused.contains("part.csv") && refused.contains("none of `attacks`"), "{refused}");
        std::fs::write(&path, csv.replacen("arm,", "leg,", 1)).expect("writable");
        let refused = Found::read_csv(&path, "fit").expect_err("no arms").to_string();
        assert!(refused.contains("part.csv") && refused.contains("`arm`"), "{refused}");
        assert!(of(["fit", "pareto"]).is_empty(), "no table of a study");
        std::fs::write(&path, csv.replacen(",seed,", ",sede,", 1)).expect("writable");
        let refused = Found::read_csv(&path, "fit").expect_err("another version").to_string();
        assert!(refused.contains("seed"), "{refused}");
    }
}
