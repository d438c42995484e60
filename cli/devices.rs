//! `guard4d devices`, and opening the one that a command runs on.

use guard4d_engine::EngineError;
use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_kernels::{Device, DeviceOptions, DeviceSelect};
use serde::Serialize;

use crate::args::Common;
use crate::report::{Outcome, print};

#[derive(Serialize)]
struct Row {
    index: usize,
    name: String,
    kind: String,
    driver: String,
    uuid: String,
    pci: Option<String>,
    subgroup_size: u32,
    /// The kernels that it would run with the `--kernels` given; nothing when it cannot run those.
    kernels: Option<String>,
    /// Whether it can do `--precision f16`.
    f16: bool,
    /// Whether commands run on it with the `--device` given.
    selected: bool,
}

/// Opens the device that `--device` or, for `auto`, a scheduler names, with the memory budget that was given.
pub(crate) fn open(common: &Common) -> Result<Device, EngineError> {
    let options = DeviceOptions { kernels: common.kernels, ..DeviceOptions::default() };
    let device = Device::open_with(&select(common), options)?;
    if let Some(budget) = common.vram_budget {
        device.limit_memory(budget.as_u64());
    }
    Ok(device)
}

/// Loads a checkpoint in the precision that was asked for.
pub(crate) fn load_clip(device: &Device, source: &ClipSource, common: &Common) -> Result<Clip, EngineError> {
    Ok(Clip::load(device, source)?.in_precision(common.precision))
}

fn select(common: &Common) -> DeviceSelect {
    common.device.clone().or_assigned(|variable| std::env::var(variable).ok())
}

pub(crate) fn run(common: &Common) -> Result<Outcome, EngineError> {
    let devices = Device::list()?;
    let selected = select(common).choose(&devices).ok();
    let rows: Vec<Row> = devices
        .into_iter()
        .enumerate()
        .map(|(index, d)| Row {
            index,
            kernels: common.kernels.choose(&d).ok().map(|family| family.to_string()),
            f16: d.cooperation.is_some(),
            kind: format!("{:?}", d.kind).to_lowercase(),
            name: d.name,
            driver: d.driver,
            uuid: d.uuid,
            pci: d.pci,
            subgroup_size: d.subgroup_size,
            selected: selected == Some(index),
        })
        .collect();
    print(common, &rows, |rows| {
        let line = |r: &Row| {
            let pci = r.pci.as_deref().unwrap_or("-");
            let mark = if r.selected { '*' } else { ' ' };
            let kernels = r.kernels.as_deref().unwrap_or("-");
            let f16 = if r.f16 { "yes" } else { "no" };
            format!(
                "{mark} {}  {}  ({}, {})\n     uuid:{}  pci:{pci}  kernels:{kernels}  f16:{f16}",
                r.index, r.name, r.kind, r.driver, r.uuid
            )
        };
        rows.iter().map(line).collect::<Vec<_>>().join("\n")
    })?;
    Ok(Outcome::Done)
}
