//! Kernels in the hands of compilers for GPUs, which need no GPU: Mesa's RADV tells what became of each.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{Run, command};
use crate::support::skipped_unless_required;

/// GPUs as Mesa names them: of GCN 5, RDNA 2 and RDNA 3. `./x isa` writes the same ones into a table.
const GPUS: [&str; 3] = ["vega10", "navi21", "gfx1100"];

/// What the loader knows RADV by; it comes with the package that lavapipe comes with.
fn radv() -> Option<PathBuf> {
    let files = Path::new("/usr/share/vulkan/icd.d").read_dir().ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    files.into_iter().find(|path| path.file_name().is_some_and(|n| n.to_string_lossy().starts_with("radeon_icd")))
}

#[test]
fn no_kernel_spills_registers_on_a_gpu() {
    let Some(manifest) = radv() else { return skipped_unless_required("RADV is not installed") };
    for gpu in GPUS {
        let mut isa = command(&[&"--json", &"lab", &"isa"]);
        isa.env("RADV_FORCE_FAMILY", gpu).env("VK_DRIVER_FILES", &manifest).env("VK_ICD_FILENAMES", &manifest);
        let run = Run::of(isa.output().expect("it runs"));
        run.done();
        let told: Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
        assert_eq!(told["kernels"], "tiles", "{gpu}: {}", told["device"]);
        let programs = told["programs"].as_object().expect("an object");
        assert!(programs.len() > 80, "{gpu}: all kernels, and not {}", programs.len());
        // A driver that does not say how many spilled would have none.
        assert!(programs.values().all(|numbers| numbers["Spilled VGPRs"].is_number()), "{gpu} counts spills");
        assert_eq!(told["spilled"], Value::Array(Vec::new()), "{gpu}");
    }
}
