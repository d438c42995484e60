//! Opening the device that a command runs on, and CLIP on it.

use std::sync::Arc;

use etcetera::{BaseStrategy as _, choose_base_strategy};
use guard4d_engine::base::pipelines;
use guard4d_engine::device::{Device, DeviceOptions, DeviceSelect};
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};

use crate::flags::common::Common;
use crate::flags::device::DeviceFlags;

/// Opens the device that `--device` or, for `auto`, a scheduler names, with the memory budget that was given.
pub(crate) fn open(common: &Common) -> Result<Device, EngineError> {
    match &common.session {
        Some(session) => session.device(|| open_anew(common)),
        None => open_anew(common),
    }
}

fn open_anew(common: &Common) -> Result<Device, EngineError> {
    let flags = &common.device;
    let options = DeviceOptions { kernels: flags.kernels, ..DeviceOptions::default() };
    let device = Device::open_with(&select(flags), options)?;
    // Without a home there is nowhere to keep them.
    if let Ok(folders) = choose_base_strategy() {
        pipelines::remember(&device, &folders.cache_dir().join("guard4d"));
    }
    if let Some(budget) = flags.vram_budget {
        device.limit_memory(budget.as_u64());
    }
    Ok(device)
}

/// Loads a checkpoint, `mini` or a folder, in the precision that was asked for.
pub(crate) fn load_clip(device: &Device, source: &str, common: &Common) -> Result<Arc<ClipModel>, EngineError> {
    let load = || {
        let clip = ClipModel::load(device, &ClipSource::from_argument(source))?;
        Ok(clip.in_precision(common.device.precision))
    };
    match &common.session {
        Some(session) => session.clip(source, load),
        None => Ok(Arc::new(load()?)),
    }
}

/// The one that `--device` or, for `auto`, a scheduler names.
pub(crate) fn select(flags: &DeviceFlags) -> DeviceSelect {
    flags.device.clone().or_assigned(|variable| std::env::var(variable).ok())
}
