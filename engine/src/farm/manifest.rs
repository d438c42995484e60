//! The list of what is to be done: a row for each job, as CSV or as JSON lines.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fmt::Display;
use std::path::{Component, Path, PathBuf};

use serde_json::Value;

use crate::base::digest::Digest;
use crate::base::files::{bad_data, read_file};
use crate::error::EngineError;

/// Columns that are not settings of a job.
const OWN_COLUMNS: [&str; 5] = ["id", "job", "input", "output", "cost"];
/// Longest id, in bytes: it is part of names of files.
const MAX_ID: usize = 100;

/// Rows, and the file that they stand in.
#[derive(Debug)]
pub struct Manifest {
    path: PathBuf,
    rows: Vec<Row>,
}

/// One job.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Line of the file, from 1.
    pub line: usize,
    /// Name that no other row has.
    pub id: String,
    /// What is done: the name of a command.
    pub job: String,
    /// What it is done to; empty where a job takes nothing. Relative to the manifest.
    pub input: String,
    /// File or folder that is made. Relative to the manifest.
    pub output: String,
    /// Other columns that have a value, by name.
    pub columns: BTreeMap<String, String>,
    /// How long it takes, in a unit that all rows share; longer rows are taken first.
    pub cost: f64,
    /// Rows whose output this one reads, by their places in the manifest, ascending.
    pub needs: Vec<usize>,
    /// The one of these that makes the input.
    pub source: Option<usize>,
    /// 0 for a row that needs none, else one more than the latest that it needs.
    pub stage: usize,
}

impl Manifest {
    /// Reads a `.csv` file, whose first line names the columns, or a `.jsonl` file, an object for each line. Columns
    /// are `id`, `job`, `output`, and where they are needed `input` and `cost`; all others are for the job.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming line and column; those of reading a file.
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        let expected = "a manifest: .csv or .jsonl";
        let bytes = read_file(path, expected)?;
        let text =
            String::from_utf8(bytes).map_err(|_| bad_data(path, "text", "bytes that are not UTF-8", expected))?;
        let cells = match path.extension().and_then(|end| end.to_str()) {
            Some("csv") => csv_cells(path, &text)?,
            Some("jsonl") => json_cells(path, &text)?,
            _ => return Err(bad_data(path, "name", "another ending", expected)),
        };
        let mut rows = Vec::with_capacity(cells.len());
        for (line, cells) in cells {
            rows.push(row(path, line, cells)?);
        }
        check_names(path, &rows)?;
        find_needs(path, &mut rows)?;
        Ok(Self { path: path.to_path_buf(), rows })
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Folder that paths in the rows are relative to.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
    }

    /// Folder for the records and claims of all workers: `jobs.farm` beside `jobs.csv`.
    #[must_use]
    pub fn state(&self) -> PathBuf {
        self.path.with_extension("farm")
    }

    /// All rows, in the order of the file.
    #[must_use]
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }
}

impl Row {
    /// Hash of everything that says what is done: job, paths and settings. Its id and cost are no part of it.
    #[must_use]
    pub fn settings_hash(&self) -> Digest {
        let Self { job, input, output, columns, .. } = self;
        let text = serde_json::to_vec(&(job, input, output, columns)).expect("texts are JSON");
        Digest::of(&text)
    }
}

/// Cells of a line that have a value.
#[derive(Default)]
struct Cells {
    /// Of [`OWN_COLUMNS`].
    own: [String; 5],
    others: BTreeMap<String, String>,
}

impl Cells {
    fn put(&mut self, column: &str, value: &str) {
        match OWN_COLUMNS.iter().position(|own| *own == column) {
            Some(at) => value.clone_into(&mut self.own[at]),
            None => _ = self.others.insert(column.to_owned(), value.to_owned()),
        }
    }
}

fn csv_cells(path: &Path, text: &str) -> Result<Vec<(usize, Cells)>, EngineError> {
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(text.as_bytes());
    let bad = |error: csv::Error| {
        let line = error.position().map_or(1, csv::Position::line);
        bad_data(path, format!("line {line}"), error, "as many cells as the first line has columns")
    };
    let head: Vec<String> = reader.headers().map_err(bad)?.iter().map(str::to_owned).collect();
    if let Some(twice) = head.iter().enumerate().find(|(i, name)| head[..*i].contains(name)).map(|(_, name)| name) {
        return Err(bad_data(path, "columns", format!("`{twice}` twice"), "each column once"));
    }
    let mut found = Vec::new();
    for record in reader.records() {
        let record = record.map_err(bad)?;
        let line = record.position().map_or(0, csv::Position::line);
        let mut cells = Cells::default();
        head.iter().zip(&record).filter(|(_, cell)| !cell.is_empty()).for_each(|(name, cell)| cells.put(name, cell));
        found.push((usize::try_from(line).unwrap_or(usize::MAX), cells));
    }
    Ok(found)
}

fn json_cells(path: &Path, text: &str) -> Result<Vec<(usize, Cells)>, EngineError> {
    let mut found = Vec::new();
    for (line, object) in (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty()) {
        let bad = |got: &dyn Display| {
            bad_data(path, format!("line {line}"), got, "an object of texts, numbers, true and false")
        };
        let object: serde_json::Map<String, Value> = serde_json::from_str(object).map_err(|error| bad(&error))?;
        let mut cells = Cells::default();
        for (name, value) in object {
            let text = match value {
                Value::Null => continue,
                Value::String(text) => text,
                Value::Number(number) => number.to_string(),
                Value::Bool(answer) => answer.to_string(),
                Value::Array(_) | Value::Object(_) => return Err(bad(&format!("a list or an object for `{name}`"))),
            };
            cells.put(&name, &text);
        }
        found.push((line, cells));
    }
    Ok(found)
}

fn row(path: &Path, line: usize, cells: Cells) -> Result<Row, EngineError> {
    let field = |name: &str| format!("line {line}: {name}");
    let Cells { own: [id, job, input, output, cost], others: columns } = cells;
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    if id.is_empty() || id.len() > MAX_ID || id.starts_with('.') || !id.chars().all(is_plain) {
        let expected = format!("1 to {MAX_ID} letters, digits, `-`, `_` and `.`, the first not `.`");
        return Err(bad_data(path, field("id"), format!("`{id}`"), expected));
    }
    for (name, value) in [("job", &job), ("output", &output)] {
        if value.is_empty() {
            return Err(bad_data(path, field(name), "nothing", "a value in every row"));
        }
    }
    let cost = match cost.as_str() {
        "" => 1.0,
        text => match text.parse::<f64>() {
            Ok(cost) if cost.is_finite() && cost >= 0.0 => cost,
            _ => return Err(bad_data(path, field("cost"), format!("`{text}`"), "a number that is not negative")),
        },
    };
    Ok(Row { line, id, job, input, output, columns, cost, needs: Vec::new(), source: None, stage: 0 })
}

/// Each id and each output stands in one row.
fn check_names(path: &Path, rows: &[Row]) -> Result<(), EngineError> {
    let (mut ids, mut outputs) = (HashMap::new(), HashMap::new());
    for Row { line, id, output, .. } in rows {
        if let Some(first) = ids.insert(id, line) {
            return Err(bad_data(path, format!("line {line}: id"), format!("`{id}`, as in line {first}"), "another"));
        }
        if let Some(first) = outputs.insert(plain(output), line) {
            let got = format!("`{output}`, as in line {first}");
            return Err(bad_data(path, format!("line {line}: output"), got, "another"));
        }
    }
    Ok(())
}

/// Which rows read what others write: a path of theirs is an output, or lies in one.
fn find_needs(path: &Path, rows: &mut [Row]) -> Result<(), EngineError> {
    let outputs: HashMap<String, usize> =
        rows.iter().enumerate().map(|(place, row)| (plain(&row.output).into_owned(), place)).collect();
    for (place, row) in rows.iter_mut().enumerate() {
        let maker = |path: &String| {
            let path = plain(path);
            let above = std::iter::successors(Some(&*path), |path| path.rfind('/').map(|end| &path[..end]));
            above.into_iter().find_map(|above| outputs.get(above)).copied()
        };
        row.source = Some(&row.input).filter(|input| !input.is_empty()).and_then(maker);
        row.needs = row.source.into_iter().chain(row.columns.values().filter_map(maker)).collect();
        row.needs.sort_unstable();
        row.needs.dedup();
        if row.needs.contains(&place) {
            let got = format!("`{}`, which it reads itself", row.output);
            return Err(bad_data(path, format!("line {}: output", row.line), got, "a place of its own"));
        }
    }
    set_stages(rows).map_or(Ok(()), |place| {
        let Row { line, id, .. } = &rows[place];
        let got = format!("row `{id}` waits for itself, through rows that read what others write");
        Err(bad_data(path, format!("line {line}"), got, "rows in an order"))
    })
}

/// Gives each row its stage. The place of one that waits for itself, if there is one: those are left over when rows
/// that wait for none are taken away.
fn set_stages(rows: &mut [Row]) -> Option<usize> {
    let mut waits: Vec<usize> = rows.iter().map(|row| row.needs.len()).collect();
    let mut readers = vec![Vec::new(); rows.len()];
    for (place, row) in rows.iter().enumerate() {
        row.needs.iter().for_each(|need| readers[*need].push(place));
    }
    let mut free: Vec<usize> = (0..rows.len()).filter(|place| waits[*place] == 0).collect();
    while let Some(place) = free.pop() {
        let next = rows[place].stage + 1;
        for &reader in &readers[place] {
            rows[reader].stage = rows[reader].stage.max(next);
            waits[reader] -= 1;
            if waits[reader] == 0 {
                free.push(reader);
            }
        }
    }
    waits.iter().position(|waits| *waits > 0)
}

/// A path without `.`, doubled slashes and, as far as it can be told from the path alone, `..`.
fn plain(path: &str) -> Cow<'_, str> {
    // As nearly all are.
    let is_plain = |path: &str| path.split('/').all(|part| !matches!(part, "" | "." | ".."));
    if is_plain(path.strip_prefix('/').unwrap_or(path)) {
        return Cow::Borrowed(path);
    }
    let mut plain = PathBuf::new();
    for part in Path::new(path).components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if matches!(plain.components().next_back(), Some(Component::Normal(_))) => {
                plain.pop();
            }
            part => plain.push(part),
        }
    }
    Cow::Owned(plain.to_string_lossy().into_owned())
}
