//! Who gets a copy: names that are safe as names of files, from the command line or a table.

use std::collections::HashMap;
use std::fmt;
use std::path::Path;

use crate::base::files::{bad_data, read_file};
use crate::error::EngineError;

/// Most bytes of a name: file systems allow 255, and partial outputs and extensions need some.
const LONGEST: usize = 100;
/// What no name has in it: places, and what Windows refuses.
const FORBIDDEN: [char; 9] = ['/', '\\', ':', '*', '?', '"', '<', '>', '|'];
/// The column of a table that holds names.
const COLUMN: &str = "recipient";

/// A recipient's name. Names that differ in upper and lower case alone are one: some file systems know no difference.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recipient(String);

impl fmt::Display for Recipient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Recipient {
    /// Checks a name.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for one that cannot be a file's, such as a path.
    pub fn new(name: &str) -> Result<Self, EngineError> {
        let is_plain = !name.contains(|c: char| c.is_control() || FORBIDDEN.contains(&c));
        let is_whole = !name.starts_with(['.', '-', ' ']) && !name.ends_with(['.', ' ']);
        if !name.is_empty() && name.len() <= LONGEST && is_plain && is_whole {
            return Ok(Self(name.to_owned()));
        }
        Err(EngineError::Usage {
            what: "recipient".to_owned(),
            got: format!("{name:?}"),
            expected: format!("a name of 1 to {LONGEST} bytes that a file can have, without a path in it"),
        })
    }

    /// The name as it was given.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// What names that are one have in common.
    #[must_use]
    pub fn folded(&self) -> String {
        self.0.to_lowercase()
    }
}

/// Checks names, and that each is there once.
///
/// # Errors
/// [`EngineError::Usage`] naming the one that is wrong.
pub fn parse_list<'a>(names: impl IntoIterator<Item = &'a str>) -> Result<Vec<Recipient>, EngineError> {
    let mut places: HashMap<String, usize> = HashMap::new();
    let mut recipients = Vec::new();
    for name in names {
        let recipient = Recipient::new(name.trim())?;
        let place = recipients.len() + 1;
        if let Some(first) = places.insert(recipient.folded(), place) {
            return Err(EngineError::Usage {
                what: "recipients".to_owned(),
                got: format!("{recipient} twice, as number {first} and {place}"),
                expected: "each once".to_owned(),
            });
        }
        recipients.push(recipient);
    }
    Ok(recipients)
}

/// The names of a table where one is given, otherwise `names`.
///
/// # Errors
/// Those of [`read_table`] and [`parse_list`].
pub fn read(table: Option<&Path>, names: &[String]) -> Result<Vec<Recipient>, EngineError> {
    table.map_or_else(|| parse_list(names.iter().map(String::as_str)), read_table)
}

/// Reads the names of a CSV file, from its column `recipient`; other columns are left alone.
///
/// # Errors
/// [`EngineError::MissingInput`], [`EngineError::Io`]; [`EngineError::BadData`] naming the line.
pub fn read_table(path: &Path) -> Result<Vec<Recipient>, EngineError> {
    let bytes = read_file(path, "a table of recipients")?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes.as_slice());
    let expected = format!("CSV with a column {COLUMN}");
    let head = reader.headers().map_err(|error| bad_data(path, "csv", error, &expected))?;
    let Some(column) = head.iter().position(|name| name == COLUMN) else {
        let found = head.iter().collect::<Vec<_>>().join(",");
        return Err(bad_data(path, "columns", found, expected));
    };
    let lines = reader.records().map(|line| line.map(|line| line.get(column).unwrap_or_default().to_owned()));
    let names = lines.collect::<Result<Vec<_>, _>>().map_err(|error| bad_data(path, "csv", error, &expected))?;
    if names.is_empty() {
        return Err(bad_data(path, COLUMN, "no line", "at least one name"));
    }
    parse_list(names.iter().map(String::as_str)).map_err(|error| match error {
        EngineError::Usage { got, expected, .. } => bad_data(path, COLUMN, got, expected),
        other => other,
    })
}
