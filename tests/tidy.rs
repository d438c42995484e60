//! House rules that the compiler cannot see; `ARCHITECTURE.md` says why each exists.
//!
//! Every rule collects all offences before it fails, and is itself tried on text that breaks it.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::files_below;

/// Longest source file, in lines; about 500 is the aim.
const MAX_LINES: usize = 700;

/// Folders of handwritten Rust.
const RUST_TREES: [&str; 6] = ["cli", "engine/src", "kernels/build", "kernels/src", "tests", "benches"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All files under `tree` (relative to the repository) whose extension is in `extensions`, sorted.
fn files(tree: &str, extensions: &[&str]) -> Vec<PathBuf> {
    let folder = root().join(tree);
    let wanted = |path: &PathBuf| path.extension().is_some_and(|e| extensions.iter().any(|x| e == *x));
    files_below(&folder).into_iter().filter(wanted).map(|path| folder.join(path)).collect()
}

fn rust_files() -> Vec<PathBuf> {
    let mut all: Vec<_> = RUST_TREES.iter().flat_map(|t| files(t, &["rs"])).collect();
    all.push(root().join("kernels/build.rs"));
    all
}

fn shaders() -> Vec<PathBuf> {
    files("glsl", &["comp", "glsl"])
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn name(path: &Path) -> String {
    let inside = path.strip_prefix(root()).unwrap_or(path);
    inside.display().to_string()
}

/// The line without its `//` comment. A `//` inside a string is cut too, which only hides text.
fn code(line: &str) -> &str {
    line.split("//").next().unwrap_or(line)
}

/// Whether `word` stands in `line` as a whole identifier.
fn has_word(line: &str, word: &str) -> bool {
    line.match_indices(word).any(|(at, _)| {
        let inside = |c: char| c.is_alphanumeric() || c == '_';
        !line[..at].ends_with(inside) && !line[at + word.len()..].starts_with(inside)
    })
}

/// `file:line` of every code line of `paths` that `breaks` the rule.
fn offences(paths: &[PathBuf], breaks: impl Fn(&str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for path in paths {
        for (i, line) in text(path).lines().enumerate() {
            if breaks(line) {
                found.push(format!("{}:{}: {}", name(path), i + 1, line.trim()));
            }
        }
    }
    found
}

fn assert_none(rule: &str, found: &[String]) {
    assert!(found.is_empty(), "{rule}:\n  {}", found.join("\n  "));
}

/// The operation of a kernel file: its stem without the last `_verb`, behind which the name of a kernel for GPUs has
/// `_tile` or `_coop`.
fn op_of(stem: &str) -> Option<&str> {
    let named = ["_tile", "_coop"].iter().find_map(|kind| stem.strip_suffix(kind)).unwrap_or(stem);
    named.rsplit_once('_').map(|(op, _verb)| op)
}

/// Whether a wrapper or a shader writes a gradient: it has a function `backward*`, or a buffer named `v_*`, which by
/// the house's names is dL/d*, that is not read only. So no backward kernel escapes by its verb.
fn writes_a_gradient(source: &str) -> bool {
    let named = |line: &str, mark: &str| {
        line.match_indices("v_").any(|(at, _)| {
            let starts = !line[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
            starts && line[at..].contains(mark)
        })
    };
    source.lines().map(code).any(|line| {
        let in_rust = line.contains("fn backward") || named(line, "mut Buffer<");
        let in_glsl = line.contains(" buffer ") && !line.contains("readonly") && named(line, "[]");
        in_rust || in_glsl
    })
}

/// What is missing around the kernel `glsl/<family>/<stem>.comp`; `read` is `None` for a file that is not there.
fn mirror_gaps(family: &str, stem: &str, read: impl Fn(&str) -> Option<String>) -> Vec<String> {
    let kernel = format!("glsl/{family}/{stem}.comp");
    let Some(op) = op_of(stem) else {
        return vec![format!("{kernel}: the name has no _verb")];
    };
    let [wrapper, twin, test] =
        ["kernels/src", "kernels/src/reference", "tests/kernels"].map(|tree| format!("{tree}/{family}/{op}.rs"));
    let missing = [&wrapper, &twin, &test].into_iter().filter(|file| read(file).is_none());
    let mut gaps: Vec<_> = missing.map(|file| format!("{kernel}: {file} is missing")).collect();
    let differentiates = [&kernel, &wrapper].into_iter().filter_map(|file| read(file)).any(|t| writes_a_gradient(&t));
    let checked = |text: String| text.lines().any(|line| code(line).contains("gradcheck("));
    if differentiates && read(&test).is_some_and(|text| !checked(text)) {
        gaps.push(format!("{kernel}: {test} never calls gradcheck"));
    }
    gaps
}

#[test]
fn every_kernel_has_a_wrapper_a_twin_and_a_test() {
    let mut gaps = Vec::new();
    for path in files("glsl", &["comp"]) {
        let shown = name(&path);
        let parts: Vec<_> = shown.trim_end_matches(".comp").split('/').collect();
        let [_, family, stem] = parts[..] else {
            gaps.push(format!("{shown}: kernels live in glsl/<family>/"));
            continue;
        };
        gaps.extend(mirror_gaps(family, stem, |p| fs::read_to_string(root().join(p)).ok()));
    }
    assert_none("the mirror rule", &gaps);
}

#[test]
fn gradients_are_seen_whatever_the_verb() {
    for source in [
        "pub fn backward_input(rec: &mut Recorder) {}",
        "    v_pixels: &mut Buffer<f32>,",
        "        v_kv: &'a mut Buffer<f32>,",
        "    (v_x, accumulate): (&mut Buffer<f32>, Accumulate),",
        "layout(set = 0, binding = 1) writeonly buffer VPixels { vec4 v_pixels[]; };",
        "layout(set = 0, binding = 5) buffer VSlots { vec4 v_slots[]; };",
    ] {
        assert!(writes_a_gradient(source), "{source}");
    }
    for source in [
        "    v_param: &Buffer<f32>,",
        "    conv_out: &mut Buffer<f32>,",
        "// fn backward",
        "layout(set = 0, binding = 1) readonly buffer VParam { float v_param[]; };",
        "layout(set = 0, binding = 1, rgba32f) uniform readonly imageBuffer v_y;",
    ] {
        assert!(!writes_a_gradient(source), "{source}");
    }
}

#[test]
fn mirror_rule_names_each_gap() {
    let nothing = mirror_gaps("optim", "adam_step", |_| None);
    assert_eq!(nothing.len(), 3, "wrapper, twin and test are all missing: {nothing:?}");
    let with = |in_test: &'static str, in_wrapper: &'static str, in_kernel: &'static str| {
        mirror_gaps("nn", "patch_fold", |file| {
            let found = if file.starts_with("tests/") {
                in_test
            } else if file.starts_with("glsl/") {
                in_kernel
            } else {
                in_wrapper
            };
            Some(found.to_owned())
        })
    };
    let (gradient, slot) = ("v_x: &mut Buffer<f32>,", "writeonly buffer VX { vec4 v_x[]; };");
    for text in ["fn empty() {}", "use support::gradcheck::gradcheck;", "// gradcheck(..)"] {
        let unchecked = [with(text, gradient, ""), with(text, "", slot), with(text, "", "")];
        let counts = unchecked.each_ref().map(Vec::len);
        assert_eq!(counts, [1, 1, 0], "only a gradient asks for its check: {unchecked:?}");
    }
    let complete = with("let error = gradcheck(f, &x, &grad);", gradient, slot);
    assert!(complete.is_empty(), "nothing is missing: {complete:?}");
    for verbless in ["gelu", "gelu_tile"] {
        let gaps = mirror_gaps("nn", verbless, |_| Some(String::new()));
        assert_eq!(gaps.len(), 1, "a kernel name needs a verb: {gaps:?}");
    }
    assert_eq!(op_of("conv3d_bwd_tile"), Some("conv3d"), "the kernel for GPUs is one of the same operation");
}

/// What is missing when no code of its family's benchmark names the operation of a kernel.
fn bench_gap(family: &str, stem: &str, bench: &str) -> Option<String> {
    let op = op_of(stem)?;
    let named = bench.lines().any(|line| has_word(code(line), op));
    (!named).then(|| format!("glsl/{family}/{stem}.comp: benches/{family}.rs does not name `{op}`"))
}

/// A quick look at what `./x bench` finds out by running: it fails when no row runs a kernel.
#[test]
fn every_operation_has_a_benchmark() {
    assert!(bench_gap("nn", "axpy_fwd", "// axpy\nuse guard4d_kernels::nn::saxpy;").is_some(), "a gap is seen");
    assert!(bench_gap("nn", "axpy_fwd", "axpy::forward(rec)").is_none(), "a call is accepted");
    let mut gaps = Vec::new();
    for path in files("glsl", &["comp"]) {
        let shown = name(&path);
        let [_, family, stem] = shown.trim_end_matches(".comp").split('/').collect::<Vec<_>>()[..] else { continue };
        gaps.extend(bench_gap(family, stem, &text(&root().join(format!("benches/{family}.rs")))));
    }
    assert_none("every operation has a benchmark", &gaps);
}

#[test]
fn shaders_include_only_lib() {
    let breaks = |line: &str| {
        let line = code(line).trim();
        line.starts_with("#include") && !line.contains("\"lib/")
    };
    assert!(breaks("#include \"nn/gelu_fwd.comp\""), "another family is refused");
    assert!(!breaks("#include \"lib/quat.glsl\""), "lib is accepted");
    assert_none("shaders include only lib/", &offences(&shaders(), breaks));
}

#[test]
fn only_kernels_names_the_vulkan_crate() {
    let word = concat!("a", "sh");
    let outside: Vec<_> = rust_files().into_iter().filter(|p| !name(p).starts_with("kernels/")).collect();
    let breaks = |line: &str| has_word(code(line), word);
    assert!(breaks(&format!("use {word}::vk;")), "a use is seen");
    assert!(!breaks("let hash = 1;"), "part of a word is not");
    let mut found = offences(&outside, breaks);
    let depends = |line: &str| line.trim_start().starts_with(word);
    found.extend(offences(&[root().join("engine/Cargo.toml")], depends));
    assert_none("only kernels names the Vulkan crate", &found);
}

#[test]
fn unsafe_code_stays_in_the_device_layer() {
    let word = concat!("un", "safe");
    let outside: Vec<_> = rust_files().into_iter().filter(|p| !name(p).starts_with("kernels/src/vk/")).collect();
    let breaks = |line: &str| has_word(code(line), word);
    assert!(breaks(&format!("{word} {{ f() }}")), "a block is seen");
    assert!(!breaks(&format!("#![forbid({word}_code)]")), "the lint's name is not");
    let found = offences(&outside, breaks);
    assert_none("such code only in kernels/src/vk", &found);
}

#[test]
fn files_stay_short() {
    let mut all = rust_files();
    all.extend(shaders());
    all.extend(files("tests", &["py"]));
    let long: Vec<_> = all
        .iter()
        .map(|p| (name(p), text(p).lines().count()))
        .filter(|(_, lines)| *lines > MAX_LINES)
        .map(|(file, lines)| format!("{file}: {lines} lines"))
        .collect();
    assert_none(&format!("files have at most {MAX_LINES} lines"), &long);
}

#[test]
fn engine_knows_no_binding() {
    let breaks = |line: &str| code(line).contains("binding");
    assert!(breaks("rec.bind(binding: 3)"), "a binding number is seen");
    let found = offences(&files("engine/src", &["rs"]), breaks);
    assert_none("engine names no binding", &found);
}

#[test]
fn nothing_is_left_for_later() {
    let marks = [
        concat!("TO", "DO"),
        concat!("FIX", "ME"),
        concat!("X", "XX"),
        concat!("to", "do!"),
        concat!("un", "implemented!"),
        concat!("#", "[ignore"),
    ];
    let breaks = |line: &str| marks.iter().any(|m| line.contains(m));
    assert!(breaks(&format!("// {}: later", marks[0])), "a note is seen");
    let mut all = rust_files();
    all.extend(shaders());
    all.extend(files("tests", &["py"]));
    all.extend(["x", ".ci/run"].map(|f| root().join(f)));
    assert_none("nothing is left for later", &offences(&all, breaks));
}

#[test]
fn kernels_read_no_file_and_no_environment() {
    let marks = ["std::env", "env::var", "std::fs", "fs::", "File::open"];
    let breaks = |line: &str| marks.iter().any(|m| code(line).contains(m));
    assert!(breaks("let x = std::env::var(\"A\");"), "a variable is seen");
    assert!(!breaks("include!(concat!(env!(\"OUT_DIR\")));"), "build output is fine");
    let found = offences(&files("kernels/src", &["rs"]), breaks);
    assert_none("kernels reads no file and no environment", &found);
}

#[test]
fn twins_stand_on_their_own() {
    let marks = ["vk", "registry"];
    let breaks = |line: &str| code(line).contains("use ") && marks.iter().any(|m| has_word(line, m));
    assert!(breaks("use crate::registry::optim::adam_step;"), "an import is seen");
    let found = offences(&files("kernels/src/reference", &["rs"]), breaks);
    assert_none("twins import neither vk nor registry", &found);
}
