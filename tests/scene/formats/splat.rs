//! `.splat` files with new base colours.

use std::path::Path;

use guard4d_engine::base::output::Existing;
use guard4d_engine::release::undo;
use guard4d_engine::scene::formats::splat::SplatFile;
use guard4d_engine::scene::gaussians::Y0;
use guard4d_engine::scene::{Gaussians, Model};

use super::{golden, in_kind, moved, open_bytes_in_kind, splats_of};
use crate::scene::assert_refused;
use crate::support::close::largest;

/// Splats as rows of a `.splat` file, whose colours and opacities are the `shade` of each row and channel.
pub(super) fn rows(splats: &Gaussians, shade: impl Fn(usize, usize) -> u8) -> Vec<u8> {
    let row = |row: usize| {
        let floats = splats.means[row].into_iter().chain(splats.scales[row].map(f32::exp));
        let rotation = splats.quats[row].map(|q| if q < 0.0 { 32 } else { 200 });
        floats.flat_map(f32::to_le_bytes).chain((0..4).map(|i| shade(row, i)).collect::<Vec<_>>()).chain(rotation)
    };
    (0..splats.len()).flat_map(row).collect()
}

/// A file in which every shade and opacity is.
pub(super) fn file() -> Vec<u8> {
    rows(&splats_of(&golden("scene.ply")), |row, i| (row + 85 * i).to_le_bytes()[0])
}

/// A step of a DC term.
const STEP: f64 = 1.0 / 255.0 / Y0;

#[test]
fn moved_base_colours_come_back_to_within_half_a_step() {
    let file = file();
    let [asked, stored] = in_kind("scene.splat", &file, 0.02);
    let inside = |dc: f32| (0.0..=1.0).contains(&(0.5 + Y0 * f64::from(dc)));
    let errors = asked.iter().zip(&stored).filter(|(dc, _)| inside(**dc)).map(|(a, b)| f64::from((a - b).abs()));
    // A rounding of values up to 1.8 comes on top.
    let worst = largest(errors);
    assert!(worst < 1e-6 + STEP / 2.0, "{worst}");
    let splats = SplatFile::parse(Path::new("scene.splat"), file.clone()).expect("whole rows");
    let copy = splats.with_words(None, &splats.words_of(None, &asked).expect("they fit"));
    let changed: Vec<usize> = (0..file.len()).filter(|&at| file[at] != copy[at]).collect();
    assert!(changed.len() > file.len() / 16, "{} bytes", changed.len());
    assert!(changed.iter().all(|at| (24..27).contains(&(at % 32))), "colours alone");
}

#[test]
fn colours_end_at_black_and_white() {
    let splats = SplatFile::parse(Path::new("scene.splat"), file()).expect("whole rows");
    let mut asked = vec![0.0; 4 * 48];
    let (black, white) = (-0.5 / Y0, 0.5 / Y0);
    let dcs = [black - 0.45 * STEP, black + 0.45 * STEP, black + 0.55 * STEP, white - 0.55 * STEP, white - 0.45 * STEP];
    let dcs = dcs.into_iter().chain([white + 0.45 * STEP, black - 3.0 * STEP, white + 3.0 * STEP]);
    let dcs: Vec<f32> = dcs.chain([-1e6, 1e6, -1e30, 1e30]).map(|dc| dc as f32).collect();
    for (splat, dcs) in asked.chunks_exact_mut(48).zip(dcs.chunks_exact(3)) {
        splat[..3].copy_from_slice(dcs);
    }
    let words = splats.words_of(Some(&[0, 1, 2, 3]), &asked).expect("they fit");
    assert_eq!(words, [0, 0, 1, 254, 255, 255, 0, 255, 0, 255, 0, 255]);
    let ends = SplatFile::coeffs_of(&[0, 255, 0]);
    assert!((f64::from(ends[0]) - black).abs() < 1e-6 && (f64::from(ends[1]) - white).abs() < 1e-6, "{:?}", &ends[..3]);
    asked[3] = 0.1;
    let refused = splats.words_of(Some(&[0, 1, 2, 3]), &asked).expect_err("there is no SH in these files");
    assert!(refused.to_string().contains("above degree 0"), "{refused}");
}

#[test]
fn splats_that_cannot_be_drawn_stay_as_they_are() {
    let mut file = file();
    file[3 * 32..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    let model = open_bytes_in_kind("scene.splat", &file).expect("all but one are sound");
    assert_eq!(model.gaussians.len(), 299, "one is left out");
    let copy = model.with_words(&model.words_of(&moved(&model, 0.1)).expect("they fit")).concat();
    assert_eq!(copy[3 * 32..4 * 32], file[3 * 32..4 * 32], "the broken one");
    assert_ne!(copy[4 * 32 + 24..][..3], file[4 * 32 + 24..][..3], "the next one");
}

#[test]
fn a_mark_is_taken_out_to_the_byte() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("scene.splat"), file()).expect("writable");
    let model = Model::open_in_kind(&at("scene.splat")).expect("whole rows");
    let stored = model.as_stored(&moved(&model, 0.05)).expect("it fits");
    model.write_marked(&at("marked"), &stored).expect("writable");
    undo::write(&at("undo"), &model, &stored).expect("writable");
    undo::restore(&at("marked/scene.splat"), &at("undo"), &at("restored"), Existing::Refuse).expect("it is ours");
    let restored = std::fs::read(at("restored/scene.splat")).expect("restored");
    assert!(restored == file(), "the original's bytes");
}

#[test]
fn parts_of_rows_are_refused() {
    for length in [1, 31, 33, 95] {
        let cut = SplatFile::parse(Path::new("scene.splat"), file()[..length].to_vec());
        assert_refused(cut, &["length", &length.to_string(), "32"]);
    }
    assert_refused(SplatFile::parse(Path::new("scene.splat"), Vec::new()), &["splats", "0"]);
}
