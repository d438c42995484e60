//! Wrong usage, JSON, and what goes where.

use std::process::Command;

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use serde_json::Value;

use super::{all_commands, ask, commands, flags, guard4d, names, scratch};
use crate::support::fixture::TinyModel;
use crate::support::gpu::device;

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e} in:\n{text}"))
}

#[test]
fn wrong_usage_ends_with_two() {
    guard4d(&[]).refused(2, &["Usage: guard4d"]);
    guard4d(&[&"frobnicate"]).refused(2, &["unrecognized subcommand 'frobnicate'"]);
    guard4d(&[&"render", &"model"]).refused(2, &["--out <PATH>"]);
    guard4d(&[&"render", &"model", &"--out", &"x", &"--size", &"3x3"]).refused(2, &["each from 16 to 8192"]);
    guard4d(&[&"render", &"model", &"--out", &"x", &"--cameras", &"c", &"--orbit", &"3"]).refused(2, &["--orbit"]);
    guard4d(&[&"embed", &"model", &"--out", &"x"]).refused(2, &["--key <KEY>"]);
    // By the names that receipts and reports use.
    let modes = ExtractorMode::ALL.map(|mode| mode.to_string()).join(", ");
    assert_eq!(modes, "none, blind, pretrained, joint");
    guard4d(&[&"embed", &"model", &"--out", &"x", &"--key", &"k", &"--extractor", &"best"]).refused(2, &[&modes]);
    guard4d(&[&"embed", &"model", &"--out", &"x", &"--key", &"k", &"--bases", &"some"]).refused(2, &["dc, all"]);
    guard4d(&[&"verify", &"--key", &"k", &"--receipt", &"r"]).refused(2, &["<SUSPECT>..."]);
    guard4d(&[&"devices", &"--device", &"warp:drive"]).refused(2, &["warp:drive"]);
    guard4d(&[&"devices", &"--kernels", &"warps"]).refused(2, &["auto, lanes or tiles"]);
    guard4d(&[&"devices", &"--precision", &"f8"]).refused(2, &["f32 or fixed16 or f16"]);
    guard4d(&[&"lab", &"dump", &"deform", &"model", &"--time", &"noon", &"--out", &"x"]).refused(2, &["noon"]);
    if device().is_some() {
        let folder = scratch();
        let out = folder.path().join("owner.key");
        guard4d(&[&"keygen", &"--bits", &"12", &"--out", &out])
            .refused(2, &["12 bits", "a multiple of 8, 1 to 75 bits"]);
        guard4d(&[&"keygen", &"--device", &"99", &"--out", &out]).refused(69, &["99"]);
        assert_eq!(names(folder.path()), [""; 0], "no key");
    }
}

#[test]
fn help_goes_to_stdout_and_names_the_exit_codes() {
    let run = guard4d(&[&"--help"]);
    run.done();
    assert!(run.stdout.contains("Exit codes:") && run.stdout.contains("convert"), "{}", run.stdout);
    assert_eq!(run.stderr, "", "help was asked for");
    assert!(!run.stdout.contains("lab "), "research stands aside:\n{}", run.stdout);
    let lab = guard4d(&[&"lab", &"--help"]);
    lab.done();
    for command in ["study", "tracing", "pretrain", "dump", "isa"] {
        assert!(lab.stdout.contains(&format!("  {command}")), "{command}:\n{}", lab.stdout);
    }
    for (command, tensor) in [("clip", "v_pixel_values [G,3,S,S]"), ("resize", "v_y [F,h,w,C]"), ("adam", "hyper [4]")]
    {
        let run = guard4d(&[&"lab", &"dump", &command, &"--help"]);
        assert!(run.stdout.contains(tensor), "tensors are named:\n{}", run.stdout);
    }
}

/// Flags that `--help` of a command shows and that not every command has.
fn own_flags(command: &str) -> Vec<String> {
    let of_all = ["json", "verbose", "quiet", "device", "kernels", "precision", "vram-budget", "help"];
    flags(command).into_iter().filter(|flag| !of_all.contains(&flag.as_str())).collect()
}

#[test]
fn help_shows_what_users_need_in_narrow_lines() {
    let expected = [
        "demo",
        "keygen",
        "embed",
        "verify",
        "commit",
        "timestamp",
        "disclose",
        "undo",
        "stamp",
        "ledger",
        "locate",
        "trace",
        "render",
        "attack",
        "convert",
        "farm",
        "inspect",
        "devices",
        "completions",
        "man",
    ];
    assert_eq!(commands(), expected, "in the order of their use; what research needs is hidden");
    assert_eq!(own_flags("demo"), ["out", "seed", "overwrite"], "what shortens the demonstration is hidden");
    let shown = all_commands();
    for command in ["", "lab", "reference"].into_iter().chain(shown.iter().map(String::as_str)) {
        for help in ["-h", "--help"] {
            let text = ask(command, help);
            let wide: Vec<&str> = text.lines().filter(|line| line.chars().count() > 100).collect();
            assert!(wide.is_empty(), "guard4d {command} {help}: {wide:#?}");
            let heading =
                |name: &str| text.lines().position(|line| line == name).unwrap_or_else(|| panic!("{name}:\n{text}"));
            let device = heading("Device:");
            for flag in ["--device", "--kernels", "--precision", "--vram-budget"] {
                let at = text.lines().position(|line| line.trim_start().starts_with(flag));
                assert!(at.is_some_and(|at| at > device), "{flag} stands under its heading:\n{text}");
            }
        }
    }
}

#[test]
fn results_go_to_stdout_as_text_or_json() {
    let model = TinyModel::new();
    let text = guard4d(&[&"inspect", &model.path()]);
    text.done();
    assert!(text.stdout.contains("splats: 3"), "{}", text.stdout);
    assert_eq!(text.stderr, "", "nothing to say");
    let run = guard4d(&[&"inspect", &"--json", &model.path()]);
    let value = json(&run.stdout);
    assert_eq!((&value["splats"], &value["sh_degree"]), (&Value::from(3), &Value::from(3)), "{value}");
    if device().is_some() {
        let devices = json(&guard4d(&[&"devices", &"--json"]).stdout);
        assert!(devices[0]["name"].is_string() && devices[0]["uuid"].is_string(), "{devices}");
        let folder = scratch();
        let out = folder.path().join("out");
        let run = guard4d(&[&"--json", &"lab", &"dump", &"deform", &model.path(), &"--time", &"1", &"--out", &out]);
        assert_eq!(json(&run.stdout)["xyz"], Value::from(vec![3, 3]), "shapes by name");
    }
}

#[test]
fn without_a_driver_the_message_says_what_to_install() {
    let folder = scratch();
    let mut command = Command::new(env!("CARGO_BIN_EXE_guard4d"));
    command.args(["keygen", "--out"]).arg(folder.path().join("owner.key"));
    command.env("VK_DRIVER_FILES", "/nowhere").env("VK_ICD_FILENAMES", "/nowhere").env("NO_COLOR", "1");
    let output = command.output().expect("the program was built with the tests");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(69), "exit code: {stderr}");
    assert!(stderr.contains("no Vulkan driver") && stderr.contains("mesa-vulkan-drivers"), "{stderr}");
    assert_eq!(names(folder.path()), [""; 0], "no key");
}

#[test]
fn embed_shows_no_more_flags_than_a_newcomer_reads() {
    let own = own_flags("embed");
    assert!(!own.is_empty() && own.len() <= 18, "{} flags: {own:?}", own.len());
}
