//! What several commands in one process have in common: the device, CLIP, the key, what films are compared
//! with, and where results go.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::held::Held;
use guard4d_engine::detect::verify_cache::VerifyCache;
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
    device: Held<(), Device>,
    /// By what the command line said.
    clip: Held<String, Arc<ClipModel>>,
    /// By its file, and hashes of what it came of. Rows of one key stand beside each other.
    key: Held<Opened, Key>,
    verify_cache: Arc<VerifyCache>,
    printed: Mutex<Option<Value>>,
}

impl Session {
    /// The device, opened when it is first asked for.
    pub(crate) fn device(&self, open: impl FnOnce() -> Result<Device, EngineError>) -> Result<Device, EngineError> {
        self.device.get((), open)
    }

    /// The device, if it is open.
    pub(crate) fn open_device(&self) -> Option<Device> {
        self.device.held()
    }

    /// The checkpoint of that name, loaded when it is first asked for; the one before is forgotten.
    pub(crate) fn clip(
        &self,
        name: &str,
        load: impl FnOnce() -> Result<ClipModel, EngineError>,
    ) -> Result<Arc<ClipModel>, EngineError> {
        self.clip.get(name.to_owned(), || load().map(Arc::new))
    }

    /// The key in that file, read when it is first asked for; the one before is forgotten.
    pub(crate) fn key(
        &self,
        path: &Path,
        came_of: &[Digest],
        read: impl FnOnce() -> Result<Key, EngineError>,
    ) -> Result<Key, EngineError> {
        self.key.get((path.to_path_buf(), came_of.to_vec()), read)
    }

    /// What the verifications of this session have in common.
    pub(crate) fn verify_cache(&self) -> Arc<VerifyCache> {
        Arc::clone(&self.verify_cache)
    }

    /// Forgets the device, and what is on it or came of it.
    pub(crate) fn forget_device(&self) {
        self.clip.forget();
        self.verify_cache.forget();
        self.device.forget();
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
