//! Devices as a user and as a scheduler choose them.

use std::path::{Path, PathBuf};

use guard4d_kernels::KernelFamily;
use serde_json::Value;

use super::{Run, command, guard4d, names, put, scratch};
use crate::support::fixture::TinyModel;
use crate::support::gpu::device;

/// Rows of `guard4d devices` with these variables set.
fn devices(variables: &[(&str, &Path)]) -> Vec<Value> {
    let run = Run::of(command(&[&"devices", &"--json"]).envs(variables.iter().copied()).output().expect("it runs"));
    run.done();
    serde_json::from_str(&run.stdout).expect("a list")
}

fn selected(rows: &[Value]) -> Vec<bool> {
    rows.iter().map(|row| row["selected"] == true).collect()
}

#[test]
fn a_scheduler_without_a_gpu_here_is_obeyed() {
    if device().is_none() {
        return;
    }
    let rows = devices(&[]);
    assert_eq!(selected(&rows).iter().filter(|s| **s).count(), 1, "one is taken by default: {rows:?}");
    let (folder, model) = (scratch(), TinyModel::new());
    let out = folder.path().join("out");
    let dump = |variable: &str, value: &str| {
        let args: [&dyn AsRef<std::ffi::OsStr>; 8] =
            [&"lab", &"dump", &"deform", &model.path(), &"--time", &"0", &"--out", &out];
        Run::of(command(&args).env(variable, value).output().expect("it runs"))
    };
    let far = dump("CUDA_VISIBLE_DEVICES", "GPU-00ff00ff");
    far.refused(69, &["no Vulkan device fits `CUDA_VISIBLE_DEVICES=GPU-00ff00ff`", "present: 0:", "--device"]);
    dump("SLURM_JOB_GPUS", "99").refused(69, &["`SLURM_JOB_GPUS=99`"]);
    assert_eq!(names(folder.path()), [""; 0], "nothing is written");
    let has_cpu = rows.iter().any(|row| row["kind"] == "cpu");
    if has_cpu {
        dump("CUDA_VISIBLE_DEVICES", "").done();
        let run = guard4d(&[&"devices", &"--device", &"cpu", &"--json"]);
        let rows: Vec<Value> = serde_json::from_str(&run.stdout).expect("a list");
        let taken = rows.iter().find(|row| row["selected"] == true).expect("one is taken");
        assert_eq!(taken["kind"], "cpu", "what was asked for");
    }
}

#[test]
fn kernels_are_chosen_by_flag_and_by_variable() {
    let Some(gpu) = device() else { return };
    let family = |run: Run| {
        run.done();
        let rows: Vec<Value> = serde_json::from_str(&run.stdout).expect("a list");
        let taken = rows.into_iter().find(|row| row["selected"] == true).expect("one is taken by default");
        taken["kernels"].as_str().map(str::to_owned)
    };
    let tiles = Some("tiles".to_owned());
    assert_eq!(family(guard4d(&[&"devices", &"--json", &"--kernels", &"tiles"])), tiles, "by flag");
    let by_variable = command(&[&"devices", &"--json"]).env("GUARD4D_KERNELS", "tiles").output().expect("it runs");
    assert_eq!(family(Run::of(by_variable)), tiles, "by variable");
    if gpu.family() == KernelFamily::Lanes {
        assert_eq!(family(guard4d(&[&"devices", &"--json", &"--kernels", &"lanes"])).as_deref(), Some("lanes"));
    }
    let (folder, model) = (scratch(), TinyModel::new());
    let out = folder.path().join("out");
    guard4d(&[&"lab", &"dump", &"deform", &model.path(), &"--time", &"0", &"--out", &out, &"--kernels", &"tiles"])
        .done();
    assert_eq!(names(folder.path()), ["out"], "the program runs on them");
}

/// Two copies of a software driver look like two devices, so that numbers can be tried on any machine.
#[test]
fn devices_are_chosen_by_number() {
    if device().is_none() {
        return;
    }
    let Some(library) = software_driver() else {
        crate::support::skipped("lavapipe is not here");
        return;
    };
    let folder = scratch();
    let copy = folder.path().join("libvulkan_lvp_copy.so");
    std::fs::copy(&library, &copy).expect("the driver can be copied");
    let manifests = [&library, &copy].map(|library| {
        let text = format!(
            r#"{{"ICD": {{"api_version": "1.3.0", "library_path": {:?}}}, "file_format_version": "1.0.0"}}"#,
            library.display().to_string()
        );
        let name = format!("{}.json", library.file_name().expect("a file").to_string_lossy());
        put(folder.path(), &name, text.as_bytes())
    });
    let both = std::env::join_paths(&manifests).expect("no colon in the path");
    // Loaders before 1.3.207 know the second name only.
    let drivers = [("VK_DRIVER_FILES", Path::new(&both)), ("VK_ICD_FILENAMES", Path::new(&both))];
    assert_eq!(selected(&devices(&drivers)), [true, false], "the first by default");
    let with = |select: &'static str| {
        let variables = [drivers[0], drivers[1], ("GUARD4D_DEVICE", Path::new(select))];
        selected(&devices(&variables))
    };
    assert_eq!(with("1"), [false, true], "by number");
    assert_eq!(with("2"), [false, false], "a number that is not there");
    assert_eq!(with("name:LLVMPIPE"), [true, false], "by name");
    let variables = [drivers[0], drivers[1], ("CUDA_VISIBLE_DEVICES", Path::new("0"))];
    assert_eq!(selected(&devices(&variables)), [false, false], "the processor is no assigned GPU");
}

fn software_driver() -> Option<PathBuf> {
    let folders = std::fs::read_dir("/usr/lib").ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let mut places = folders.chain([PathBuf::from("/usr/lib")]).map(|folder| folder.join("libvulkan_lvp.so"));
    places.find(|path| path.is_file())
}
