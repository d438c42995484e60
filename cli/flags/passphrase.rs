//! The passphrase of key files.

use std::iter;
use std::path::{Path, PathBuf};

use clap::Args;
use guard4d_engine::base::digest::Digest;
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::ClipModel;
use guard4d_engine::watermark::key::owner_key::{Key, digest_of};
use guard4d_engine::watermark::key::passphrase::Passphrase;

use super::common::Common;

/// What names the file in the environment.
pub(crate) const PASSPHRASE_FILE: &str = "GUARD4D_PASSPHRASE_FILE";

/// The passphrase of key files.
#[derive(Args, Debug)]
pub(crate) struct PassphraseArgs {
    /// File whose first line is the passphrase of the key
    ///
    /// `keygen` encrypts the key with it, in the age format (age-encryption.org). Keys without a passphrase are read as
    /// they are.
    #[arg(long, value_name = "FILE", env = PASSPHRASE_FILE, hide_env_values = true)]
    passphrase_file: Option<PathBuf>,
}

impl PassphraseArgs {
    /// The passphrase, if one is given.
    pub(crate) fn read(&self) -> Result<Option<Passphrase>, EngineError> {
        self.passphrase_file.as_deref().map(Passphrase::read).transpose()
    }

    /// The key at `path`, whether or not it is under the passphrase.
    pub(crate) fn key(&self, path: &Path, clip: &ClipModel, common: &Common) -> Result<Key, EngineError> {
        key(self.passphrase_file.as_deref(), path, clip, common)
    }
}

/// The key at `path`, whether or not it is under the passphrase in `file`. A session opens it once, as long as both
/// files and the checkpoint stay what they are: a passphrase is slow on purpose.
pub(crate) fn key(file: Option<&Path>, path: &Path, clip: &ClipModel, common: &Common) -> Result<Key, EngineError> {
    let read = || Key::read_sealed(path, clip, file.map(Passphrase::read).transpose()?.as_ref());
    let files: Vec<&Path> = iter::once(path).chain(file).collect();
    let hashes: Result<Vec<Digest>, EngineError> = files.iter().map(|file| Digest::of_file(file)).collect();
    match (&common.session, hashes) {
        (Some(session), Ok(mut hashes)) => {
            hashes.push(digest_of(clip));
            session.key(path, &hashes, read)
        }
        // What cannot be hashed beforehand, such as a pipe, is read as it comes.
        _ => read(),
    }
}
