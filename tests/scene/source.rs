//! Files of splats: what of them is drawn, and what is kept for the copy.

use guard4d_engine::scene::ply::encode;

use super::assert_refused;
use super::formats::{golden_bytes, moved, open_bytes, open_bytes_in_kind};
use crate::support::fixture;

#[test]
fn splats_that_cannot_be_drawn_are_left_out_and_kept() {
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut splats = fixture::gaussians(9, 3, 10);
        splats.means[4][1] = poison;
        splats.sh_coeffs[5 * 48 + 4] = poison;
        // The standard deviation e^100 is infinite in single precision.
        splats.scales[8][0] = 100.0;
        let file = encode(&splats);
        let model = open_bytes("holes.ply", &file).expect("six splats are sound");
        assert_eq!(model.gaussians.len(), 6, "three are left out");
        assert!(model.warnings[0].contains("3 splats of 9 left out"), "{:?}", model.warnings);
        let same = model.with_words(&model.words_of(&model.gaussians.sh_coeffs).expect("they fit"));
        assert_eq!(same, [file.as_slice()], "the copy holds all nine as they were");
        let other = fixture::gaussians(6, 3, 11).sh_coeffs;
        let copy = model.with_words(&model.words_of(&other).expect("they fit")).concat();
        let copy = open_bytes("holes.ply", &copy).expect("a copy");
        assert_eq!(copy.gaussians.sh_coeffs, other, "what was asked for");
        assert_eq!(copy.gaussians.means, model.gaussians.means, "the same splats");
    }
    let mut all = fixture::gaussians(2, 0, 1);
    all.opacities.fill(f32::NAN);
    assert_refused(open_bytes("none.ply", &encode(&all)), &["2, all with values that are not finite"]);
}

#[test]
fn formats_that_round_are_written_in_kind_only_when_asked_to() {
    for name in ["scene.v3.spz", "scene.compressed.ply", "scene.sog"] {
        let file = golden_bytes(name);
        let [asked, plain] = [open_bytes_in_kind(name, &file), open_bytes(name, &file)].map(|model| model.expect(name));
        let named = |model: &guard4d_engine::scene::Model| model.sources()[0].path().file_name().map(ToOwned::to_owned);
        assert!(!asked.sources()[0].is_imported() && plain.sources()[0].is_imported(), "{name}");
        assert_eq!(named(&asked).expect("a name"), name, "what a copy is called");
        assert!(plain.sources()[0].bytes().starts_with(b"ply\n"), "{name}: floats");
        assert_eq!(asked.sources()[0].format(), plain.sources()[0].format(), "{name}");
        assert_eq!((asked.sources()[0].rows(), asked.is_rgb()), (300, false), "{name}");
        let words = asked.words_of(&moved(&asked, 0.02)).expect("they fit");
        assert_eq!(words.len(), asked.sources()[0].num_words().expect("they can be counted"), "{name}");
        let copy = open_bytes(name, &asked.with_words(&words)[0]).expect("a copy");
        assert_eq!(copy.sources()[0].format(), asked.sources()[0].format(), "{name}: in kind");
        assert_eq!(copy.gaussians.means, asked.gaussians.means, "{name}: the same splats");
    }
}
