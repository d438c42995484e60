//! Damaged files: an error or a scene, never a panic, and no memory for what is not there.

use proptest::prelude::*;

use super::super::{golden_bytes, open_bytes, open_bytes_in_kind, splat};
use crate::scene::{assert_refused, bad_data};

const FILES: [&str; 7] =
    ["scene.ply", "scene.v3.spz", "scene.v4.spz", "scene.compressed.ply", "scene.sog", "scene.glb", "scene.splat"];

/// A golden file; `.splat` is made here.
fn bytes_of(name: &str) -> Vec<u8> {
    if name == "scene.splat" { splat::file() } else { golden_bytes(name) }
}

#[test]
fn what_is_no_splat_file_is_refused_with_what_would_be() {
    assert_refused(open_bytes("notes.txt", b"hello"), &["start of file", "68, 65", "SPZ", "GLB"]);
    assert_refused(open_bytes("nothing.bin", b""), &["an empty file"]);
    assert_refused(open_bytes("short.splat", &[0; 33]), &["length", "33", "32"]);
    assert_refused(open_bytes("none.splat", b""), &["splats", "0"]);
}

#[test]
fn counts_that_a_file_cannot_hold_are_refused_before_memory_is_taken() {
    let mut spz = golden_bytes("scene.v4.spz");
    spz[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_refused(open_bytes("a.spz", &spz), &["splat count", "4294967295", "have room for"]);
    spz[8..12].copy_from_slice(&301_u32.to_le_bytes());
    assert_refused(open_bytes("a.spz", &spz), &["stream 0", "2700 bytes", "2709"]);
    spz[4] = 9;
    assert_refused(open_bytes("a.spz", &spz), &["version", "9", "1 to 4"]);
    let splatv = [&[0x4B, 0x67, 0, 0][..], &u32::MAX.to_le_bytes(), b"[]"].concat();
    assert_refused(open_bytes("a.splatv", &splatv), &["length of the description", "4294967295"]);
    let none = [&[0x4B, 0x67, 0, 0][..], &2_u32.to_le_bytes(), b"[]"].concat();
    assert_refused(open_bytes("a.splatv", &none), &["description", "no splats first"]);
}

#[test]
fn cut_files_are_refused() {
    for name in FILES {
        let file = bytes_of(name);
        for share in [0.02, 0.3, 0.9, 0.999] {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a small file")]
            // Odd, because a part of a `.splat` that ends with a row is a smaller one.
            let cut = (file.len() as f64 * share) as usize | 1;
            let opened = open_bytes(name, &file[..cut]);
            assert!(opened.is_err(), "{name}, cut to {cut} of {} bytes", file.len());
            bad_data(open_bytes_in_kind(name, &file[..cut]));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Bytes of files of all formats are changed: whatever comes of it, nothing panics.
    #[test]
    fn changed_bytes_make_an_error_or_a_scene(
        file in 0..FILES.len(),
        edits in prop::collection::vec((0.0..1.0_f64, any::<u8>()), 1..6),
    ) {
        let mut bytes = bytes_of(FILES[file]);
        for (place, value) in edits {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place in a small file")]
            // Heads are where a byte means most.
            let at = ((bytes.len() - 1) as f64 * place.powi(4)) as usize;
            bytes[at] = value;
        }
        if let Ok(model) = open_bytes(FILES[file], &bytes) {
            prop_assert!(!model.gaussians.is_empty(), "a scene has splats");
            prop_assert!(model.gaussians.means.iter().flatten().all(|v| v.is_finite()), "that can be drawn");
        }
        if let Ok(model) = open_bytes_in_kind(FILES[file], &bytes) {
            let more = |h: &f32| if *h == 0.0 { 0.0 } else { h + 0.01 };
            let moved: Vec<f32> = model.gaussians.sh_coeffs.iter().map(more).collect();
            // Large colours plus something may be none that is stored.
            if let Ok(words) = model.words_of(&moved) {
                prop_assert_eq!(model.with_words(&words).len(), 1, "a copy");
            }
        }
    }
}
