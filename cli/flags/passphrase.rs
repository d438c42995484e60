//! The passphrase of key files.

use std::path::{Path, PathBuf};

use clap::Args;
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::ClipModel;
use guard4d_engine::watermark::key::owner_key::Key;
use guard4d_engine::watermark::key::passphrase::Passphrase;

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
    pub(crate) fn key(&self, path: &Path, clip: &ClipModel) -> Result<Key, EngineError> {
        key(self.passphrase_file.as_deref(), path, clip)
    }
}

/// The key at `path`, whether or not it is under the passphrase in `file`.
pub(crate) fn key(file: Option<&Path>, path: &Path, clip: &ClipModel) -> Result<Key, EngineError> {
    Key::read_sealed(path, clip, file.map(Passphrase::read).transpose()?.as_ref())
}
