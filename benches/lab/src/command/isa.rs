//! `guard4d lab isa`

use clap::Args;
use guard4d_engine::error::EngineError;
use guard4d_kernels::vk::{DriverStatistics, ProgramStatistics, statistics};
use guard4d_kernels::{DeviceSelect, FamilySelect};
use serde_json::{Map, Value, json};

use super::host::Host;

/// What drivers call registers that found no place: RADV, ANV and NVIDIA, in lower case.
const SPILLED: [&str; 3] = ["spilled sgprs", "spilled vgprs", "spill count"];

/// Nothing to choose: the device is the only one that the loader finds.
#[derive(Args, Debug)]
pub(super) struct IsaArgs {}

pub(super) fn run(_: &IsaArgs, host: &dyn Host) -> Result<(), EngineError> {
    let DriverStatistics { device, family, programs } = statistics(&DeviceSelect::Auto, FamilySelect::Auto)?;
    let spilled: Vec<&str> = programs.iter().filter(|program| spills(program) > 0.0).map(|p| p.kernel).collect();
    let told = json!({
        "device": device.name,
        "driver": device.driver,
        "kernels": family.to_string(),
        "programs": programs.iter().map(in_json).collect::<Map<_, _>>(),
        "spilled": spilled,
    });
    host.print(&told, &in_words(&programs, &spilled))
}

/// Registers that found no place.
fn spills(program: &ProgramStatistics) -> f64 {
    let is_spilled = |name: &str| SPILLED.contains(&name.to_lowercase().as_str());
    program.numbers.iter().filter(|(name, _)| is_spilled(name)).map(|(_, value)| value).sum()
}

fn in_json(program: &ProgramStatistics) -> (String, Value) {
    let numbers = program.numbers.iter().map(|(name, value)| (name.clone(), json!(value)));
    let size = ("Subgroup size".to_owned(), json!(program.subgroup_size));
    (program.kernel.to_owned(), numbers.chain([size]).collect::<Map<_, _>>().into())
}

fn in_words(programs: &[ProgramStatistics], spilled: &[&str]) -> String {
    let mut lines: Vec<String> = programs
        .iter()
        .map(|program| {
            let numbers: Vec<String> = program.numbers.iter().map(|(name, value)| format!("{name} {value}")).collect();
            format!("{}: {}", program.kernel, numbers.join(", "))
        })
        .collect();
    lines.push(match spilled {
        [] => format!("{} kernels, none with spilled registers", programs.len()),
        some => format!("spilled registers: {}", some.join(", ")),
    });
    lines.join("\n")
}
