//! What was loaded last, for as long as the same is asked for.

use std::fmt;
use std::sync::{Mutex, PoisonError};

use crate::error::EngineError;

/// At most one `T`, by its name.
pub struct Held<N, T>(Mutex<Option<(N, T)>>);

impl<N: PartialEq, T: Clone> Held<N, T> {
    /// What is held by that name, or is loaded now; what was held before is forgotten first.
    ///
    /// # Errors
    /// Those of `load`; nothing is held then.
    pub fn get(&self, name: N, load: impl FnOnce() -> Result<T, EngineError>) -> Result<T, EngineError> {
        let mut held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, known)) = held.as_ref().filter(|(known, _)| *known == name) {
            return Ok(known.clone());
        }
        *held = None;
        let loaded = load()?;
        *held = Some((name, loaded.clone()));
        Ok(loaded)
    }

    /// What is held, under whatever name.
    pub fn held(&self) -> Option<T> {
        let held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        held.as_ref().map(|(_, known)| known.clone())
    }

    /// Holds nothing any more.
    pub fn forget(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

impl<N, T> Default for Held<N, T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

impl<N, T> fmt::Debug for Held<N, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Held").finish_non_exhaustive()
    }
}
