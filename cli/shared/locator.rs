//! The search for films' cameras, which films of one original have in common.

use std::sync::{Arc, Mutex};

use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::locate::film::Locator;
use guard4d_engine::scene::Model;

use super::session::SharedLocator;
use crate::flags::common::Common;

/// Pictures of an original to look for, drawn when they are first asked for.
pub(crate) fn of(device: &Device, original: &Model, common: &Common) -> Result<SharedLocator, EngineError> {
    let make = || Locator::new(device, original).map(|locator| Arc::new(Mutex::new(locator)));
    match &common.session {
        Some(session) => session.locator(original.digest(), make),
        None => make(),
    }
}
