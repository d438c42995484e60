//! Sequences of files: one model, a file for each moment.

use std::fs;

use guard4d_engine::scene::ply::encode;
use guard4d_engine::scene::{Model, Motion};

use super::assert_refused;
use crate::support::fixture;

const SPLATS: usize = 4;

#[test]
fn one_offset_marks_all_moments_of_a_sequence() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let take = folder.path().join("take");
    fs::create_dir(&take).expect("writable");
    let moments = [2_u64, 10, 9].map(|seed| (seed, fixture::gaussians(SPLATS, 1, seed)));
    for (number, splats) in &moments {
        fs::write(take.join(format!("frame_{number}.ply")), encode(splats)).expect("writable");
    }
    fs::write(take.join("licence.txt"), b"CC0").expect("writable");
    let model = Model::open(&take).expect("a sequence");
    let Motion::Sequence(read) = &model.motion else { panic!("{:?}", model.motion) };
    assert_eq!(read[0], moments[0].1, "frame 2 is first");
    assert_eq!(read[1], moments[2].1, "frame 9 comes before frame 10");
    let mut marked = model.gaussians.sh_coeffs.clone();
    marked.chunks_exact_mut(48).flat_map(|splat| &mut splat[..12]).for_each(|value| *value += 0.25);
    let written = model.write_marked(&folder.path().join("out"), &marked).expect("writable");
    assert_eq!(written.marked.len(), 3, "{written:?}");
    assert_eq!(written.copied, [std::path::PathBuf::from("licence.txt")], "other files come along");
    let Motion::Sequence(after) = Model::open(&folder.path().join("out")).expect("a sequence").motion else {
        panic!("still a sequence")
    };
    for (before, after) in read.iter().zip(&after) {
        assert_eq!((&after.means, &after.quats), (&before.means, &before.quats), "geometry stays");
        let offsets = after.sh_coeffs.iter().zip(&before.sh_coeffs).map(|(a, b)| a - b);
        // A rounding of values below 2.
        assert!(
            offsets.enumerate().all(|(i, d)| (d - if i % 48 < 12 { 0.25 } else { 0.0 }).abs() < 3e-7),
            "one offset"
        );
    }
    fs::write(take.join("frame_11.ply"), encode(&fixture::gaussians(SPLATS + 1, 1, 1))).expect("writable");
    assert_refused(Model::open(&take), &["splats", "5 of degree 1", "4 of degree 1"]);
}
