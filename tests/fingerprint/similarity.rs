//! Transforms are told by points and where they went.

use glam::{DQuat, DVec3};
use guard4d_engine::fingerprint::similarity::{Pair, Similarity};

use crate::support::random::Random;

fn point(random: &mut Random) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| random.uniform(-1.0, 1.0)))
}

fn known(scale: f64, random: &mut Random) -> Similarity {
    let rotation = DQuat::from_rotation_arc(point(random).normalize(), point(random).normalize());
    Similarity { scale, rotation, translation: 5.0 * scale * point(random) }
}

#[test]
fn a_known_transform_is_told_by_where_points_went() {
    let mut random = Random(1);
    for scale in [0.01, 1.0, 100.0] {
        let known = known(scale, &mut random);
        // Three points on a plane suffice, and many with errors do too.
        for (count, error) in [(3, 0.0), (2000, 0.001)] {
            let pairs = (0..count).map(|_| {
                let from = point(&mut random);
                Pair { from, to: known.apply(from) + error * scale * point(&mut random) }
            });
            let found = Similarity::through(&pairs.collect::<Vec<_>>()).expect("points enough");
            // An error of 0.001, averaged over 2000 points of about 1.
            assert!((found.scale / scale - 1.0).abs() < 1e-4, "{found:?} for {known:?}");
            assert!(found.rotation.angle_between(known.rotation) < 1e-4, "{found:?} for {known:?}");
            assert!(found.translation.distance(known.translation) < 1e-4 * scale, "{found:?} for {known:?}");
        }
        let there = point(&mut random);
        // Rounding of numbers of up to 500.
        assert!(known.inverse().apply(known.apply(there)).distance(there) < 1e-12);
    }
}

#[test]
fn a_mirror_is_no_transform_and_neither_are_points_that_say_nothing() {
    let mut random = Random(2);
    let mirrored =
        (0..100).map(|_| point(&mut random)).map(|from| Pair { from, to: from * DVec3::new(-1.0, 1.0, 1.0) });
    let found = Similarity::through(&mirrored.collect::<Vec<_>>());
    // The nearest turn; a quaternion is never a mirror.
    assert!(found.is_none_or(|found| found.scale < 0.9), "{found:?}");
    let nowhere = Pair { from: DVec3::ZERO, to: DVec3::NAN };
    let still = Pair { from: DVec3::ONE, to: DVec3::ONE };
    for pairs in [&[][..], &[still], &[still, still], &[still, nowhere]] {
        assert_eq!(Similarity::through(pairs), None, "{pairs:?}");
    }
}
