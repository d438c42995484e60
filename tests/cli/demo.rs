//! `guard4d demo`, cut short: small pictures, hardly any training, and keys whose decoders are random.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use guard4d_engine::media::{ReadOptions, read_clip};
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::release::receipt::Receipt;
use serde_json::Value;

use super::{Run, command, interrupted, is_begun, names, put, scratch};
use crate::support::gpu::{Gpu, device};
use crate::support::owner::{key_file, key_file_of};

/// Frames to film: as few as a verdict needs.
const FRAMES: usize = 8;
/// Rows whose value is a share in percent.
const SHARES: [&str; 6] = [
    "bits right, marked clips",
    "bits right, single frames",
    "clean control (50 % is chance)",
    "noisy control (50 % is chance)",
    "wrong key, its own message (50 % is chance)",
    "wrong key, the owner's message",
];
/// What takes time, by the names of the row `seconds`.
const STAGES: [&str; 7] = ["key ", "plan ", "fit ", "train ", "render ", "verify ", "wrong key "];

/// A folder with the keys of two people; a demonstration writes into `out` beside them.
struct Stand {
    folder: tempfile::TempDir,
    out: PathBuf,
}

impl Stand {
    fn new(gpu: &Gpu) -> Self {
        let folder = scratch();
        let clip = ClipModel::load(gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
        put(folder.path(), "owner.key", &key_file(&clip).to_bytes().expect("serialises"));
        put(folder.path(), "wrong.key", &key_file_of(&clip, [9; 32], 8).to_bytes().expect("serialises"));
        let out = folder.path().join("out");
        Self { folder, out }
    }

    /// The demonstration, to be started.
    fn command(&self, more: &[&str]) -> Command {
        let (key, wrong) = (self.folder.path().join("owner.key"), self.folder.path().join("wrong.key"));
        let args: [&dyn AsRef<OsStr>; 7] = [&"demo", &"--out", &self.out, &"--key", &key, &"--wrong-key", &wrong];
        let mut command = command(&args);
        command.args("--steps 1 --train-clips 1 --probes 8 --size 64x64".split(' '));
        command.args(["--frames", &FRAMES.to_string()]).args(more);
        command
    }

    /// Runs the demonstration with its results going to `stdout`.
    fn run(&self, more: &[&str], stdout: Stdio) -> Run {
        let child = self.command(more).stdout(stdout).stderr(Stdio::piped()).spawn();
        Run::of(child.and_then(Child::wait_with_output).expect("the program was built with the tests"))
    }

    /// Checks what lies in the output folder, and returns the receipt.
    fn written(&self) -> Receipt {
        let films = ["clean-frames", "clean.mp4", "copies", "leaked-copy.json", "leaked-copy.mp4"];
        let kept = ["marked", "marked-frames", "marked.mp4", "owner.key", "preview", "private", "verdict.html"];
        let wanted = [&films[..], &kept].concat();
        assert_eq!(names(&self.out), wanted, "frames, videos, model, key, receipt and page");
        let page = fs::read_to_string(self.out.join("verdict.html")).expect("a page");
        assert!(page.contains("marked.mp4") && page.contains("data-compare"), "film and original are compared");
        let read = |name: &str| read_clip(&self.out.join(name), &ReadOptions::default()).expect("a clip");
        for name in ["clean", "marked"] {
            let frames = read(&format!("{name}-frames"));
            assert_eq!((frames.frames().len(), frames.size_px()), (FRAMES, (64, 64)), "{name}: frames");
            let video = read(&format!("{name}.mp4"));
            assert_eq!((video.frames().len(), video.size_px()), (FRAMES, (64, 64)), "{name}: video");
        }
        let differ = read("clean-frames").digest() != read("marked-frames").digest();
        assert!(differ, "the mark changes pixels");
        let path = self.out.join("private/receipt.json");
        let receipt = Receipt::read(&path).expect("a receipt");
        receipt.verify_commitment(&path).expect("nothing was changed since");
        receipt
    }

    /// What the commands print that the page gives for repeating it, as JSON.
    fn repeated(&self) -> Value {
        let page = fs::read_to_string(self.out.join("verdict.html")).expect("a page");
        let commands = page.split("<pre tabindex=\"0\">").nth(1).and_then(|rest| rest.split("</pre>").next());
        let commands = commands.expect("the page says how it is repeated").replace("&amp;", "&");
        let runs = commands.split(" && ").map(|line| {
            let words: Vec<&str> = line.split_whitespace().skip(1).collect();
            let args: Vec<&dyn AsRef<OsStr>> = words.iter().map(|word| word as &dyn AsRef<OsStr>).collect();
            Run::of(command(&args).current_dir(&self.out).arg("--json").output().expect("it was built with the tests"))
        });
        let last = runs.last().expect("a command");
        serde_json::from_str(&last.stdout).unwrap_or_else(|e| panic!("{e}: {}{}", last.stdout, last.stderr))
    }
}

/// The number that `text` begins with.
fn number(text: &str) -> f64 {
    let first = text.split([' ', '%', ',']).next().unwrap_or_default();
    first.parse().unwrap_or_else(|e| panic!("`{text}`: {e}"))
}

/// What stands in the row `name` of a table.
fn row<'a>(table: &'a str, name: &str) -> &'a str {
    let found = table.lines().find_map(|line| line.trim_start().strip_prefix(name));
    found.unwrap_or_else(|| panic!("no row `{name}` in:\n{table}")).trim()
}

#[test]
fn a_demonstration_ends_and_tells_everything() {
    let Some(gpu) = device() else { return };
    if !crate::support::has_ffmpeg() {
        return;
    }
    let stand = Stand::new(&gpu);
    let run = stand.run(&[], Stdio::piped());
    let verdict = row(&run.stdout, "verdict");
    let code = ["PRESENT", "ABSENT", "INCONCLUSIVE"].iter().zip([0, 1, 4]).find(|(word, _)| **word == verdict);
    assert_eq!(code.map(|(_, code)| code), Some(run.code), "{verdict} and the exit code: {}", run.stderr);
    for name in SHARES {
        let share = number(row(&run.stdout, name));
        assert!((0.0..=100.0).contains(&share), "{name}: {share}");
    }
    for name in ["PSNR whole frame", "PSNR object only"] {
        let db = number(row(&run.stdout, name));
        assert!(db > 20.0 && db < 100.0, "{name}: {db} dB");
    }
    let ssim = number(row(&run.stdout, "SSIM"));
    assert!(ssim > 0.5 && ssim <= 1.0, "SSIM: {ssim}");
    for stage in STAGES {
        let after = row(&run.stdout, "seconds").split(", ").find_map(|part| part.strip_prefix(stage));
        assert!(after.is_some_and(|s| number(s) >= 0.0), "seconds of `{stage}` in:\n{}", run.stdout);
    }
    assert_eq!(row(&run.stdout, "evidence"), "exact p-value: the extractor never saw the message", "in words");
    let p = row(&run.stdout, "p-value");
    assert!(p.contains("exact") && number(p) > 0.0 && number(p) <= 1.0, "{p}");
    assert!(run.stderr.contains("5/5 trace") && run.stderr.contains("are in"), "{}", run.stderr);
    let receipt = stand.written();
    assert_eq!(receipt.body.settings["input"], "demo-scene", "what was marked");
    let shown = number(row(&run.stdout, SHARES[0]));
    let sealed = 100.0 * receipt.body.figures.bit_accuracy.clip;
    // Shown with one digit behind the point.
    assert!((shown - sealed).abs() <= 0.05 + 1e-9, "{shown} % shown, {sealed} % in the receipt");
}

#[test]
fn a_demonstration_prints_json_for_programs() {
    let Some(gpu) = device() else { return };
    if !crate::support::has_ffmpeg() {
        return;
    }
    let stand = Stand::new(&gpu);
    let run = stand.run(&["--json", "--quiet"], Stdio::piped());
    assert_eq!(run.stderr, "", "nothing to say");
    let printed: Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
    for name in ["own_message", "owners_message"] {
        let share = printed["wrong_key"][name].as_f64().unwrap_or(f64::NAN);
        assert!((0.0..=1.0).contains(&share), "{name}: {printed}");
    }
    assert!(printed["verification"]["evidence"]["verdict"].is_string(), "{printed}");
    assert!(printed["seconds"]["wrong key"].is_number(), "{printed}");
    // The fingerprint needs no training, and no large pictures.
    let tracing = &printed["tracing"];
    assert_eq!(tracing["verdict"], "traced", "{tracing}");
    assert_eq!(
        (&tracing["copies"][0]["recipient"], tracing["copies"].as_array().map(Vec::len)),
        (&"bo".into(), Some(1))
    );
    assert_eq!(printed["marked"], stand.written().body.figures.bit_accuracy.clip, "as in the receipt");
    let again = stand.repeated();
    assert_eq!(again["evidence"]["matches"], printed["verification"]["evidence"]["matches"], "read again");
    assert_eq!(again["free_part"], printed["verification"]["free_part"], "fitted to the original again");
}

#[test]
fn a_demonstration_whose_text_cannot_be_printed_is_kept() {
    let Some(gpu) = device() else { return };
    if !crate::support::has_ffmpeg() {
        return;
    }
    let Ok(full) = fs::File::options().write(true).open(Path::new("/dev/full")) else {
        crate::support::skipped("there is no /dev/full");
        return;
    };
    let stand = Stand::new(&gpu);
    stand.run(&["--quiet"], full.into()).refused(74, &["stdout", "No space left on device"]);
    stand.written();
}

#[test]
fn an_interrupted_demonstration_leaves_nothing() {
    let Some(gpu) = device() else { return };
    let stand = Stand::new(&gpu);
    let run = interrupted(stand.command(&[]), "INT", || is_begun(stand.folder.path(), "out"));
    run.refused(75, &["stopping after the work at hand", "interrupted; nothing was written"]);
    assert_eq!(names(stand.folder.path()), ["owner.key", "wrong.key"], "no output, whole or partial");
}

#[test]
fn what_shortens_a_demonstration_is_not_advertised() {
    let run = super::guard4d(&[&"demo", &"--help"]);
    run.done();
    assert!(run.stdout.contains("--seed") && !run.stdout.contains("--steps"), "{}", run.stdout);
    assert!(!run.stdout.contains("--wrong-key") && !run.stdout.contains("--probes"), "{}", run.stdout);
}
