//! What a file or a folder holds, as hashes.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::digest::Digest;
use crate::error::EngineError;

/// Hash of each file of a folder, by its path below it; of a single file by no path at all.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Contents(BTreeMap<String, Digest>);

impl Contents {
    /// Reads all files.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] where there is nothing; [`EngineError::Io`].
    pub fn of(path: &Path) -> Result<Self, EngineError> {
        let mut found = BTreeMap::new();
        if path.is_dir() {
            read_folder(path, "", &mut found)?;
        } else {
            found.insert(String::new(), Digest::of_file(path)?);
        }
        Ok(Self(found))
    }

    /// One hash of all.
    #[must_use]
    pub fn digest(&self) -> Digest {
        Digest::of(&serde_json::to_vec(&self.0).expect("texts are JSON"))
    }
}

fn read_folder(folder: &Path, below: &str, found: &mut BTreeMap<String, Digest>) -> Result<(), EngineError> {
    let io = |source| EngineError::Io { path: folder.to_path_buf(), source };
    for entry in fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name = if below.is_empty() { name } else { format!("{below}/{name}") };
        if path.is_dir() {
            read_folder(&path, &name, found)?;
        } else {
            found.insert(name, Digest::of_file(&path)?);
        }
    }
    Ok(())
}
