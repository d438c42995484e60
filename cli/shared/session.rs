//! What several commands in one process have in common: the device, CLIP, and where results go.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::ClipModel;
use serde_json::Value;

/// Held by a program that runs commands one after the other, as `farm run` does.
#[derive(Default)]
pub(crate) struct Session {
    device: Mutex<Option<Device>>,
    /// By what the command line said.
    clip: Mutex<Option<(String, Arc<ClipModel>)>>,
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
        let mut held = self.clip.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((known, clip)) = &*held
            && known == name
        {
            return Ok(Arc::clone(clip));
        }
        *held = None;
        let clip = Arc::new(load()?);
        *held = Some((name.to_owned(), Arc::clone(&clip)));
        Ok(clip)
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
