//! The search for films' cameras, which films of one original have in common.

use std::sync::{Arc, Mutex};

use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::locate::film::Locator;
use guard4d_engine::scene::Model;

use crate::flags::common::Common;

/// Pictures of an original to look for, drawn when they are first asked for: those that `verify` looks for, too. One
/// film at a time.
pub(crate) fn of(device: &Device, original: &Model, common: &Common) -> Result<Arc<Mutex<Locator>>, EngineError> {
    let cache = common.session.as_ref().map(|session| session.verify_cache()).unwrap_or_default();
    cache.locator(device, original)
}
