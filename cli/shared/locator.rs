//! The search for films' cameras, which films of one original have in common.

use std::sync::{Arc, Mutex};

use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::locate::film::Locator;
use guard4d_engine::locate::views::Vantage;
use guard4d_engine::scene::{Camera, CameraSet, FrameSize, Model};

use crate::flags::common::Common;
use crate::flags::near::NearArgs;

/// Pictures of an original to look for, drawn when they are first asked for: those that `verify` looks for, too. One
/// film at a time.
pub(crate) fn of(
    device: &Device,
    original: &Model,
    vantage: Vantage<'_>,
    common: &Common,
) -> Result<Arc<Mutex<Locator>>, EngineError> {
    let cache = common.session.as_ref().map(|session| session.verify_cache()).unwrap_or_default();
    cache.locator(device, original, vantage)
}

/// The cameras that films were taken near to; none where nobody says.
pub(crate) fn near(args: &NearArgs) -> Result<Vec<Camera>, EngineError> {
    let Some(path) = &args.near else { return Ok(Vec::new()) };
    // Where they stand and which way they look does not follow from their pictures' size.
    let set = CameraSet::open(path, FrameSize::DNERF)?;
    Ok(set.views.into_iter().map(|view| view.camera).collect())
}
