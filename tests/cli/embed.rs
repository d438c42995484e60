//! `guard4d embed`: the quality gate, Ctrl-C and going on.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;
use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::release::receipt::Receipt;
use guard4d_engine::scene::formats::Export;
use guard4d_engine::scene::{Gaussians, Model, ply};
use guard4d_engine::watermark::embed::PhaseReport;
use serde_json::Value;

use super::{Run, command, guard4d, interrupted, is_begun, names, put, scratch};
use crate::scene::ply::paths::on_paths;
use crate::support::camera_writers::{Format, Shot};
use crate::support::fixture::gaussians;
use crate::support::gpu::{Gpu, device};
use crate::support::old_receipt;
use crate::support::owner::key_file;
use crate::support::{files_below, random_lpips};

/// Training steps; a signal has to arrive between the first and the last, on a busy machine too.
const STEPS: u32 = 8;
/// What an interrupted run leaves beside its output.
const CHECKPOINT: &str = "out.checkpoint.safetensors";

/// A static model of a few splats and a key, and the arguments of a small embedding into `out` beside them.
struct Small {
    folder: tempfile::TempDir,
    args: Vec<String>,
}

impl Small {
    fn new(gpu: &Gpu) -> Self {
        let folder = scratch();
        let clip = ClipModel::load(gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
        let key = put(folder.path(), "owner.key", &key_file(&clip).to_bytes().expect("serialises"));
        let model = put(folder.path(), "model.ply", &ply::encode(&gaussians(60, 1, 3)));
        let text = |path: &Path| path.display().to_string();
        let mut args = vec!["embed".to_owned(), text(&model), "--key".to_owned(), text(&key)];
        let rest = "--extractor joint --train-clips 2 --probes 16 --size 32x32 --orbit 1 --frames 2 --quiet";
        args.extend(rest.split(' ').map(str::to_owned));
        args.extend(["--steps".to_owned(), STEPS.to_string()]);
        Self { folder, args }
    }

    /// Gives an option that is among the arguments another value.
    fn set(&mut self, option: &str, value: &str) {
        let at = self.args.iter().position(|arg| arg == option).expect("it is among them");
        value.clone_into(&mut self.args[at + 1]);
    }

    fn out(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Arguments that write to `name`, and `more`.
    fn args(&self, name: &str, more: &[&str]) -> Vec<String> {
        let out = self.out(name).display().to_string();
        let more = more.iter().map(|s| (*s).to_owned());
        self.args.iter().cloned().chain(["--out".to_owned(), out]).chain(more).collect()
    }

    fn run(&self, name: &str, more: &[&str]) -> Run {
        let args = self.args(name, more);
        guard4d(&args.iter().map(|a| a as &dyn AsRef<OsStr>).collect::<Vec<_>>())
    }

    /// Starts the program and sends `signal` as soon as `ready`.
    fn interrupt(&self, signal: &str, (name, more): (&str, &[&str]), ready: impl Fn() -> bool) -> Run {
        let args = self.args(name, more);
        interrupted(command(&args.iter().map(|a| a as &dyn AsRef<OsStr>).collect::<Vec<_>>()), signal, ready)
    }
}

/// Every file below `root` with its bytes; receipts without what was measured of the run itself.
pub(super) fn contents(root: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let read = |path: PathBuf| {
        let mut bytes = fs::read(root.join(&path)).expect("readable");
        if path.ends_with("receipt.json") {
            let mut receipt: Value = serde_json::from_slice(&bytes).expect("JSON");
            receipt["commitment"].take();
            receipt["signature"].take();
            receipt["body"]["seconds"].take();
            receipt["body"]["peak_memory_bytes"].take();
            bytes = receipt.to_string().into_bytes();
        }
        (path, bytes)
    };
    files_below(root).into_iter().map(read).collect()
}

/// Training near a capture's cameras is in the receipt whole: whoever has the original fits the extractor again without
/// the capture's files.
#[test]
fn a_captures_cameras_are_kept_in_the_receipt_and_the_extractor_follows_from_them() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.set("--extractor", "blind");
    let places = [[-1.0, -4.0, 1.0], [1.0, -4.0, 1.0], [0.5, -3.0, 2.5], [-3.0, 2.0, 0.5]].map(DVec3::from_array);
    let shots = |size| places.map(|place| Shot::looking(place, DVec3::new(0.0, 0.1, 0.0), 50.0, size));
    let cameras = Format::Inria.write(small.folder.path(), &shots([64, 64]));
    let name = cameras.display().to_string();
    small.run("out", &["--train-cameras", &name, "--min-accuracy", "0"]).done();
    fs::remove_file(&cameras).expect("it was there");
    let receipt: Value =
        serde_json::from_slice(&fs::read(small.out("out/private/receipt.json")).expect("readable")).expect("JSON");
    let views = &receipt["body"]["settings"]["config"]["views"];
    assert_eq!(views["cameras"].as_array().map(Vec::len), Some(4), "{views}");
    let target: Vec<f64> = serde_json::from_value(views["target"].clone()).expect("a point");
    assert!(DVec3::from_slice(&target).distance(DVec3::new(0.0, 0.1, 0.0)) < 1e-4, "what they look at: {target:?}");
    // The preview is the film of the evaluation, so that its cameras are known.
    let verify = |orbit: &str| {
        let names = ["out/preview", "owner.key", "out/private/receipt.json", "model.ply"];
        let [clip, key, receipt, original] = &names.map(|name| small.out(name));
        let place = ["target", "up"].map(|what| views[what].to_string().replace(['[', ']'], ""));
        let number = |what: &str| views[what].to_string();
        let (radius, fov) = (number("radius"), number("fov_deg"));
        let args: [&dyn AsRef<OsStr>; 9] =
            [&"verify", clip, &"--key", key, &"--receipt", receipt, &"--original", original, &"--known-cameras"];
        let film: [&dyn AsRef<OsStr>; 14] = [
            &"--orbit",
            &orbit,
            &"--frames",
            &"2",
            &"--size",
            &"32x32",
            &"--target",
            &place[0],
            &"--up",
            &place[1],
            &"--radius",
            &radius,
            &"--fov",
            &fov,
        ];
        guard4d(&[&args[..], &film, &[&"--json"]].concat())
    };
    let judged = verify("1");
    let report: Value = serde_json::from_str(&judged.stdout).expect("JSON on stdout");
    assert_eq!(report["free_part"]["checked"]["how"], "refitted", "{report}");
    assert_eq!(report["choices"]["known_cameras"], 1, "{report}");
    let framings = &report["clips"][0]["framings"];
    assert_eq!((&framings["usual"], &framings["cut"]), (&Value::from(2), &Value::from(0)), "as training: {framings}");
    let refused = verify("3");
    assert_eq!(refused.code, 2, "{}", refused.stderr);
    assert!(refused.stderr.contains("cameras of the film: 6, expected 2"), "{}", refused.stderr);

    let wide = Format::Inria.write(small.folder.path(), &shots([96, 54])).display().to_string();
    let refused = small.run("wide", &["--train-cameras", &wide]);
    assert_eq!(refused.code, 2, "{}", refused.stderr);
    for word in ["cameras of training", "96 x 54 px", "set --size"] {
        assert!(refused.stderr.contains(word), "`{word}` is not in {}", refused.stderr);
    }
    assert!(!small.out("wide").exists(), "nothing is written");
}

/// What is chosen with the message known is counted by whoever verifies, and told.
#[test]
fn a_chosen_rotation_is_in_the_report_and_in_the_p_value() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.set("--extractor", "blind");
    let run = small.run("out", &["--rotations", "2", "--min-accuracy", "0", "--json"]);
    run.done();
    let embedded: Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
    assert_eq!(embedded["key_rotation"]["of"], 2, "{embedded}");
    let verify = |more: &[&str]| {
        let files = ["out/preview", "owner.key", "out/private/receipt.json"].map(|name| small.out(name));
        let [clip, key, receipt] = &files;
        let args: [&dyn AsRef<OsStr>; 6] = [&"verify", clip, &"--key", key, &"--receipt", receipt];
        let more: Vec<&dyn AsRef<OsStr>> = more.iter().map(|arg| arg as &dyn AsRef<OsStr>).collect();
        guard4d(&[&args[..], &more].concat())
    };
    let run = verify(&["--json"]);
    let report: Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
    assert_eq!(report["key_rotation"], embedded["key_rotation"], "{report}");
    let p = &report["evidence"]["p_value"];
    assert!(p["kind"] == "searched" && p["searched"] == 2 && p["soft_score"].is_number(), "{report}");
    let text = verify(&[]).stdout;
    assert!(
        text.contains("at most, of the best of 2 claims")
            && text.contains("a rotation, an edit or a receipt was chosen"),
        "{text}"
    );
    small.set("--extractor", "joint");
    small.run("other", &["--rotations", "2"]).refused(2, &["rotations", "joint", "blind"]);
}

#[test]
fn a_conversion_is_read_for_the_message_that_was_given() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.set("--extractor", "blind");
    small.run("out", &["--message", "hex:a5", "--min-accuracy", "0"]).done();
    let [model, given, key, receipt] =
        ["out/marked/model.ply", "given.glb", "owner.key", "out/private/receipt.json"].map(|name| small.out(name));
    guard4d(&[&"convert", &model, &given]).done();
    let verify = |message: &[&str]| {
        let args: [&dyn AsRef<OsStr>; 7] = [&"verify", &given, &"--json", &"--key", &key, &"--receipt", &receipt];
        let views: [&dyn AsRef<OsStr>; 6] = [&"--size", &"32x32", &"--orbit", &"1", &"--frames", &"2"];
        let message: Vec<&dyn AsRef<OsStr>> = message.iter().map(|arg| arg as &dyn AsRef<OsStr>).collect();
        guard4d(&[&args[..], &views, &message].concat())
    };
    verify(&[]).refused(65, &["receipt.json", "message_mac", "--message"]);
    let run = verify(&["--message", "hex:a5"]);
    // Two frames and eight bits prove nothing either way.
    assert_eq!(run.code, 4, "{}", run.stderr);
    let report: Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
    assert!(report["frames"] == 2 && report["evidence"]["num_bits"] == 8, "{report}");
}

#[test]
fn an_interrupted_run_goes_on_to_the_same_bytes() {
    let Some(gpu) = device() else { return };
    let small = Small::new(&gpu);
    let checkpoint = small.out(CHECKPOINT);
    let stopped = small.interrupt("INT", ("out", &["--checkpoint-every", "0"]), || checkpoint.exists());
    stopped.refused(75, &["interrupted; checkpoint at", CHECKPOINT, "--resume"]);
    assert_eq!(
        names(small.folder.path()),
        ["model.ply", CHECKPOINT, "owner.key"],
        "a checkpoint, and no output, whole or partial"
    );
    let file = TensorFile::read(&checkpoint).expect("a checkpoint");
    let step: u32 = file.text("step").expect("a step").parse().expect("a number");
    assert!((1..STEPS).contains(&step), "stopped after step {step}");
    let resumed = small.run("out", &["--resume", "--min-accuracy", "0"]);
    resumed.done();
    assert_eq!(names(small.folder.path()), ["model.ply", "out", "owner.key"], "a finished run needs no checkpoint");

    // The unbroken run, with a gate that no marked model passes: an infinite PSNR would mean no mark.
    let missed = small.run("unbroken", &["--json", "--min-accuracy", "0", "--min-psnr", "200"]);
    assert_eq!(missed.code, 1, "the quality gate: {}", missed.stderr);
    let said = "quality gate missed: PSNR of whole frames:";
    assert!(missed.stderr.contains(said) && missed.stderr.contains("at least 200.00 dB"), "{}", missed.stderr);
    let printed: Value = serde_json::from_str(&missed.stdout).expect("JSON on stdout");
    assert_eq!(printed["missed"][0]["field"], "psnr", "{printed}");
    assert_eq!(printed["missed"][0]["got"], printed["psnr"]["mean_of_views_db"], "the measured figure: {printed}");
    assert_eq!(printed["missed"].as_array().map(Vec::len), Some(1), "the accuracy passes: {printed}");
    let receipt = fs::read(small.out("unbroken").join("private/receipt.json")).expect("a receipt");
    let receipt: Value = serde_json::from_slice(&receipt).expect("JSON");
    let classes = &receipt["body"]["figures"]["classes"];
    assert_eq!(*classes, printed["classes"], "films of each class are measured, printed and sealed");
    assert_eq!(classes.as_object().map(serde_json::Map::len), Some(10), "{classes}");
    assert_eq!(classes["off-centre"]["films"], 2, "{classes}");
    let peak = printed["peak_memory_bytes"].as_u64().expect("a number of bytes");
    assert_eq!(receipt["body"]["peak_memory_bytes"], peak, "the receipt has what is printed");
    // The weights of the joint network alone are larger; a float has four bytes.
    assert!(peak > 4 * 60 * 48, "{peak} bytes are more than the splats' colours need");
    let (unbroken, resumed) = (contents(&small.out("unbroken")), contents(&small.out("out")));
    assert_eq!(unbroken.len(), 6, "PLY, three private files and two frames");
    for (a, b) in unbroken.iter().zip(&resumed) {
        assert_eq!(a.0, b.0, "the same files");
        assert!(a.1 == b.1, "{}: the same bytes with and without a break", a.0.display());
    }
    assert_eq!(unbroken.len(), resumed.len(), "no file more");
}

#[test]
fn a_signal_before_the_first_step_leaves_a_checkpoint_too() {
    let Some(gpu) = device() else { return };
    let small = Small::new(&gpu);
    small.run("out", &["--resume"]).refused(66, &[CHECKPOINT, "not found"]);
    put(small.folder.path(), CHECKPOINT, b"no checkpoint");
    small.run("out", &["--resume"]).refused(65, &[CHECKPOINT]);
    assert_eq!(names(small.folder.path()), ["model.ply", CHECKPOINT, "owner.key"], "no output, whole or partial");
    fs::remove_file(small.out(CHECKPOINT)).expect("writable");
    // Not Ctrl-C, but what a scheduler sends when the time is up.
    let begun = || is_begun(small.folder.path(), "out");
    small.interrupt("TERM", ("out", &[]), begun).refused(75, &["interrupted; checkpoint at"]);
    assert_eq!(names(small.folder.path()), ["model.ply", CHECKPOINT, "owner.key"], "the partial output is gone");
    let file = TensorFile::read(&small.out(CHECKPOINT)).expect("a checkpoint");
    assert_eq!(file.text("step").expect("a step"), "0", "nothing was done yet");
}

#[test]
fn impossible_gates_and_settings_are_refused_before_work() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.run("out", &["--min-accuracy", "90"]).refused(2, &["least bit accuracy: 90", "a share from 0 to 1"]);
    small.run("out", &["--min-accuracy", "NaN"]).refused(2, &["least bit accuracy: NaN"]);
    small.run("out", &["--min-accuracy", "above:2"]).refused(2, &["least bit accuracy of a class: 2"]);
    small.run("out", &["--min-accuracy", "sideways:0.9"]).refused(2, &["sideways", "usual, above, below"]);
    small.run("out", &["--min-accuracy", "above:most"]).refused(2, &["above:most", "above:0.9"]);
    small
        .run("out", &["--min-accuracy", "above:0.9", "--class-films", "0"])
        .refused(2, &["least bit accuracy of a class", "class-films 0", "at least one film"]);
    small.run("out", &["--class-films", "4000000000"]).refused(2, &["class-films: 4000000000", "at most 100"]);
    small.run("out", &["--min-psnr", "inf"]).refused(2, &["least PSNR: inf"]);
    small.run("out", &["--target-psnr", "10"]).refused(2, &["target PSNR: 10"]);
    small.run("out", &["--control-every", "0"]).refused(2, &["control_every: 0", "at least 1"]);
    small.run("out", &["--control", "bce"]).refused(2, &["inverse-bce:EPS"]);
    small.run("out", &["--lambda-recon=-1"]).refused(2, &["lambda_recon: -1"]);
    small.run("out", &["--visibility-share", "0"]).refused(2, &["visibility_share: 0", "at most 1"]);
    small.run("out", &["--distort", "blur:1..2"]).refused(2, &["blur:1..2", "one strength"]);
    small.set("--extractor", "blind");
    small.run("out", &["--control-every", "2"]).refused(2, &["--control-every", "`blind`", "`joint`"]);
    small.set("--probes", "7");
    small.run("out", &[]).refused(2, &["probes: 7", "at least one per bit, 8"]);
    assert_eq!(names(small.folder.path()), ["model.ply", "owner.key"], "no output, whole or partial");
}

#[test]
fn the_receipt_tells_how_often_there_was_a_control() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.set("--steps", "3");
    small.run("out", &["--control-every", "2", "--min-accuracy", "0"]).done();
    let receipt = fs::read(small.out("out").join("private/receipt.json")).expect("a receipt");
    let receipt: Value = serde_json::from_slice(&receipt).expect("JSON");
    assert_eq!(receipt["body"]["settings"]["config"]["extractor"]["control_every"], 2, "{receipt}");
    assert_eq!(receipt["body"]["settings"]["steps_taken"], 3, "{receipt}");
}

#[test]
fn the_receipt_and_the_report_tell_what_each_phase_bought() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.set("--extractor", "blind");
    small.set("--steps", "3");
    let done = small.run("out", &["--fit", "auto", "--json", "--min-accuracy", "0"]);
    done.done();
    let printed: Value = serde_json::from_str(&done.stdout).expect("JSON on stdout");
    let receipt = fs::read(small.out("out").join("private/receipt.json")).expect("a receipt");
    let receipt: Value = serde_json::from_slice(&receipt).expect("JSON");
    let phases = printed["phases"].as_array().expect("a list");
    assert_eq!(phases.len(), 1, "the least will do where nothing is asked for: {printed}");
    assert_eq!(
        (&phases[0]["stop_reason"], &phases[0]["steps"], &phases[0]["clips"]),
        (&"enough".into(), &1.into(), &1.into())
    );
    // Read as single precision, which the two files print with different numbers of digits.
    let reports =
        |phases: &Value| serde_json::from_value::<Vec<PhaseReport>>(phases.clone()).expect("reports of phases");
    assert_eq!(reports(&receipt["body"]["settings"]["phases"]), reports(&printed["phases"]), "{receipt}");
    assert_eq!(receipt["body"]["settings"]["config"]["schedule"]["phases"][0]["bases"], "all", "{receipt}");
    assert_eq!(printed["evaluations"][0]["step"], 1, "{printed}");
    assert!(printed["seconds"]["train in phase 1"].as_f64().is_some_and(|s| s > 0.0), "{printed}");
    let told = small.run("again", &["--fit", "auto", "--min-accuracy", "0"]);
    told.done();
    assert!(told.stdout.contains("1 clips, 1 steps: enough; held out: bits right"), "{}", told.stdout);
}

#[test]
fn lpips_is_trained_and_reported_with_the_weights_that_were_given() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.set("--steps", "3");
    small.set("--extractor", "blind");
    let weights = random_lpips::write(small.folder.path()).display().to_string();
    small.run("out", &["--lambda-lpips", "1"]).refused(2, &["--lpips <FILE>"]);
    small.run("out", &["--lpips", "nowhere.safetensors"]).refused(66, &["nowhere.safetensors"]);
    small.run("out", &["--lpips", &weights, "--lpips-crop", "8"]).refused(2, &["LPIPS compares: 8", "at least 31 px"]);
    let options = ["--lpips", &weights, "--lambda-lpips", "0.5", "--lpips-input", "unit", "--lpips-every", "2"];
    let done = small.run("out", &[&options[..], &["--json", "--min-accuracy", "0"]].concat());
    done.done();
    let printed: Value = serde_json::from_str(&done.stdout).expect("JSON on stdout");
    assert!(printed["lpips"].as_f64().is_some_and(|v| v > 0.0 && v.is_finite()), "{printed}");
    let receipt = fs::read(small.out("out").join("private/receipt.json")).expect("a receipt");
    let receipt: Value = serde_json::from_slice(&receipt).expect("JSON");
    assert_eq!(receipt["body"]["figures"]["lpips"], printed["lpips"], "{receipt}");
    let said = &receipt["body"]["settings"]["config"]["objective"]["lpips"];
    let digest = Digest::of_file(Path::new(&weights)).expect("readable").to_string();
    assert_eq!(said["network"]["blake3"], digest, "{said}");
    assert_eq!((&said["lambda"], &said["every"]), (&0.5.into(), &2.into()), "{said}");
    assert_eq!((&said["input"], &said["crop_px"]), (&"unit".into(), &Value::Null), "{said}");
}

#[test]
fn a_receipt_given_as_settings_gives_the_same_marked_model() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.set("--steps", "3");
    small
        .run("out", &["--distort", "noise:0..0.1", "--target-psnr", "41", "--fit", "auto", "--min-accuracy", "0"])
        .done();
    let (model, key) = (small.args[1].clone(), small.args[3].clone());
    let receipt = small.out("out").join("private/receipt.json");
    let again = |name: &str, config: &Path| {
        let out = small.out(name);
        let args: [&dyn AsRef<OsStr>; 8] = [&"embed", &model, &"--key", &key, &"--out", &out, &"--config", &config];
        guard4d(&[&args[..], &[&"--min-accuracy", &"0", &"--quiet"]].concat())
    };
    again("again", &receipt).done();
    let marked = |name: &str| contents(&small.out(name).join("marked"));
    assert!(marked("out") == marked("again"), "the same bytes");

    let shown = guard4d(&[&"embed", &"--config", &receipt, &"--show-config"]);
    shown.done();
    let path = put(small.folder.path(), "settings.toml", shown.stdout.as_bytes());
    let same = guard4d(&[&"embed", &"--config", &path, &"--show-config"]);
    assert_eq!(same.stdout, shown.stdout, "what is shown is what is in force");

    let body = Receipt::read(&receipt).expect("a receipt").body;
    let old = put(small.folder.path(), "old.json", old_receipt::seal("guard4d.receipt/1", &body).as_bytes());
    again("old", &old).refused(65, &["old.json", "schema", "guard4d.receipt/1", "guard4d.receipt/2"]);
    let lists = [("0.9", "[\"0.9\"]"), ("[\"0.9\", \"above:0.8\"]", "[\"0.9\", \"above:0.8\"]")];
    for (given, shown) in lists {
        let gate = put(small.folder.path(), "gate.toml", format!("[gate]\nmin_accuracy = {given}\n").as_bytes());
        let settings = guard4d(&[&"embed", &"--config", &gate, &"--show-config"]);
        settings.done();
        assert!(settings.stdout.contains(&format!("min_accuracy = {shown}")), "{given}: {}", settings.stdout);
    }
    let far = put(small.folder.path(), "far.toml", b"[views]\nradius = \"far\"\n");
    again("far", &far).refused(65, &["far.toml", "views.radius", "far", "f64"]);
    again("none", &small.out("nowhere.toml")).refused(66, &["nowhere.toml"]);
    let other = format!("[extractor]\nmode = \"pretrained\"\n[extractor.weights]\nblake3 = \"{}\"\n", "0".repeat(64));
    let other = put(small.folder.path(), "other.toml", other.as_bytes());
    again("other", &other).refused(65, &["the built-in pretrained extractor", "blake3", &"0".repeat(64)]);
}

#[test]
fn flags_of_other_extractors_are_refused() {
    let refuse = |flags: &[&dyn AsRef<OsStr>], words: &[&str]| {
        let args: [&dyn AsRef<OsStr>; 2] = [&"embed", &"--show-config"];
        guard4d(&[&args[..], flags].concat()).refused(2, words);
    };
    refuse(&[&"--pretrained", &"file"], &["--pretrained", "`blind`", "`pretrained`"]);
    refuse(&[&"--extractor", &"pretrained", &"--probes", &"32"], &["--probes", "`none` or `blind` or `joint`"]);
    refuse(&[&"--tmsd-held", &"0.5"], &["--tmsd-held", "`blind`", "`joint`"]);
}

#[test]
fn help_shows_eighteen_flags_under_four_headings() {
    let run = guard4d(&[&"embed", &"-h"]);
    run.done();
    let under = |heading: &str| -> Vec<String> {
        let (_, rest) = run.stdout.split_once(&format!("\n{heading}:\n")).unwrap_or_else(|| panic!("{heading}"));
        let lines = rest.lines().take_while(|line| !line.is_empty());
        let flag = |line: &str| Some(line.split_once("--")?.1.split([' ', '=', ',']).next()?.to_owned());
        lines.filter(|line| line.trim_start().starts_with('-')).filter_map(flag).collect()
    };
    assert_eq!(under("What"), ["key", "clip", "message", "out", "overwrite", "config", "show-config"]);
    assert_eq!(under("Training views"), ["target", "radius", "fov", "size"]);
    assert_eq!(under("Quality"), ["profile", "target-psnr", "distort", "cameras", "orbit"]);
    assert_eq!(under("Resources"), ["resume", "dry-run"]);
}

#[test]
fn a_dry_run_tells_what_it_takes_and_writes_nothing() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.set("--extractor", "blind");
    let told = small.run("out", &["--dry-run", "--json"]);
    told.done();
    assert_eq!(names(small.folder.path()), ["model.ply", "owner.key"], "nothing is written");
    let told: Value = serde_json::from_str(&told.stdout).expect("JSON on stdout");
    assert_eq!((&told["splats"], &told["clips"]), (&60.into(), &4.into()), "two clips, two held out: {told}");
    let bytes = |value: &Value| value.as_u64().expect("a number of bytes");
    let (peak, resident) = (bytes(&told["peak_memory_bytes"]), bytes(&told["resident_bytes"]));
    assert_eq!(peak, resident + 4 * bytes(&told["clip_bytes"]), "{told}");
    for stage in ["plan_seconds", "fit_seconds", "train_seconds"] {
        assert!(told[stage].as_f64().is_some_and(|s| s > 0.0 && s.is_finite()), "{stage}: {told}");
    }

    let done = small.run("out", &["--json", "--min-accuracy", "0"]);
    done.done();
    let printed: Value = serde_json::from_str(&done.stdout).expect("JSON on stdout");
    let off = peak as f64 / bytes(&printed["peak_memory_bytes"]) as f64;
    assert!((0.95..=1.05).contains(&off), "told {peak} bytes, took {}", printed["peak_memory_bytes"]);

    // The weights alone are more.
    small.run("tight", &["--vram-budget", "8MiB"]).refused(69, &["memory budget of 8388608"]);
    small.run("tight", &["--vram-budget", "many"]).refused(2, &["--vram-budget", "many"]);
    assert_eq!(names(small.folder.path()), ["model.ply", "out", "owner.key"], "no output of the refused runs");
}

#[test]
fn an_spz_stays_one_only_when_asked_to() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    let refused = small.run("out", &["--lossy"]);
    refused.refused(2, &["model.ply with --lossy: PLY", "an SPZ file"]);
    assert!(!small.out("out").exists(), "nothing was written");
    let path = Path::new("model.spz");
    let packed = Export::Spz.encode(path, &gaussians(60, 1, 3)).expect("it fits");
    small.args[1] = put(small.folder.path(), "model.spz", &packed).display().to_string();
    small.set("--extractor", "blind");
    // Any mark will do: what is asked here is where it went.
    let floats = small.run("floats", &["--min-accuracy", "0"]);
    floats.done();
    assert_eq!(names(&small.out("floats").join("marked")), ["model.ply"]);
    small.run("steps", &["--min-accuracy", "0", "--lossy"]).done();
    let marked = small.out("steps").join("marked");
    assert_eq!(names(&marked), ["model.spz"]);
    let (before, after) = (Model::open(&small.out("model.spz")), Model::open(&marked.join("model.spz")));
    let (before, after) = (before.expect("an SPZ").gaussians, after.expect("an SPZ").gaussians);
    assert_ne!(before.sh_coeffs, after.sh_coeffs, "the offsets survive the rounding");
    assert_eq!(offset_on(&small.out("steps")), "SH");
    assert_eq!(before, Gaussians { sh_coeffs: before.sh_coeffs.clone(), ..after }, "and nothing else changed");
}

/// What a receipt says that the offsets were added to.
fn offset_on(out: &Path) -> String {
    let receipt = fs::read(out.join("private/receipt.json")).expect("a receipt");
    let receipt: Value = serde_json::from_slice(&receipt).expect("JSON");
    receipt["body"]["settings"]["offset_on"].as_str().expect("a word").to_owned()
}

#[test]
fn receipts_tell_of_offsets_on_plain_colours() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(&gpu);
    small.args[1] = put(small.folder.path(), "take.ply", &on_paths(60)).display().to_string();
    small.set("--extractor", "blind");
    small.run("out", &["--min-accuracy", "0"]).done();
    assert_eq!(offset_on(&small.out("out")), "RGB");
}
