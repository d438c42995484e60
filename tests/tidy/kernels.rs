//! What every kernel brings along, and what the layers around kernels leave to one another.

use std::fs;

use super::sources::{assert_none, code, files, has_word, name, offences, root, shaders, text};

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
    (!named).then(|| format!("glsl/{family}/{stem}.comp: benches/kernels/{family}.rs does not name `{op}`"))
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
        gaps.extend(bench_gap(family, stem, &text(&root().join(format!("benches/kernels/{family}.rs")))));
    }
    assert_none("every operation has a benchmark", &gaps);
}

/// Name of the kernel that the build makes of a shader and one of its variants: that of a tile kernel is the tile
/// kernel of the variant.
fn variant_of(stem: &str, variant: &str) -> String {
    match stem.strip_suffix("_tile") {
        Some(base) => format!("{base}_{variant}_tile"),
        None => format!("{stem}_{variant}"),
    }
}

/// Variants of shaders, as `glsl/permutations.toml` lists them, that no row of their family's benchmark is there for,
/// and those of shaders that do not exist; `read` is `None` for a file that is not there.
fn variant_gaps(permutations: &str, read: impl Fn(&str) -> Option<String>) -> Vec<String> {
    let shaders: toml::Table = permutations.parse().expect("permutations are TOML");
    let mut gaps = Vec::new();
    for (shader, variants) in &shaders {
        let file = format!("glsl/{shader}.comp");
        let (family, stem) = shader.split_once('/').unwrap_or_else(|| panic!("{shader}: family/stem"));
        if read(&file).is_none() {
            gaps.push(format!("glsl/permutations.toml: there is no {file}"));
        }
        let bench = format!("benches/kernels/{family}.rs");
        let rows = read(&bench).unwrap_or_default();
        for variant in variants.as_table().unwrap_or_else(|| panic!("{shader}: variant = [defines]")).keys() {
            let kernel = format!("{}::KERNEL", variant_of(stem, variant));
            if !rows.lines().any(|line| code(line).contains("bench.expect(") && has_word(code(line), &kernel)) {
                gaps.push(format!("{file}: no row of {bench} expects {kernel}"));
            }
        }
    }
    gaps
}

/// A row that expects a kernel fails when it runs without it (`./x bench --check`), so that the name alone is no way
/// out.
#[test]
fn every_variant_of_a_shader_has_a_benchmark() {
    let gaps =
        variant_gaps(&text(&root().join("glsl/permutations.toml")), |file| fs::read_to_string(root().join(file)).ok());
    assert_none("every variant of a shader has a benchmark", &gaps);
}

#[test]
fn variants_without_a_benchmark_are_named() {
    let listed =
        "# variants\n[\"optim/adam_step\"]\nrated = [\"RATED\"]\n[\"nn/dot_fwd_tile\"]\nwide = [\"WIDE\", \"X\"]\n";
    let with = |optim: &str, nn: &str| {
        variant_gaps(listed, |file| match file {
            "benches/kernels/optim.rs" => Some(optim.to_owned()),
            "benches/kernels/nn.rs" => Some(nn.to_owned()),
            _ => file.starts_with("glsl/").then(String::new),
        })
    };
    let (rated, wide) =
        ("bench.expect(name, &[&adam_step_rated::KERNEL])", "bench.expect(n, &[&dot_fwd_wide_tile::KERNEL])");
    assert!(with(rated, wide).is_empty(), "both have a row: {:?}", with(rated, wide));
    for optim in [
        "",
        "use guard4d_kernels::registry::optim::adam_step_rated;",
        "// bench.expect(name, &[&adam_step_rated::KERNEL])",
        "bench.expect(name, &[&adam_step::KERNEL])",
        "bench.expect(name, &[&old_adam_step_rated::KERNEL])",
    ] {
        let gaps = with(optim, wide);
        assert!(gaps.len() == 1 && gaps[0].contains("adam_step_rated::KERNEL"), "{optim}: {gaps:?}");
    }
    let gaps = with(rated, "bench.expect(n, &[&dot_fwd_tile_wide::KERNEL])");
    assert_eq!(gaps, ["glsl/nn/dot_fwd_tile.comp: no row of benches/kernels/nn.rs expects dot_fwd_wide_tile::KERNEL"]);
    assert_eq!(variant_gaps(listed, |_| None).len(), 4, "no shaders, no rows");
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
fn engine_knows_no_binding() {
    let breaks = |line: &str| code(line).contains("binding");
    assert!(breaks("rec.bind(binding: 3)"), "a binding number is seen");
    let found = offences(&files("engine/src", &["rs"]), breaks);
    assert_none("engine names no binding", &found);
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
