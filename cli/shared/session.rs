//! What several commands in one process have in common: the device, CLIP, the key, and where results go.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use guard4d_engine::base::digest::Digest;
use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::ClipModel;
use guard4d_engine::watermark::key::owner_key::Key;
use serde_json::Value;

/// A file, and hashes of what a key came of.
type Opened = (PathBuf, Vec<Digest>);

/// Held by a program that runs commands one after the other, as `farm run` does.
#[derive(Default)]
pub(crate) struct Session {
    device: Mutex<Option<Device>>,
    /// By what the command line said.
    clip: Mutex<Option<(String, Arc<ClipModel>)>>,
    /// By its file, and hashes of what it came of. Rows of one key stand beside each other.
    key: Mutex<Option<(Opened, Key)>>,
    printed: Mutex<Option<Value>>,
}

impl Session {
    /// The device, opened when it is first asked for.
    pub(crate) fn device(&self, open: impl FnOnce() -> Result<Device, EngineError>) -> Result<Device, EngineError> {
        let mut held = self.device.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(device) = &*held {
            return Ok(device.clone());
        }
        let device = open()?;
        *held = Some(device.clone());
        Ok(device)
    }

    /// The checkpoint of that name, loaded when it is first asked for; the one before is forgotten.
    pub(crate) fn clip(
        &self,
        name: &str,
        load: impl FnOnce() -> Result<ClipModel, EngineError>,
    ) -> Result<Arc<ClipModel>, EngineError> {
        once(&self.clip, name.to_owned(), || load().map(Arc::new))
    }

    /// The key in that file, read when it is first asked for; the one before is forgotten.
    pub(crate) fn key(
        &self,
        path: &Path,
        came_of: &[Digest],
        read: impl FnOnce() -> Result<Key, EngineError>,
    ) -> Result<Key, EngineError> {
        once(&self.key, (path.to_path_buf(), came_of.to_vec()), read)
    }

    /// Forgets the device, and what is on it.
    pub(crate) fn forget_device(&self) {
        *self.clip.lock().unwrap_or_else(PoisonError::into_inner) = None;
        *self.device.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Takes what a command would print.
    pub(crate) fn keep_result(&self, result: Value) {
        *self.printed.lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
    }

    /// What the last command would have printed; nothing the second time.
    pub(crate) fn take_result(&self) -> Option<Value> {
        self.printed.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Session").finish_non_exhaustive()
    }
}

/// What is held by that name, or is loaded now; what was held before is forgotten first.
fn once<N: PartialEq, T: Clone>(
    held: &Mutex<Option<(N, T)>>,
    name: N,
    load: impl FnOnce() -> Result<T, EngineError>,
) -> Result<T, EngineError> {
    let mut held = held.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, known)) = held.as_ref().filter(|(known, _)| *known == name) {
        return Ok(known.clone());
    }
    *held = None;
    let loaded = load()?;
    *held = Some((name, loaded.clone()));
    Ok(loaded)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_held_is_loaded_once_and_what_failed_is_not_held() {
        let held = Mutex::new(None);
        let unwanted = || -> Result<u32, EngineError> { panic!("it is held") };
        assert_eq!(once(&held, "a", || Ok(1)).ok(), Some(1));
        assert_eq!(once(&held, "a", unwanted).ok(), Some(1));
        assert_eq!(once(&held, "b", || Ok(2)).ok(), Some(2), "another name");
        assert!(once(&held, "a", || Err(EngineError::Stopped)).is_err(), "the one before was forgotten");
        assert_eq!(once(&held, "a", || Ok(3)).ok(), Some(3), "a failure is tried again");
        assert_eq!(once(&held, "a", unwanted).ok(), Some(3));
    }
}
