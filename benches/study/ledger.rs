//! Rows that outlast a broken-off run: a tab-separated file that grows by one line per measurement.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use guard4d_engine::EngineError;
use guard4d_engine::output::{AtomicFile, Existing};

/// One line, cell by cell in the order of the columns.
pub(crate) type Row = Vec<String>;

/// The file and what it holds.
#[derive(Debug)]
pub(crate) struct Ledger {
    path: PathBuf,
    columns: Vec<String>,
    rows: Vec<Row>,
}

impl Ledger {
    /// Opens or creates a file with these columns. A last line that was cut off is dropped.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when an existing file has other columns; [`EngineError::Io`].
    pub(crate) fn open(path: &Path, columns: Vec<String>) -> Result<Self, EngineError> {
        let text = match fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(source) => return Err(EngineError::Io { path: path.to_owned(), source }),
        };
        let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
        let head = line(&columns);
        let body = match whole.strip_prefix(&head) {
            Some(body) => body,
            None if whole.is_empty() && head.starts_with(&text) => "",
            None => return Err(Self::unlike(path, text.lines().next().unwrap_or_default())),
        };
        let rows: Vec<Row> = body.lines().map(|l| l.split('\t').map(str::to_owned).collect()).collect();
        if let Some(row) = rows.iter().find(|row| row.len() != columns.len()) {
            return Err(Self::unlike(path, &format!("a row of {} cells", row.len())));
        }
        if text.len() != head.len() + body.len() {
            AtomicFile::write(path, Existing::Replace, format!("{head}{body}").as_bytes())?;
        }
        Ok(Self { path: path.to_owned(), columns, rows })
    }

    fn unlike(path: &Path, got: &str) -> EngineError {
        EngineError::BadData {
            path: path.to_owned(),
            field: "columns".to_owned(),
            got: got.chars().take(80).collect(),
            expected: "the columns of this version, or another --out".to_owned(),
        }
    }

    /// Adds a row, on disk before it returns.
    ///
    /// # Errors
    /// [`EngineError::Io`] naming the file.
    pub(crate) fn append(&mut self, row: Row) -> Result<(), EngineError> {
        assert_eq!(row.len(), self.columns.len(), "one cell per column");
        let row: Row = row.into_iter().map(|cell| cell.replace(['\t', '\n'], " ")).collect();
        let written = fs::OpenOptions::new().append(true).open(&self.path).and_then(|mut file| {
            file.write_all(line(&row).as_bytes())?;
            file.sync_data()
        });
        written.map_err(|source| EngineError::Io { path: self.path.clone(), source })?;
        self.rows.push(row);
        Ok(())
    }

    /// Cell of a row by the column's name.
    pub(crate) fn cell<'a>(&self, row: &'a Row, column: &str) -> &'a str {
        let index = self.columns.iter().position(|c| c == column);
        &row[index.expect("columns are asked for by the names they were made with")]
    }

    /// Cell as a number, if it is one.
    pub(crate) fn number(&self, row: &Row, column: &str) -> Option<f64> {
        self.cell(row, column).parse().ok()
    }

    /// The newest row with all these cells.
    pub(crate) fn find(&self, cells: &[(&str, String)]) -> Option<&Row> {
        self.rows.iter().rev().find(|row| cells.iter().all(|(column, cell)| self.cell(row, column) == cell))
    }

    /// The newest row of each combination of `columns`, in the order in which combinations first appeared.
    pub(crate) fn newest(&self, columns: &[&str]) -> Vec<&Row> {
        let key = |row: &Row| columns.iter().map(|c| self.cell(row, c).to_owned()).collect::<Vec<_>>();
        let mut newest: Vec<&Row> = Vec::new();
        for row in &self.rows {
            match newest.iter_mut().find(|seen| key(seen) == key(row)) {
                Some(seen) => *seen = row,
                None => newest.push(row),
            }
        }
        newest
    }
}

fn line(cells: &[String]) -> String {
    format!("{}\n", cells.join("\t"))
}
