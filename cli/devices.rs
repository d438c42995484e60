//! `guard4d devices`

use guard4d_engine::EngineError;
use guard4d_kernels::Device;
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
}

pub(crate) fn run(common: &Common) -> Result<Outcome, EngineError> {
    let rows: Vec<Row> = Device::list()?
        .into_iter()
        .enumerate()
        .map(|(index, d)| Row {
            index,
            kind: format!("{:?}", d.kind).to_lowercase(),
            name: d.name,
            driver: d.driver,
            uuid: d.uuid,
            pci: d.pci,
            subgroup_size: d.subgroup_size,
        })
        .collect();
    print(common, &rows, |rows| {
        let line = |r: &Row| {
            let pci = r.pci.as_deref().unwrap_or("-");
            format!("{}  {}  ({}, {})\n   uuid:{}  pci:{pci}", r.index, r.name, r.kind, r.driver, r.uuid)
        };
        rows.iter().map(line).collect::<Vec<_>>().join("\n")
    })?;
    Ok(Outcome::Done)
}
