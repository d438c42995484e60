//! Where a receipt stands: under which root, among how many receipts, and since when.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::authorities::Authorities;
use super::proof::Proof;
use super::subject::{Subject, token_beside};
use super::token::{Stamp, Token, Trust};
use crate::base::digest::Digest;
use crate::base::files::bad_data;
use crate::error::EngineError;

/// Files that date a receipt. What is not given is looked for beside the receipt: `receipt.proof.json` and
/// `receipt.tst`, and a token beside the root or proof.
#[derive(Clone, Debug, Default)]
pub struct DateFiles {
    /// Root or proof that covers the receipt.
    pub root: Option<PathBuf>,
    /// Token.
    pub timestamp: Option<PathBuf>,
    /// Certificates of authorities that are trusted; the date is only claimed without them.
    pub authorities: Vec<PathBuf>,
}

/// A date on something.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Dated {
    /// The commitment or root that was dated.
    pub of: Digest,
    /// How many receipts the date covers.
    pub receipts: u32,
    /// The date, and who says so.
    #[serde(flatten)]
    pub stamp: Stamp,
}

/// A root over a receipt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct UnderRoot {
    /// The root.
    pub root: Digest,
    /// How many receipts are under it. Any of them could have been the one that fits a film, so that every p-value is
    /// multiplied by their number.
    pub receipts: u32,
}

/// Where a receipt stands.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Standing {
    /// The root over it, if one was given or lies beside it.
    pub root: Option<UnderRoot>,
    /// Since when it is there at the latest; the earliest date if there are several.
    pub dated: Option<Dated>,
}

impl Standing {
    /// Finds out about the receipt at `receipt`, which has this commitment.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a root that does not cover the receipt, for a token that dates neither of them, and
    /// for one that no authority given has made; [`EngineError::MissingInput`] where authorities are given and there is
    /// no token; those of reading the files.
    pub fn find(receipt: &Path, commitment: &Digest, files: &DateFiles) -> Result<Self, EngineError> {
        let authorities = Authorities::read(&files.authorities)?;
        let beside = Some(Proof::beside(receipt)).filter(|path| path.exists());
        let over = files.root.clone().or(beside);
        let root = over.as_deref().map(|path| under(path, commitment)).transpose()?;
        let near: Vec<PathBuf> = match &files.timestamp {
            Some(given) => vec![given.clone()],
            None => {
                let beside = over.iter().map(|path| token_beside(path)).chain([token_beside(receipt)]);
                beside.filter(|path| path.exists()).collect()
            }
        };
        if near.is_empty() && authorities.is_some() {
            let expected = "a time-stamp token, to be checked with --ca".to_owned();
            return Err(EngineError::MissingInput { path: token_beside(receipt), expected });
        }
        let mut earliest = None;
        for path in &near {
            let token = Token::read(path)?;
            let dated = date(&token, path, *commitment, root, authorities.as_ref())?;
            let at = token.moment().since_1970();
            if earliest.as_ref().is_none_or(|(before, _)| at < *before) {
                earliest = Some((at, dated));
            }
        }
        Ok(Self { root, dated: earliest.map(|(_, dated)| dated) })
    }

    /// Receipts that the one at hand could have been chosen from.
    #[must_use]
    pub fn receipts(&self) -> u32 {
        self.root.map_or(1, |root| root.receipts)
    }
}

/// The root or proof at `path`, which has to cover `commitment`.
fn under(path: &Path, commitment: &Digest) -> Result<UnderRoot, EngineError> {
    let over = Subject::read(path)?;
    match (&over, over.covers(commitment)) {
        (Subject::Receipt(_), _) => Err(bad_data(path, "schema", "a receipt", "a guard4d.root or guard4d.proof")),
        (Subject::Root(_), false) => {
            let got = format!("{} others", over.receipts());
            Err(bad_data(path, "commitments", got, format!("{commitment}, the receipt's, among them")))
        }
        (Subject::Proof(proof), false) => {
            Err(bad_data(path, "commitment", proof.commitment(), format!("{commitment}, the receipt's")))
        }
        (_, true) => Ok(UnderRoot { root: over.digest(), receipts: over.receipts() }),
    }
}

/// What the token at `path` dates: the root, or the receipt itself.
fn date(
    token: &Token,
    path: &Path,
    commitment: Digest,
    root: Option<UnderRoot>,
    authorities: Option<&Authorities>,
) -> Result<Dated, EngineError> {
    let of_root = root.filter(|root| token.is_of(&root.root));
    let of = of_root.map_or(commitment, |root| root.root);
    let stamp = checked(token, path, &of, authorities)?;
    Ok(Dated { of, receipts: of_root.map_or(1, |root| root.receipts), stamp })
}

/// What `token` says of `of`, as far as it can be believed.
fn checked(token: &Token, path: &Path, of: &Digest, authorities: Option<&Authorities>) -> Result<Stamp, EngineError> {
    token.check_imprint(path, of)?;
    let Some(authorities) = authorities else { return Ok(token.stamp(Trust::Claimed)) };
    token.check_authority(path, authorities)?;
    Ok(token.stamp(Trust::Checked))
}

/// Checks the token for `file`, a receipt, root or proof: `timestamp`, or else the one that lies beside it.
///
/// # Errors
/// [`EngineError::BadData`] for a token of something else, and for one that no authority given has made; those of
/// reading the files.
pub fn check(file: &Path, timestamp: Option<&Path>, authorities: &[PathBuf]) -> Result<Dated, EngineError> {
    let subject = Subject::read(file)?;
    let authorities = Authorities::read(authorities)?;
    let path = timestamp.map_or_else(|| token_beside(file), Path::to_path_buf);
    let stamp = checked(&Token::read(&path)?, &path, &subject.digest(), authorities.as_ref())?;
    Ok(Dated { of: subject.digest(), receipts: subject.receipts(), stamp })
}
