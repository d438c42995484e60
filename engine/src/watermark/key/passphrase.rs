//! Keys under a passphrase: files of the age format (age-encryption.org/v1), which other programs open, too.

use std::path::Path;

use age::scrypt;
use age::secrecy::SecretString;
use zeroize::Zeroizing;

use crate::base::files::{bad_data, read_file};
use crate::error::EngineError;

/// First line of every such file.
const HEADER: &[u8] = b"age-encryption.org/v1\n";
/// Binary logarithm of the work that a guess takes: that of the `age` program, about a second.
const WORK: u8 = 18;
/// Most work that a file may ask for, so that one cannot keep the program busy for hours.
const MOST_WORK: u8 = 22;

/// What a key file is encrypted with. It is wiped from memory when it is no longer needed.
pub struct Passphrase(SecretString);

impl Passphrase {
    /// The first line of a file.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] or [`EngineError::Io`] naming the file; [`EngineError::BadData`] if that line is
    /// empty or no text.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        let bytes = Zeroizing::new(read_file(path, "a file with a passphrase")?);
        let text = std::str::from_utf8(&bytes).map_err(|error| bad_data(path, "first line", error, "UTF-8"))?;
        let line = text.lines().next().unwrap_or_default();
        if line.is_empty() {
            return Err(bad_data(path, "first line", "nothing", "a passphrase"));
        }
        Ok(Self(SecretString::from(line.to_owned())))
    }

    /// Encrypts the bytes of a key.
    pub(super) fn seal(&self, path: &Path, bytes: &[u8]) -> Result<Vec<u8>, EngineError> {
        let mut recipient = scrypt::Recipient::new(self.0.clone());
        recipient.set_work_factor(WORK);
        let source = |error: age::EncryptError| std::io::Error::other(error.to_string());
        age::encrypt(&recipient, bytes)
            .map_err(|error| EngineError::Io { path: path.to_owned(), source: source(error) })
    }

    /// What was encrypted.
    fn unseal(&self, path: &Path, bytes: &[u8]) -> Result<Zeroizing<Vec<u8>>, EngineError> {
        let mut identity = scrypt::Identity::new(self.0.clone());
        identity.set_max_work_factor(MOST_WORK);
        let refused = |error: age::DecryptError| bad_data(path, "age", error, "a file that the passphrase opens");
        age::decrypt(&identity, bytes).map(Zeroizing::new).map_err(refused)
    }
}

/// Bytes of a key file as they are, or decrypted if they are under a passphrase.
///
/// # Errors
/// [`EngineError::BadData`] where the passphrase is missing or another one, or something was changed.
pub(super) fn opened(
    path: &Path,
    bytes: Vec<u8>,
    passphrase: Option<&Passphrase>,
) -> Result<Zeroizing<Vec<u8>>, EngineError> {
    match (bytes.starts_with(HEADER), passphrase) {
        (false, _) => Ok(Zeroizing::new(bytes)),
        (true, Some(passphrase)) => passphrase.unseal(path, &bytes),
        (true, None) => Err(bad_data(path, "age", "a key under a passphrase", "its passphrase: --passphrase-file")),
    }
}
