//! Compiles every `glsl/**/*.comp` to SPIR-V 1.5, reflects it, and writes the typed registry. Any failure stops the
//! build.
//!
//! `X.comp` becomes a program of both kernel families, unless `X_tile.comp` is beside it: then each is one of its
//! family. `X_coop.comp` needs cooperative matrices and serves either family of a device that has them.

#[path = "build/compile.rs"]
mod compile;
#[path = "build/generate.rs"]
mod generate;
#[path = "build/reflect.rs"]
mod reflect;

use std::path::{Path, PathBuf};
use std::{env, fs};

/// What the shaders of the portable family see defined; `glsl/lib/texels.glsl` and `shuffle.glsl` say what it changes.
const TILES: &str = "TILES";

/// Ends the name of a shader that is another one's tile kernel.
const TILE_SUFFIX: &str = "_tile";
/// Ends the name of a shader over cooperative matrices.
const COOP_SUFFIX: &str = "_coop";

/// The extension that such a shader needs, as a compiler that does not know it says.
const COOP_EXTENSION: &str = "GL_KHR_cooperative_matrix";
/// What such a shader sees defined where the compiler does not know the extension.
const INTERFACE_ONLY: &str = "INTERFACE_ONLY";
/// The `cfg` of a crate that was built so.
const WITHOUT_COOP: &str = "without_cooperative_matrices";

/// A kernel and the names of its SPIR-V files in `OUT_DIR`, for each family that it has a program of.
pub(crate) struct Programs {
    /// The interface, the same in all programs.
    pub kernel: reflect::Kernel,
    /// For `KernelFamily::Lanes`.
    pub lanes: Option<String>,
    /// For `KernelFamily::Tiles`.
    pub tiles: Option<String>,
    /// Whether it needs cooperative matrices.
    pub is_coop: bool,
}

/// One source file together with the defines of one variant of it.
pub(crate) struct Unit {
    /// `family/stem`, variant suffix included.
    pub name: String,
    /// GLSL text with includes expanded and defines inserted.
    pub source: String,
}

fn main() {
    let manifest = PathBuf::from(env::var("CARGO_MANIFEST_DIR").expect("cargo sets it"));
    let glsl = manifest.join("../glsl");
    let out = PathBuf::from(env::var("OUT_DIR").expect("cargo sets it"));
    println!("cargo:rerun-if-changed={}", glsl.display());
    println!("cargo:rerun-if-changed=build");
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-check-cfg=cfg({WITHOUT_COOP})");

    let units = units(&glsl);
    let names: Vec<_> = units.iter().map(|unit| unit.name.clone()).collect();
    let has_tile = |name: &str| names.contains(&format!("{name}{TILE_SUFFIX}"));
    let kernels: Vec<_> = units
        .into_iter()
        .map(|unit| {
            let own_tile = has_tile(&unit.name);
            programs(unit, own_tile, &out)
        })
        .collect();
    write(&out.join("registry.rs"), &generate::registry(&kernels));
    write(&out.join("coop_shared_bytes.rs"), &generate::coop_shared_bytes());
}

fn write(file: &Path, text: &str) {
    fs::write(file, text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
}

/// The programs of one unit, compiled and checked; `has_tile` when another unit is its tile kernel.
fn programs(unit: Unit, has_tile: bool, out: &Path) -> Programs {
    let file = unit.name.replace('/', "__");
    let compiled = |unit: &Unit, kind: &str| {
        let spv = format!("{file}.{kind}.spv");
        (module(unit, &out.join(&spv)), Some(spv))
    };
    let refuse = |why: String| -> () { panic!("glsl/{}.comp: {why}", unit.name) };
    if unit.name.ends_with(TILE_SUFFIX) {
        let (tiles, spv) = compiled(&unit, "tiles");
        reflect::check_tiles(&tiles).unwrap_or_else(refuse);
        return Programs { kernel: tiles.kernel, lanes: None, tiles: spv, is_coop: false };
    }
    if unit.name.ends_with(COOP_SUFFIX) {
        let unit = known_to_the_compiler(&unit);
        let (coop, spv) = compiled(&unit, "coop");
        reflect::check_coop(&coop).unwrap_or_else(refuse);
        return Programs { kernel: coop.kernel, lanes: spv.clone(), tiles: spv, is_coop: true };
    }
    let (lanes, lanes_spv) = compiled(&unit, "lanes");
    if has_tile {
        return Programs { kernel: lanes.kernel, lanes: lanes_spv, tiles: None, is_coop: false };
    }
    let portable = Unit { source: with_defines(&unit.source, &[TILES.to_owned()]), name: unit.name.clone() };
    let (tiles, tiles_spv) = compiled(&portable, "tiles");
    reflect::check_tiles(&tiles).and_then(|()| reflect::check_exchangeable(&lanes, &tiles)).unwrap_or_else(refuse);
    Programs { kernel: lanes.kernel, lanes: lanes_spv, tiles: tiles_spv, is_coop: false }
}

/// The unit, or its interface where the compiler is older than cooperative matrices, as the shaderc of many systems is.
/// The crate then takes no device to have any (`kernels/src/vk/cooperation.rs`).
fn known_to_the_compiler(unit: &Unit) -> Unit {
    let source = |defines: &[String]| Unit { source: with_defines(&unit.source, defines), name: unit.name.clone() };
    let Err(log) = compile::to_spirv(unit) else { return source(&[]) };
    assert!(
        cfg!(feature = "shaderc") && log.contains(COOP_EXTENSION),
        "glsl/{}.comp does not compile:\n{log}",
        unit.name
    );
    println!("cargo:rustc-cfg={WITHOUT_COOP}");
    source(&[INTERFACE_ONLY.to_owned()])
}

/// Compiles one unit into the file `spv` and reflects it.
fn module(unit: &Unit, spv: &Path) -> reflect::Reflected {
    let words =
        compile::to_spirv(unit).unwrap_or_else(|log| panic!("glsl/{}.comp does not compile:\n{log}", unit.name));
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    fs::write(spv, bytes).unwrap_or_else(|e| panic!("{}: {e}", spv.display()));
    reflect::module(&unit.name, &words).unwrap_or_else(|why| panic!("glsl/{}.comp: {why}", unit.name))
}

/// All units, sorted by name: one per `.comp`, plus one per entry of `permutations.toml`.
fn units(glsl: &Path) -> Vec<Unit> {
    let variants = permutations(&glsl.join("permutations.toml"));
    let mut units = Vec::new();
    for family in sorted_entries(glsl).filter(|p| p.is_dir() && !p.ends_with("lib")) {
        for file in sorted_entries(&family).filter(|p| p.extension().is_some_and(|e| e == "comp")) {
            let stem = format!("{}/{}", leaf(&family), file.file_stem().expect("has one").to_string_lossy());
            let source = expand(&file, glsl, &mut Vec::new());
            for (suffix, defines) in variants.get(&stem).into_iter().flatten() {
                // The variant of a tile kernel is the tile kernel of the variant.
                let name = match stem.strip_suffix(TILE_SUFFIX) {
                    Some(base) => format!("{base}_{suffix}{TILE_SUFFIX}"),
                    None => format!("{stem}_{suffix}"),
                };
                units.push(Unit { name, source: with_defines(&source, defines) });
            }
            units.push(Unit { name: stem, source });
        }
    }
    units
}

type Variants = std::collections::BTreeMap<String, std::collections::BTreeMap<String, Vec<String>>>;

/// Reads `["family/stem"] variant = ["DEFINE", …]`.
fn permutations(path: &Path) -> Variants {
    let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    toml::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn with_defines(source: &str, defines: &[String]) -> String {
    let (version, rest) = source.split_once('\n').expect("a shader starts with its #version line");
    let defines: String = defines.iter().map(|d| format!("#define {d}\n")).collect();
    format!("{version}\n{defines}{rest}")
}

/// Expands `#include "lib/…"` textually, each file once. Only `glsl/lib` may be included.
fn expand(file: &Path, glsl: &Path, seen: &mut Vec<PathBuf>) -> String {
    let text = fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    let mut out = String::new();
    for line in text.lines() {
        let Some(name) = line.trim().strip_prefix("#include ") else {
            out.push_str(line);
            out.push('\n');
            continue;
        };
        let name = name.trim().trim_matches('"');
        assert!(name.starts_with("lib/"), "{}: only lib/ may be included, not {name}", file.display());
        let path = glsl.join(name);
        if !seen.contains(&path) {
            seen.push(path.clone());
            out.push_str(&expand(&path, glsl, seen));
        }
    }
    out
}

fn sorted_entries(dir: &Path) -> impl Iterator<Item = PathBuf> {
    let mut paths: Vec<PathBuf> = fs::read_dir(dir)
        .unwrap_or_else(|e| panic!("{}: {e}", dir.display()))
        .map(|entry| entry.expect("directory entry is readable").path())
        .collect();
    paths.sort();
    paths.into_iter()
}

fn leaf(path: &Path) -> String {
    path.file_name().expect("has one").to_string_lossy().into_owned()
}
