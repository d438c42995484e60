//! `guard4d devices`, and opening the one that a command runs on.

use guard4d_engine::EngineError;
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
    /// What `--precision` may be.
    precisions: Vec<String>,
    /// Whether commands run on it with the `--device` given.
    selected: bool,
}

/// Opens the device that `--device` or, for `auto`, a scheduler names, with the memory budget that was given.
pub(crate) fn open(common: &Common) -> Result<Device, EngineError> {
    let (kernels, precision) = (common.kernels, common.precision);
    let options = DeviceOptions { kernels, precision, ..DeviceOptions::default() };
    let device = Device::open_with(&select(common), options)?;
    if let Some(budget) = common.vram_budget {
        device.limit_memory(budget.as_u64());
    }
    Ok(device)
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
            precisions: d.precisions().iter().map(ToString::to_string).collect(),
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
            let precisions = r.precisions.join(",");
            format!(
                "{mark} {}  {}  ({}, {})\n     uuid:{}  pci:{pci}  kernels:{kernels}  precision:{precisions}",
                r.index, r.name, r.kind, r.driver, r.uuid
            )
        };
        rows.iter().map(line).collect::<Vec<_>>().join("\n")
    })?;
    Ok(Outcome::Done)
}
