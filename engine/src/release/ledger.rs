//! Who got which copy: the private ledger of one issue, a SQLite file.
//!
//! It is a secret: who has it can stamp copies in anybody's name. A number is written down before its copy is, so that
//! nothing is ever stamped that the ledger does not know.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rusqlite::{
    Connection, ErrorCode, OpenFlags, OptionalExtension as _, Row, Transaction, TransactionBehavior, params,
};
use serde::{Deserialize, Serialize};

use super::recipients::{Recipient, parse_list};
use crate::base::digest::Digest;
use crate::base::files::{bad_data, read_file};
use crate::base::output::{AtomicFile, Existing};
use crate::base::prf::{MasterSecret, Prf};
use crate::error::EngineError;

/// Version of the tables, SQLite's `user_version`; its `application_id` says that they are these ("g4dL").
const VERSION: i64 = 1;
const APPLICATION: i64 = 0x6734_644c;
/// How long another process may hold the file: stamping holds it for milliseconds.
const PATIENCE: Duration = Duration::from_secs(5);

const TABLES: &str = "
CREATE TABLE issue (
    one INTEGER PRIMARY KEY CHECK (one = 1), secret BLOB NOT NULL, original TEXT NOT NULL, splats INTEGER NOT NULL,
    strength REAL NOT NULL, psnr_db REAL NOT NULL, receipt TEXT, made_unix_s INTEGER NOT NULL
);
CREATE TABLE copies (
    number INTEGER PRIMARY KEY, recipient TEXT NOT NULL, folded TEXT NOT NULL UNIQUE, reserved_unix_s INTEGER NOT NULL,
    hash TEXT, stamped_unix_s INTEGER
);
CREATE INDEX copies_by_hash ON copies (hash);
";

/// What all copies of an issue have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Terms {
    /// What the code and all chips follow from.
    pub secret: MasterSecret,
    /// Hash of the unstamped asset.
    pub original: Digest,
    /// How many splats it has.
    pub splats: u64,
    /// What the amplitudes of chips are multiplied by.
    pub strength: f64,
    /// PSNR that was asked for, dB.
    pub psnr_db: f64,
    /// Hash of the receipt of the owner's mark in the asset.
    pub receipt: Option<Digest>,
}

impl Terms {
    /// What the code and all chips follow from, as a function.
    #[must_use]
    pub fn prf(&self) -> Prf {
        Prf::new(&self.secret)
    }
}

/// A copy as the ledger knows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CopyRecord {
    /// Its number, from 1 on.
    pub copy: u64,
    /// Who got it.
    pub recipient: String,
    /// Hash of its splats' files; none while it is only promised.
    pub hash: Option<Digest>,
    /// When its number was taken, seconds since 1970.
    pub reserved_unix_s: u64,
    /// When it was written.
    pub stamped_unix_s: Option<u64>,
}

/// The ledger, open.
#[derive(Debug)]
pub struct Ledger {
    path: PathBuf,
    connection: Connection,
    terms: Terms,
}

impl Ledger {
    /// Makes the ledger of a new issue, which only its owner can read.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] where something is already; [`EngineError::Io`].
    pub fn create(path: &Path, terms: &Terms) -> Result<Self, EngineError> {
        let file = AtomicFile::create_private(path, Existing::Refuse)?;
        let make = || {
            let connection = Connection::open(file.path())?;
            connection.execute_batch(TABLES)?;
            connection.pragma_update(None, "user_version", VERSION)?;
            connection.pragma_update(None, "application_id", APPLICATION)?;
            let Terms { secret, original, splats, strength, psnr_db, receipt } = terms;
            let secret = secret.expose().as_slice();
            let [original, receipt] = [Some(*original), *receipt].map(|hash| hash.map(|hash| hash.to_string()));
            connection.execute(
                "INSERT INTO issue VALUES (1, ?1, ?2, ?3, ?4, ?5, ?6, ?7)",
                params![secret, original, splats, strength, psnr_db, receipt, now()],
            )
        };
        make().map_err(|error| told(path, error))?;
        file.commit()?;
        Self::open(path)
    }

    /// Opens the ledger of an issue.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`]; [`EngineError::BadData`] for what is no such ledger; [`EngineError::Busy`].
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        if !path.is_file() {
            let expected = "a ledger, as `guard4d stamp` makes it".to_owned();
            return Err(EngineError::MissingInput { path: path.to_path_buf(), expected });
        }
        let open = || {
            let connection = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE)?;
            connection.busy_timeout(PATIENCE)?;
            let number = |name: &str| connection.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
            let found = [number("application_id")?, number("user_version")?];
            if found != [APPLICATION, VERSION] {
                return Ok(Err(found));
            }
            connection.pragma_update(None, "journal_mode", "WAL")?;
            connection.pragma_update(None, "synchronous", "FULL")?;
            let terms = connection.query_row(
                "SELECT secret, original, splats, strength, psnr_db, receipt FROM issue",
                [],
                terms_of,
            )?;
            Ok(Ok(Self { path: path.to_path_buf(), connection, terms }))
        };
        open().map_err(|error| told(path, error))?.map_err(|[application, version]| {
            let got = format!("{version} of application {application}");
            bad_data(path, "version", got, format!("{VERSION}, of a ledger that `guard4d stamp` made"))
        })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What its copies have in common.
    #[must_use]
    pub fn terms(&self) -> &Terms {
        &self.terms
    }

    /// What its code and chips follow from.
    #[must_use]
    pub fn prf(&self) -> Prf {
        self.terms.prf()
    }

    /// Checks that an asset is the one that this issue is of.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming what differs.
    pub fn check_original(&self, original: Digest, splats: usize) -> Result<(), EngineError> {
        let terms = &self.terms;
        if terms.splats != splats as u64 {
            return Err(bad_data(&self.path, "splats of the original", splats, terms.splats));
        }
        if terms.original != original {
            return Err(bad_data(&self.path, "hash of the original", original, terms.original));
        }
        Ok(())
    }

    /// Takes a number for each recipient, or those that were taken and whose copy was never written. All get one, or
    /// none does.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a recipient who has a copy; [`EngineError::Busy`].
    pub fn reserve(&mut self, recipients: &[Recipient]) -> Result<Vec<CopyRecord>, EngineError> {
        let path = self.path.clone();
        let transaction = self.begin()?;
        let mut records = Vec::new();
        for recipient in recipients {
            let record = reserve(&transaction, recipient).map_err(|error| told(&path, error))?;
            if let Some(unix_s) = record.stamped_unix_s {
                let got = format!("{recipient} has copy {}, since {unix_s} (seconds of 1970)", record.copy);
                return Err(bad_data(&path, "recipient", got, "one without a copy, or --again for the same copy"));
            }
            records.push(record);
        }
        transaction.commit().map_err(|error| told(&path, error))?;
        Ok(records)
    }

    /// The copies of these recipients, which were taken or written before; none for who has none.
    ///
    /// # Errors
    /// Those of reading it.
    pub fn of_recipient(&self, recipient: &Recipient) -> Result<Option<CopyRecord>, EngineError> {
        self.one("folded = ?1", &recipient.folded())
    }

    /// The copy of that number.
    ///
    /// # Errors
    /// Those of reading it.
    pub fn of_number(&self, copy: u64) -> Result<Option<CopyRecord>, EngineError> {
        self.one("number = ?1", &copy)
    }

    /// The copy whose splats' files hash to this.
    ///
    /// # Errors
    /// Those of reading it.
    pub fn of_hash(&self, hash: Digest) -> Result<Option<CopyRecord>, EngineError> {
        self.one("hash = ?1", &hash.to_string())
    }

    /// All copies, by number.
    ///
    /// # Errors
    /// Those of reading it.
    pub fn copies(&self) -> Result<Vec<CopyRecord>, EngineError> {
        let all = || {
            let mut asked = self.connection.prepare(&format!("SELECT {COLUMNS} FROM copies ORDER BY number"))?;
            asked.query_map([], record_of)?.collect::<rusqlite::Result<Vec<_>>>()
        };
        all().map_err(|error| told(&self.path, error))
    }

    /// The largest number that was taken; 0 where none was.
    ///
    /// # Errors
    /// Those of reading it.
    pub fn last_number(&self) -> Result<u64, EngineError> {
        let asked = self.connection.query_row("SELECT ifnull(max(number), 0) FROM copies", [], |row| row.get(0));
        asked.map_err(|error| told(&self.path, error))
    }

    /// Writes down that copies are there, in one go.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a number that was not taken, or whose copy was another; [`EngineError::Busy`].
    pub fn stamped(&mut self, hashes: &[CopyHash]) -> Result<(), EngineError> {
        let path = self.path.clone();
        let transaction = self.begin()?;
        for CopyHash { copy, hash } in hashes {
            let hash = hash.to_string();
            let changed = transaction.execute(
                "UPDATE copies SET hash = ?2, stamped_unix_s = ifnull(stamped_unix_s, ?3)
                 WHERE number = ?1 AND ifnull(hash, ?2) = ?2",
                params![copy, hash, now()],
            );
            if changed.map_err(|error| told(&path, error))? != 1 {
                return Err(bad_data(&path, format!("hash of copy {copy}"), hash, "the one that was written down"));
            }
        }
        transaction.commit().map_err(|error| told(&path, error))
    }

    /// Adds what another ledger of the same issue knows.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for one of another issue, and for a number or name that two copies would have; then
    /// nothing is added.
    pub fn merge(&mut self, other: &Self) -> Result<u64, EngineError> {
        if self.terms != other.terms {
            let expected = format!("the issue of {}", self.path.display());
            return Err(bad_data(&other.path, "issue", "another key, original or strength", expected));
        }
        self.add(&other.copies()?, &other.path)
    }

    /// Adds copies that the file at `from` tells of, and says how many were new.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming that file, for a number or name that two copies would have; then nothing is
    /// added.
    pub fn add(&mut self, records: &[CopyRecord], from: &Path) -> Result<u64, EngineError> {
        let path = self.path.clone();
        let transaction = self.begin()?;
        let mut added = 0;
        for record in records {
            added += u64::from(merge(&transaction, record).map_err(|error| match error {
                Unmerged::Database(error) => told(&path, error),
                Unmerged::Clash(known) => {
                    let got = format!("copy {} for {}", record.copy, record.recipient);
                    let expected = format!("copy {} for {}, as here", known.copy, known.recipient);
                    bad_data(from, "copies", got, expected)
                }
            })?);
        }
        transaction.commit().map_err(|error| told(&path, error))?;
        Ok(added)
    }

    /// All copies as CSV.
    ///
    /// # Errors
    /// Those of reading it.
    ///
    /// # Panics
    /// Never: memory takes what is written.
    pub fn csv(&self) -> Result<Vec<u8>, EngineError> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        self.copies()?.iter().for_each(|copy| writer.serialize(copy).expect("memory takes it"));
        Ok(writer.into_inner().expect("memory takes it"))
    }

    /// The copies of a table that [`csv`](Self::csv) wrote.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`]; [`EngineError::BadData`] naming the line; those of
    /// [`parse_list`].
    pub fn read_csv(path: &Path) -> Result<Vec<CopyRecord>, EngineError> {
        let bytes = read_file(path, "a table of copies")?;
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        let expected = "a table as `guard4d ledger export` writes it";
        let records = reader.deserialize().collect::<Result<Vec<CopyRecord>, _>>();
        let records = records.map_err(|error| bad_data(path, "csv", error, expected))?;
        parse_list(records.iter().map(|record| record.recipient.as_str()))?;
        let mut before = 0;
        for CopyRecord { copy, .. } in &records {
            if *copy <= before || i64::try_from(*copy).is_err() {
                return Err(bad_data(path, "copy", copy, format!("a number above {before}, the one before it")));
            }
            before = *copy;
        }
        Ok(records)
    }

    fn begin(&mut self) -> Result<Transaction<'_>, EngineError> {
        let path = self.path.clone();
        let begun = self.connection.transaction_with_behavior(TransactionBehavior::Immediate);
        begun.map_err(|error| told(&path, error))
    }

    fn one(&self, condition: &str, value: &dyn rusqlite::ToSql) -> Result<Option<CopyRecord>, EngineError> {
        one(&self.connection, condition, value).map_err(|error| told(&self.path, error))
    }
}

/// What the splats' files of a copy hash to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CopyHash {
    /// Its number.
    pub copy: u64,
    /// The hash.
    pub hash: Digest,
}

const COLUMNS: &str = "number, recipient, hash, reserved_unix_s, stamped_unix_s";

fn one(connection: &Connection, condition: &str, value: &dyn rusqlite::ToSql) -> rusqlite::Result<Option<CopyRecord>> {
    let sql = format!("SELECT {COLUMNS} FROM copies WHERE {condition}");
    connection.query_row(&sql, [value], record_of).optional()
}

fn reserve(transaction: &Transaction<'_>, recipient: &Recipient) -> rusqlite::Result<CopyRecord> {
    if let Some(known) = one(transaction, "folded = ?1", &recipient.folded())? {
        return Ok(known);
    }
    transaction.execute(
        "INSERT INTO copies (recipient, folded, reserved_unix_s) VALUES (?1, ?2, ?3)",
        params![recipient.as_str(), recipient.folded(), now()],
    )?;
    let known = one(transaction, "number = ?1", &transaction.last_insert_rowid())?;
    known.ok_or(rusqlite::Error::QueryReturnedNoRows)
}

/// Why a copy of another ledger cannot be taken over.
enum Unmerged {
    Database(rusqlite::Error),
    Clash(CopyRecord),
}

impl From<rusqlite::Error> for Unmerged {
    fn from(error: rusqlite::Error) -> Self {
        Self::Database(error)
    }
}

/// Whether the copy was new here.
fn merge(transaction: &Transaction<'_>, record: &CopyRecord) -> Result<bool, Unmerged> {
    let CopyRecord { copy, recipient, hash, reserved_unix_s, stamped_unix_s } = record;
    let folded = recipient.to_lowercase();
    let hash = hash.map(|hash| hash.to_string());
    let known = one(transaction, "number = ?1", copy)?.or(one(transaction, "folded = ?1", &folded)?);
    let is_new = known.is_none();
    match known {
        Some(known) if known.copy != *copy || known.recipient.to_lowercase() != folded => {
            return Err(Unmerged::Clash(known));
        }
        Some(CopyRecord { hash: Some(_), .. }) => {}
        Some(_) => {
            transaction.execute(
                "UPDATE copies SET hash = ?2, stamped_unix_s = ?3 WHERE number = ?1",
                params![copy, hash, stamped_unix_s],
            )?;
        }
        None => {
            transaction.execute(
                "INSERT INTO copies VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
                params![copy, recipient, folded, reserved_unix_s, hash, stamped_unix_s],
            )?;
        }
    }
    Ok(is_new)
}

fn terms_of(row: &Row<'_>) -> rusqlite::Result<Terms> {
    Ok(Terms {
        secret: MasterSecret::from_bytes(row.get(0)?),
        original: hash_of(row.get(1)?)?,
        splats: row.get(2)?,
        strength: row.get(3)?,
        psnr_db: row.get(4)?,
        receipt: row.get::<_, Option<String>>(5)?.map(hash_of).transpose()?,
    })
}

fn record_of(row: &Row<'_>) -> rusqlite::Result<CopyRecord> {
    Ok(CopyRecord {
        copy: row.get(0)?,
        recipient: row.get(1)?,
        hash: row.get::<_, Option<String>>(2)?.map(hash_of).transpose()?,
        reserved_unix_s: row.get(3)?,
        stamped_unix_s: row.get(4)?,
    })
}

fn hash_of(text: String) -> rusqlite::Result<Digest> {
    Digest::from_hex(&text).ok_or(rusqlite::Error::InvalidColumnName(text))
}

/// Seconds since 1970.
fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

fn told(path: &Path, error: rusqlite::Error) -> EngineError {
    match error.sqlite_error_code() {
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => EngineError::Busy { path: path.to_path_buf() },
        Some(ErrorCode::DiskFull | ErrorCode::SystemIoFailure | ErrorCode::ReadOnly | ErrorCode::CannotOpen) => {
            EngineError::Io { path: path.to_path_buf(), source: std::io::Error::other(error) }
        }
        _ => bad_data(path, "database", error, "a ledger that `guard4d stamp` made"),
    }
}
