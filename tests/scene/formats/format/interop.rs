//! Other people's programs open what is written here. `./x interop` fetches them and runs these tests; elsewhere they
//! say that they were skipped.

use std::path::Path;
use std::process::Command;

use guard4d_engine::scene::formats::Export;
use guard4d_engine::scene::{Model, PlyFile};

use super::super::{assert_same_scene, golden, splats_of};
use crate::support::close::largest;
use crate::support::interop::{program, run};
use crate::support::repo;

#[test]
fn splat_transform_reads_what_is_written_and_its_files_come_back() {
    let Some(splat_transform) = program("GUARD4D_SPLAT_TRANSFORM") else { return };
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let at = |name: &str| folder.path().join(name);
    let transform =
        |from: &Path, to: &Path| run(Command::new(&splat_transform).args(["-q", "-w", "-g", "cpu"]).arg(from).arg(to));
    let splats = splats_of(&golden("scene.ply"));
    for (export, name, tolerance) in [(Export::Ply, "ours.ply", 2e-6), (Export::Spz, "ours.spz", 1e-5)] {
        std::fs::write(at(name), export.encode(&at(name), &splats).expect("it fits")).expect("writable");
        transform(&at(name), &at("theirs.ply"));
        let mut want = Model::open(&at(name)).expect("our own file").gaussians;
        let mut got = splats_of(&at("theirs.ply"));
        // Theirs clamps opacities elsewhere than ours; both ends are drawn alike.
        for logit in got.opacities.iter_mut().chain(&mut want.opacities) {
            *logit = logit.clamp(-6.0, 6.0);
        }
        assert_same_scene(&got, &want, tolerance, name);
    }
    for (name, means, colours) in
        [("back.spz", 2e-4, 0.02), ("back.compressed.ply", 1e-3, 0.02), ("back.sog", 1e-3, 0.1)]
    {
        transform(&golden("scene.ply"), &at(name));
        let back = Model::open(&at(name)).expect(name).gaussians;
        assert_eq!(back.len(), splats.len(), "{name}");
        // Packed files sort their splats: each is compared with the nearest one of the scene.
        for (mean, coeffs) in back.means.iter().zip(back.sh_coeffs.chunks_exact(48)) {
            let distance = |other: &[f32; 3]| mean.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt();
            let nearest =
                (0..splats.len()).min_by(|&a, &b| distance(&splats.means[a]).total_cmp(&distance(&splats.means[b])));
            let nearest = nearest.expect("a scene has splats");
            // A step of 24, 16 and 11 bits of the scene's extent, and of a byte of its colours.
            assert!(distance(&splats.means[nearest]) < means, "{name}: {mean:?}");
            let off = largest((0..3).map(|c| (coeffs[c] - splats.sh_coeffs[48 * nearest + c]).abs()));
            assert!(off < colours, "{name}: a DC term is off by {off}");
        }
    }
}

#[test]
fn plyfile_and_safetensors_read_our_files() {
    let Some(python) = program("GUARD4D_INTEROP_PYTHON") else { return };
    let ply = golden("scene.ply");
    let pretrained = repo("engine/assets/pretrained.safetensors");
    let found = run(Command::new(python).arg(repo("tests/interop/read.py")).args([&ply, &pretrained]));
    let found: serde_json::Value = serde_json::from_str(&found).expect("JSON");
    let splats = PlyFile::open(&ply).and_then(|ply| ply.decode()).expect("a plain PLY");
    assert_eq!(found["splats"], splats.len());
    assert_eq!(found["properties"].as_array().map(Vec::len), Some(62), "{found}");
    let sum = |name: &str| found["sums"][name].as_f64().expect("a number");
    let ours = |values: &mut dyn Iterator<Item = f32>| values.map(f64::from).sum::<f64>();
    assert!((sum("x") - ours(&mut splats.means.iter().map(|m| m[0]))).abs() < 1e-9, "{found}");
    assert!((sum("f_dc_0") - ours(&mut splats.sh_coeffs.iter().step_by(48).copied())).abs() < 1e-9, "{found}");
    // The last of 45 is coefficient 15 of blue.
    assert!(
        (sum("f_rest_44") - ours(&mut splats.sh_coeffs.iter().skip(47).step_by(48).copied())).abs() < 1e-9,
        "{found}"
    );
    assert!(found["tensors"][0].as_object().is_some_and(|tensors| !tensors.is_empty()), "{found}");
}
