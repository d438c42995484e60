//! 32-byte BLAKE3 digests, written as 64 hexadecimal digits.

use std::fmt;
use std::fs::File;
use std::path::Path;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::error::EngineError;

/// A BLAKE3 digest or keyed MAC.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Digest([u8; 32]);

impl Digest {
    /// Wraps 32 bytes that a hash or MAC produced.
    #[must_use]
    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// Hashes bytes in memory.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }

    /// Hash of a file; or of the hashes of all files of a folder in hexadecimal, by their names' order.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] or [`EngineError::Io`] naming the file.
    pub fn of_path(path: &Path) -> Result<Self, EngineError> {
        if !path.is_dir() {
            return Self::of_file(path);
        }
        let io = |source| EngineError::Io { path: path.to_path_buf(), source };
        let entries = std::fs::read_dir(path).map_err(io)?.collect::<Result<Vec<_>, _>>().map_err(io)?;
        let mut files: Vec<_> = entries.into_iter().map(|entry| entry.path()).filter(|path| path.is_file()).collect();
        files.sort();
        let hashes = files.iter().map(|file| Self::of_file(file)).collect::<Result<Vec<_>, _>>()?;
        Ok(Self::of(hashes.iter().map(Self::to_string).collect::<String>().as_bytes()))
    }

    /// Hashes a file's bytes without loading the file.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] if there is no such file, [`EngineError::Io`] if reading fails.
    pub fn of_file(path: &Path) -> Result<Self, EngineError> {
        let io = |source| EngineError::Io { path: path.to_path_buf(), source };
        if !path.is_file() {
            return Err(EngineError::MissingInput { path: path.to_path_buf(), expected: "a file to hash".to_owned() });
        }
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(File::open(path).map_err(io)?).map_err(io)?;
        Ok(Self(*hasher.finalize().as_bytes()))
    }

    /// The 32 bytes.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Reads 64 hexadecimal digits; `None` for anything else.
    #[must_use]
    pub fn from_hex(text: &str) -> Option<Self> {
        let mut bytes = [0; 32];
        hex::decode_to_slice(text, &mut bytes).ok()?;
        Some(Self(bytes))
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex::encode(self.0))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Digest({self})")
    }
}

impl Serialize for Digest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_str(Hex)
    }
}

/// Reads a digest out of text that stays where it is: farms read hundreds of thousands.
struct Hex;

impl de::Visitor<'_> for Hex {
    type Value = Digest;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("64 hexadecimal digits")
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Digest, E> {
        Digest::from_hex(text).ok_or_else(|| E::custom(format!("`{text}` is not 64 hexadecimal digits")))
    }
}
