//! Files of splats: what of them is drawn, and what is kept for the copy.

use guard4d_engine::scene::ply::encode;

use super::assert_refused;
use super::formats::open_bytes;
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
