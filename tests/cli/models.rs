//! Model files that must be refused: told with file, field, what was found and what was expected.

use std::fs;
use std::time::{Duration, Instant};

use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::scene::ply;

use super::{guard4d, names, put, scratch};
use crate::support::fixture::{SPLATS, TinyModel, cfg_args, gaussians, tensors};
use crate::support::gpu::device;
use crate::support::owner::key_file;
use crate::support::pth_builder::{Pickle, RawView, archive, bare};

const PLY: &str = "point_cloud.ply";
/// Far more than any refusal needs, and far less than the work that a hostile file asks for.
const AT_ONCE: Duration = Duration::from_secs(20);

/// Opens a model whose `file` of the iteration folder is replaced by `bytes`; it must be refused with these words.
#[track_caller]
fn refused(file: &str, bytes: &[u8], words: &[&str]) {
    let model = TinyModel::new();
    model.write(&model.saved(file), bytes);
    let started = Instant::now();
    guard4d(&[&"inspect", &model.path()]).refused(65, &[&[file, "bad_data", "expected"], words].concat());
    assert!(started.elapsed() < AT_ONCE, "refused after {:?}", started.elapsed());
}

/// The PLY of the tiny model with its head edited.
fn edited(from: &str, to: &str) -> Vec<u8> {
    let whole = ply::encode(&gaussians(SPLATS, 3, 20000));
    let mark = b"end_header\n";
    let end = whole.windows(mark.len()).position(|w| w == mark).expect("a head") + mark.len();
    let head = std::str::from_utf8(&whole[..end]).expect("the head is text");
    assert!(head.contains(from), "`{from}` is in the head");
    [head.replacen(from, to, 1).as_bytes(), &whole[end..]].concat()
}

#[test]
fn a_missing_ply_is_a_missing_input() {
    let model = TinyModel::new();
    fs::remove_file(model.file(&model.saved(PLY))).expect("writable");
    guard4d(&[&"inspect", &model.path()]).refused(66, &["point_cloud.ply: not found", "missing_input"]);
    let alone = model.file("alone.ply");
    guard4d(&[&"inspect", &alone]).refused(66, &["alone.ply: not found"]);
}

#[test]
fn plys_of_a_wrong_length_are_refused() {
    let whole = ply::encode(&gaussians(SPLATS, 3, 20000));
    refused(PLY, b"", &["header: no `end_header` in the first 0 bytes"]);
    refused(PLY, b"ply\nformat", &["header: no `end_header`"]);
    let needed = "744 (3 `vertex` records of 248 bytes)";
    refused(PLY, &whole[..whole.len() - 5], &["body: 739 bytes", needed]);
    refused(PLY, &[&whole[..], &[0; 4096]].concat(), &["body: 4840 bytes", needed]);
    refused(PLY, &edited("vertex 3", "vertex 4000000000"), &["body: 744 bytes, expected 992000000000"]);
    refused(PLY, &edited("vertex 3", "vertex 18446744073709551615"), &["more than memory can hold"]);
    refused(PLY, &edited("vertex 3", "vertex 0"), &["0 splats", "at least one"]);
}

#[test]
fn plys_with_other_properties_are_refused() {
    refused(PLY, &edited("float opacity", "int opacity"), &["`opacity`", "I32"]);
    refused(PLY, &edited("float opacity", "quad opacity"), &["header line", "`opacity` of type `quad`"]);
    refused(PLY, &edited("float nx", "list uchar int nx"), &["header line", "list properties are not read"]);
    refused(PLY, &edited("float rot_3", "float other"), &["`rot_3`", "missing"]);
    refused(PLY, &edited("float y", "float x"), &["`x` a second time", "each property once"]);
    refused(PLY, &edited("f_rest_44", "f_rest_99"), &["`f_rest_44`", "missing"]);
}

#[test]
fn splats_that_are_no_numbers_are_left_out_and_told_of() {
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let model = TinyModel::new();
        let mut splats = gaussians(SPLATS, 3, 1);
        splats.opacities[1] = poison;
        model.write(&model.saved(PLY), &ply::encode(&splats));
        let run = guard4d(&[&"inspect", &model.path(), &"--json"]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        assert!(run.stdout.contains("1 splat of 3 left out"), "{}", run.stdout);
        assert!(run.stdout.contains("\"splats\": 2"), "{}", run.stdout);
    }
}

#[test]
fn files_of_another_run_are_refused() {
    let per_splat = RawView::contiguous(&[SPLATS + 1]);
    let table = bare("BoolStorage", &per_splat, 4, &[1; SPLATS + 1]);
    refused("deformation_table.pth", &table, &["shape: [4]", "[3], one row per splat of point_cloud.ply"]);
    let per_splat = RawView::contiguous(&[SPLATS + 1, 3]);
    let accum = bare("FloatStorage", &per_splat, 3 * (SPLATS as i32 + 1), &[0; 12 * (SPLATS + 1)]);
    refused("deformation_accum.pth", &accum, &["shape: [4, 3]", "[3, 3], one row per splat of point_cloud.ply"]);
    let model = TinyModel::new();
    model.write(&model.saved(PLY), &ply::encode(&gaussians(SPLATS + 1, 3, 1)));
    let words = ["deformation_table.pth", "shape: [3]", "[4], one row per splat"];
    guard4d(&[&"inspect", &model.path()]).refused(65, &words);
}

#[test]
fn networks_with_other_tensors_are_refused() {
    let model = TinyModel::new();
    let open = || guard4d(&[&"inspect", &model.path()]);
    let mut missing = tensors();
    let name = missing.pop().expect("there are tensors").name;
    model.write_tensors(&missing);
    open().refused(65, &["deformation.pth", &name, "missing"]);
    let mut poisoned = tensors();
    poisoned.last_mut().expect("there are tensors").values[0] = f32::NAN;
    model.write_tensors(&poisoned);
    open().refused(65, &["deformation.pth", &name, "NaN at element 0", "finite"]);
}

#[test]
fn a_hostile_pickle_is_refused_and_never_run() {
    let model = TinyModel::new();
    let proof = model.file("executed");
    let command = format!("touch {}", proof.display());
    let pickle = Pickle::new().global("os", "system").text(&command).op(b"\x85R").stop();
    model.write(&model.saved("deformation.pth"), &archive(pickle, &[]));
    guard4d(&[&"inspect", &model.path()]).refused(65, &["deformation.pth", "`os.system`", "was not run"]);
    assert!(!proof.exists(), "the payload was not run");
}

#[test]
fn pickles_that_want_all_memory_are_refused_at_once() {
    let pth = "deformation.pth";
    // 2^60 leaves in 180 bytes. Values on the stack are indices, so what is shared is never copied, and no limit is
    // needed: the program ends, with more left on its stack than the one value of a saved file.
    let bomb = (0..60_u8)
        .fold(Pickle::new().op(b")q\x00"), |pickle, step| pickle.op(&[b'h', step, b'h', step, 0x86, b'q', step + 1]));
    refused(pth, &archive(bomb.stop(), &[]), &["data.pkl: more after its end", "expected one value"]);
    let deep = (0..200_000).fold(Pickle::new().op(b")"), |pickle, _| pickle.op(b"\x85"));
    refused(pth, &archive(deep.stop(), &[]), &["data.pkl: another root", "expected a state dict or a tensor"]);
    let long = Pickle::new().op(b"X\xff\xff\xff\xffabc").stop();
    refused(pth, &archive(long, &[]), &["end of program", "4294967295 more bytes"]);
    let wide = RawView { offset: 0, shape: vec![i32::MAX; 3], strides: vec![0; 3] };
    let words = ["shape [2147483647, 2147483647, 2147483647]", "at most the 4 elements of its storage"];
    refused("deformation_accum.pth", &bare("FloatStorage", &wide, 4, &[0; 16]), &words);
    let many = RawView { offset: 0, shape: vec![1; 9], strides: vec![1; 9] };
    let words = ["data.pkl byte", "9 dimensions", "expected at most 8"];
    refused("deformation_accum.pth", &bare("FloatStorage", &many, 4, &[0; 16]), &words);
    refused(pth, &archive(vec![b'N'; 1_000_001], &[]), &["a longer program", "at most 1000000 opcodes"]);
    refused(pth, b"\x80\x02.", &["3 bytes", "a ZIP archive"]);
}

#[test]
fn unknown_settings_of_a_model_are_refused() {
    let model = TinyModel::new();
    let open = || guard4d(&[&"inspect", &model.path()]);
    for (from, to, word) in [
        ("no_do=True", "no_do=True, no_gravity=True", "no_gravity"),
        ("no_do=True", "no_do='perhaps'", "no_do"),
        ("net_width=4", "net_width=__import__('os').getpid()", "__import__"),
    ] {
        model.write("cfg_args", cfg_args().replace(from, to).as_bytes());
        open().refused(65, &["cfg_args", word, "expected"]);
    }
    model.write("cfg_args", b"import os");
    open().refused(65, &["cfg_args"]);
}

/// The commands that write refuse as `inspect` does, before they work, and leave nothing.
#[test]
fn no_command_leaves_output_of_a_bad_model() {
    let Some(gpu) = device() else { return };
    let folder = scratch();
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let key = put(folder.path(), "owner.key", &key_file(&clip).to_bytes().expect("serialises"));
    let bad = put(folder.path(), "bad.ply", &edited("float opacity", "int opacity"));
    let good = put(folder.path(), "good.ply", &edited("float nx", "float nx"));
    let cameras = put(folder.path(), "cameras.json", b"{\"frames\": 7}");
    let out = folder.path().join("out");
    let video = folder.path().join("out.mp4");
    let words = ["bad.ply", "`opacity`"];
    guard4d(&[&"embed", &bad, &"--key", &key, &"--out", &out]).refused(65, &words);
    guard4d(&[&"render", &bad, &"--out", &out]).refused(65, &words);
    guard4d(&[&"render", &bad, &"--out", &video]).refused(65, &words);
    guard4d(&[&"lab", &"dump", &"deform", &bad, &"--time", &"0", &"--out", &out]).refused(65, &words);
    let words = ["cameras.json"];
    guard4d(&[&"render", &good, &"--cameras", &cameras, &"--out", &out]).refused(65, &words);
    guard4d(&[&"embed", &good, &"--key", &key, &"--cameras", &cameras, &"--out", &out]).refused(65, &words);
    let nowhere = folder.path().join("nowhere.json");
    guard4d(&[&"embed", &good, &"--key", &key, &"--cameras", &nowhere, &"--out", &out]).refused(66, &["nowhere.json"]);
    assert_eq!(
        names(folder.path()),
        ["bad.ply", "cameras.json", "good.ply", "owner.key"],
        "no output, whole or partial"
    );
}
