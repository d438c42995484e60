//! What an authority answers: `TimeStampResp` of RFC 3161, section 2.4.2, and the token in it.

use std::path::{Path, PathBuf};

use der::asn1::{Any, BitString};
use der::{Decode as _, Encode as _, Sequence};

use super::fault::Fault;
use super::request::Request;
use super::subject::{Subject, token_beside};
use super::token::{Stamp, Token, Trust};
use crate::base::files::read_file;
use crate::base::output::Existing;
use crate::error::EngineError;

/// Names of the values of `PKIStatus`. The first two come with a token.
const STATUS: [&str; 6] =
    ["granted", "granted with modifications", "rejection", "waiting", "revocation warning", "revocation notification"];
const WITH_TOKEN: u8 = 1;

#[derive(Sequence)]
struct TimeStampResp {
    status: PkiStatusInfo,
    #[asn1(optional = "true")]
    token: Option<Any>,
}

#[derive(Sequence)]
struct PkiStatusInfo {
    status: u8,
    #[asn1(optional = "true")]
    text: Option<Vec<String>>,
    #[asn1(optional = "true")]
    _failure: Option<BitString>,
}

/// A token that was put beside its file.
#[derive(Clone, Debug)]
pub struct Attached {
    /// Where it lies.
    pub path: PathBuf,
    /// What it says; nobody has asked yet who made it.
    pub stamp: Stamp,
}

/// The token of the response in `der`, which came from `path`.
///
/// # Errors
/// [`EngineError::BadData`] if the authority did not grant it, and those of [`Token::parse`].
pub fn token_of(path: &Path, der: &[u8]) -> Result<Token, EngineError> {
    let response = TimeStampResp::from_der(der).map_err(Fault::parsing("TimeStampResp", "that of RFC 3161"));
    let TimeStampResp { status, token } = response.map_err(|fault| fault.at(path))?;
    let name = STATUS.get(usize::from(status.status)).copied().unwrap_or("unknown");
    let granted = token.filter(|_| status.status <= WITH_TOKEN);
    let Some(granted) = granted else {
        let said: String = status.text.iter().flatten().map(|text| format!(", \"{text}\"")).collect();
        return Err(Fault::new("status", format!("{} ({name}){said}", status.status), "granted, with a token").at(path));
    };
    let der = granted.to_der().map_err(Fault::parsing("timeStampToken", "a token"));
    Token::parse(path, &der.map_err(|fault| fault.at(path))?)
}

/// Takes the token out of the file `response` and puts it beside `file`, a receipt, root or proof, if it is a date on
/// that, and the answer to `request` where that is given.
///
/// # Errors
/// [`EngineError::BadData`] for a response without a token, and for one to something else;
/// [`EngineError::CannotCreate`] where there is a token and it may not be replaced; those of reading the files.
pub fn attach(
    file: &Path,
    response: &Path,
    request: Option<&Path>,
    existing: Existing,
) -> Result<Attached, EngineError> {
    let digest = Subject::read(file)?.digest();
    let token = token_of(response, &read_file(response, "the response of a time-stamping authority")?)?;
    token.check_imprint(response, &digest)?;
    if let Some(path) = request {
        let request = Request::read(path)?;
        request.check(path, &digest)?;
        token.check_nonce(response, &request)?;
    }
    let path = token_beside(file);
    token.write(&path, existing)?;
    Ok(Attached { path, stamp: token.stamp(Trust::Claimed) })
}
