//! `guard4d devices`

use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use serde::Serialize;

use crate::flags::common::Common;
use crate::shared::device::select;
use crate::ui::outcome::Outcome;
use crate::ui::report::print;

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

pub(crate) fn run(common: &Common) -> Result<Outcome, EngineError> {
    let devices = Device::list()?;
    let selected = select(&common.device).choose(&devices).ok();
    let rows: Vec<Row> = devices
        .into_iter()
        .enumerate()
        .map(|(index, d)| Row {
            index,
            kernels: common.device.kernels.choose(&d).ok().map(|family| family.to_string()),
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
