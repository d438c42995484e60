//! What is built in loads like what users bring, and stays small.

use std::fs;

use guard4d_engine::scene::camera::{CameraSet, FrameSize};
use guard4d_engine::scene::model::Model;

use crate::support::{files_below, repo};

/// Everything that is built in, together.
const MAX_BYTES: u64 = 25_000_000;

/// Bytes of each file below a folder of the repository.
fn sizes(folder: &str) -> impl Iterator<Item = u64> {
    let folder = repo(folder);
    files_below(&folder).into_iter().map(move |file| {
        let path = folder.join(file);
        fs::metadata(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).len()
    })
}

#[test]
fn built_in_assets_stay_small() {
    let bytes: u64 = ["engine/assets/mini-clip", "engine/assets/demo-scene"].into_iter().flat_map(sizes).sum();
    assert!(bytes > 0 && bytes <= MAX_BYTES, "{bytes} bytes are built in, {MAX_BYTES} are allowed");
}

/// Largest golden file; `generate/common.py` has the same bound.
const MAX_GOLDEN_BYTES: u64 = 256 * 1024;

#[test]
fn golden_files_stay_small() {
    let bytes = sizes("tests/golden").max().unwrap_or(0);
    assert!(bytes > 0 && bytes <= MAX_GOLDEN_BYTES, "a golden file has {bytes} bytes, {MAX_GOLDEN_BYTES} are allowed");
}

#[test]
fn demo_scene_loads_without_a_warning() {
    let model = Model::open(&repo("engine/assets/demo-scene")).expect("the demo scene is a valid model");
    assert!(model.warnings.is_empty(), "nothing had to be assumed: {:?}", model.warnings);
    let field = model.motion.network().expect("the demo scene moves");
    let [high, low] = field.aabb;
    let inside = |p: &[f32; 3]| (0..3).all(|k| low[k] < p[k] && p[k] < high[k]);
    assert!(model.gaussians.means.iter().all(inside), "the box of the planes holds every splat");
}

#[test]
fn demo_scene_brings_views_and_times() {
    let path = repo("engine/assets/demo-scene/transforms_test.json");
    let size = FrameSize::new(64, 64).expect("not empty");
    let cameras = CameraSet::open(&path, size).expect("the demo scene brings cameras");
    let mut times: Vec<_> = cameras.entries().map(|(_, _, time)| time).collect();
    times.sort_by(f32::total_cmp);
    times.dedup();
    assert!(cameras.views.len() > times.len(), "several views at each time");
    assert_eq!((times.first(), times.last()), (Some(&0.0), Some(&1.0)), "the times span the motion");
}

#[test]
fn readme_states_the_weights_that_are_here() {
    let bytes =
        fs::read(repo("engine/assets/mini-clip/model.safetensors")).expect("the weights are part of the checkout");
    let readme = fs::read_to_string(repo("engine/assets/README.md")).expect("the README is part of the checkout");
    let hash = blake3::hash(&bytes).to_hex();
    assert!(readme.contains(&format!("blake3 `{hash}`")), "the README states another file than {hash}");
    // 15,788,314 as people write it.
    let digits = bytes.len().to_string();
    let grouped: Vec<_> = digits.as_bytes().rchunks(3).rev().map(String::from_utf8_lossy).collect();
    assert!(readme.contains(&format!("{} bytes", grouped.join(","))), "the README states another size than {digits}");
}
