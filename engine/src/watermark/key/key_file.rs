//! Files of keys: an owner's, and what an owner discloses of it for one asset. Both are private.

use std::path::{Path, PathBuf};

use zeroize::Zeroizing;

use super::decoder::DecoderWeights;
use super::owner_key::{Key, Scope, Signer, digest_of, reader_secret, vocabulary};
use super::passphrase::{Passphrase, opened};
use super::tokens::TokenTable;
use crate::base::digest::Digest;
use crate::base::files::{bad_data, read_file};
use crate::base::output::{AtomicFile, Existing};
use crate::base::prf::{MasterSecret, Prf};
use crate::base::signature::PublicKey;
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;
use crate::networks::clip::ClipModel;

/// `format` entry of a disclosed key.
const DISCLOSURE: &str = "guard4d.disclosure/1";
/// Entry with the hash of everything else in a file.
const CONTENT: &str = "content";
/// Master secret.
const SECRET: &str = "secret";
/// What table, codes and the decoder's start follow from.
const READER_SECRET: &str = "reader_secret";
/// What everything else of one asset follows from.
const ASSET_SECRET: &str = "asset_secret";
/// Entries that nobody is shown.
pub const SECRETS: [&str; 3] = [SECRET, READER_SECRET, ASSET_SECRET];

impl Key {
    /// Writes the key file, whole or not at all, for its owner's eyes alone. A key of an asset is written as it is
    /// disclosed: without the owner's secret.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] or [`EngineError::Io`] naming the file.
    pub fn write(&self, path: &Path, existing: Existing) -> Result<(), EngineError> {
        AtomicFile::write_private(path, existing, &Zeroizing::new(self.file(path)?.to_bytes()?))
    }

    /// [`Self::write`], encrypted with a passphrase in the age format.
    ///
    /// # Errors
    /// Those of [`Self::write`].
    pub fn write_sealed(&self, path: &Path, existing: Existing, passphrase: &Passphrase) -> Result<(), EngineError> {
        let bytes = Zeroizing::new(self.file(path)?.to_bytes()?);
        AtomicFile::write_private(path, existing, &passphrase.seal(path, &bytes)?)
    }

    fn file(&self, path: &Path) -> Result<TensorFile, EngineError> {
        let mut file = TensorFile { path: path.to_owned(), ..TensorFile::default() };
        let bits = self.bits();
        let mut note = |name: &str, text: String| file.meta.insert(name.to_owned(), text);
        note("bits", bits.to_string());
        note("clip", self.clip.to_string());
        match &self.scope {
            Scope::First(secret) => {
                note("format", Self::FIRST_FORMAT.to_owned());
                note(SECRET, hex::encode(secret.expose()));
            }
            Scope::Owner(secret) => {
                note("format", Self::FORMAT.to_owned());
                note(SECRET, hex::encode(secret.expose()));
            }
            Scope::Asset { asset, secret, .. } => {
                note("format", DISCLOSURE.to_owned());
                note("asset", asset.to_string());
                note("signer", self.public_key().to_string());
                note(ASSET_SECRET, hex::encode(secret.expose()));
                note(READER_SECRET, hex::encode(self.reader.expose()));
            }
        }
        let ids = self.table.ids().as_flattened().to_vec();
        file.tensors.insert("token_table".to_owned(), Tensor::u32(&[bits, 2], ids));
        self.store_reading(&mut file);
        let content = Digest::of(&file.to_bytes()?);
        file.meta.insert(CONTENT.to_owned(), content.to_string());
        Ok(file)
    }

    /// Adds what films are read with: decoder, `text_mean` and `codes`.
    pub(crate) fn store_reading(&self, file: &mut TensorFile) {
        let (bits, width) = (self.bits(), self.text_mean.len());
        file.tensors.insert("text_mean".to_owned(), Tensor::f32(&[width], self.text_mean.clone()));
        file.tensors.insert("codes".to_owned(), Tensor::f32(&[bits, width], self.codes.clone()));
        self.decoder.store(file);
    }

    /// Reads an owner's key file, or one that was disclosed for an asset, made for `clip`. Checks that its table
    /// follows from its secret and that nothing was changed; that the rest follows, [`Key::check`] says.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming what does not fit.
    pub fn read(path: &Path, clip: &ClipModel) -> Result<Self, EngineError> {
        Self::read_sealed(path, clip, None)
    }

    /// [`Self::read`] of a file that may be under a passphrase.
    ///
    /// # Errors
    /// Those of [`Self::read`]; [`EngineError::BadData`] where the passphrase is missing or another one.
    pub fn read_sealed(path: &Path, clip: &ClipModel, passphrase: Option<&Passphrase>) -> Result<Self, EngineError> {
        let bytes = read_file(path, "a safetensors file")?;
        let file = TensorFile::from_bytes(path, &opened(path, bytes, passphrase)?)?;
        let Secrets { scope, reader } = Secrets::read(&file)?;
        let bits_text = file.text("bits")?;
        let bits: u32 = bits_text.parse().map_err(|_| file.bad("bits", bits_text, "a number"))?;
        let clip_text = file.text("clip")?;
        let clip_digest =
            Digest::from_hex(clip_text).ok_or_else(|| file.bad("clip", clip_text, "a hash of 64 digits"))?;
        // Another checkpoint's sizes would make the checks below speak of something else.
        check_clip(path, clip_digest, clip)?;
        let width = clip.config().projection_dim;
        let key = Self {
            table: TokenTable::derive(&Prf::new(&reader), vocabulary(clip), bits)?,
            text_mean: file.finite("text_mean", &[width])?.to_vec(),
            codes: file.finite("codes", &[bits as usize, width])?.to_vec(),
            decoder: DecoderWeights::load(&file, width, bits as usize)?,
            clip: clip_digest,
            path: path.to_owned(),
            scope,
            reader,
        };
        if file.integers("token_table", &[bits as usize, 2])? != key.table.ids().as_flattened() {
            return Err(file.bad("token_table", "a table that does not follow from the secret", "the derived table"));
        }
        check_content(file)?;
        Ok(key)
    }
}

/// The secret part of a file.
struct Secrets {
    scope: Scope,
    reader: MasterSecret,
}

impl Secrets {
    fn read(file: &TensorFile) -> Result<Self, EngineError> {
        let format = file.text("format")?;
        if format == DISCLOSURE {
            let asset = file.text("asset")?;
            let asset = Digest::from_hex(asset).ok_or_else(|| file.bad("asset", asset, "a hash of 64 digits"))?;
            let signer = file.text("signer")?;
            let signer = PublicKey::from_hex(signer).ok_or_else(|| file.bad("signer", signer, "64 hex digits"))?;
            let secret = secret_of(file, ASSET_SECRET)?;
            let scope = Scope::Asset { asset, secret, signer: Signer::Other(signer) };
            return Ok(Self { scope, reader: secret_of(file, READER_SECRET)? });
        }
        let secret = secret_of(file, SECRET)?;
        if format == Key::FORMAT {
            return Ok(Self { reader: reader_secret(&secret), scope: Scope::Owner(secret) });
        }
        if format == Key::FIRST_FORMAT {
            return Ok(Self { reader: secret.clone(), scope: Scope::First(secret) });
        }
        Err(file.bad("format", format, &format!("{} or {DISCLOSURE}", Key::FORMAT)))
    }
}

fn secret_of(file: &TensorFile, name: &str) -> Result<MasterSecret, EngineError> {
    let mut secret = Zeroizing::new([0; 32]);
    hex::decode_to_slice(file.text(name)?, &mut *secret)
        .map_err(|e| file.bad(name, &e.to_string(), "64 hex digits"))?;
    Ok(MasterSecret::from_bytes(*secret))
}

/// Refuses another checkpoint than the one that a key was made with.
fn check_clip(path: &Path, made_with: Digest, clip: &ClipModel) -> Result<(), EngineError> {
    if made_with == digest_of(clip) {
        return Ok(());
    }
    let expected = format!("one made with checkpoint {} ({})", digest_of(clip), clip.path().display());
    Err(bad_data(path, "clip", format!("a key made with checkpoint {made_with}"), expected))
}

/// Refuses a file of which anything was changed by accident; whoever changes it on purpose can hash it anew.
fn check_content(mut file: TensorFile) -> Result<(), EngineError> {
    let stated = file.text(CONTENT)?.to_owned();
    file.meta.remove(CONTENT);
    let found = Digest::of(&file.to_bytes()?).to_string();
    if found == stated {
        return Ok(());
    }
    Err(file.bad(CONTENT, &found, &format!("{stated}: the key was changed after it was made")))
}

/// Where the master secret of a new key comes from.
///
/// # Errors
/// [`EngineError::MissingInput`] or [`EngineError::Io`] naming the file; [`EngineError::BadData`] unless it holds 64
/// hex digits.
pub fn read_secret(path: Option<&PathBuf>) -> Result<MasterSecret, EngineError> {
    let Some(path) = path else { return MasterSecret::generate() };
    let text = std::fs::read_to_string(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => {
            EngineError::MissingInput { path: path.clone(), expected: "a file with a master secret".to_owned() }
        }
        _ => EngineError::Io { path: path.clone(), source },
    })?;
    let (text, mut bytes) = (Zeroizing::new(text), Zeroizing::new([0; 32]));
    hex::decode_to_slice(text.trim(), &mut *bytes)
        .map_err(|e| bad_data(path, "secret", e.to_string(), "64 hex digits"))?;
    Ok(MasterSecret::from_bytes(*bytes))
}
