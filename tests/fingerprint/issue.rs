//! The owner's chips: fair coins of the key and the asset, found by the key in a film from anywhere, and by no other.

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::fingerprint::code::{Code, Position, SharedScore};
use guard4d_engine::fingerprint::estimate::estimate;
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::scene::camera::paths::USUAL_FOV_X_RAD;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::gaussians::SH_FLOATS;
use guard4d_engine::scene::{LookAt, Model};

use super::film::{exposures, film, shots_from_above};
use crate::support::close::assert_close;
use crate::support::gpu::device;

/// What `embed` comes to on this scene: half of what copies are stamped with.
const STRENGTH: f64 = 0.5;
/// Keys that had no part in a film.
const OTHERS: u16 = 10_000;

fn prf(key: u16) -> Prf {
    let [low, high] = key.to_le_bytes();
    Prf::new(&MasterSecret::from_bytes([low, high].repeat(16).try_into().expect("32 bytes")))
}

#[test]
fn chips_are_fair_coins_of_key_and_asset() {
    let signs = |key: u16, asset: &[u8]| -> Vec<bool> {
        let code = Code::of_owner(&prf(key), Digest::of(asset), 10_000);
        let sign = |position: &Position| matches!(position, Position::Shared(true));
        assert!(code.positions().iter().all(|position| matches!(position, Position::Shared(_))));
        code.positions().iter().map(sign).collect()
    };
    let own = signs(1, b"asset");
    assert_eq!(own, signs(1, b"asset"));
    let plus = own.iter().filter(|sign| **sign).count();
    // Four deviations of 10,000 coins.
    assert!((4800..=5200).contains(&plus), "{plus}");
    for other in [signs(2, b"asset"), signs(1, b"another")] {
        let alike = own.iter().zip(&other).filter(|(a, b)| a == b).count();
        assert!((4800..=5200).contains(&alike), "{alike}");
    }
}

#[test]
fn splats_that_nobody_draws_keep_their_colours() {
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let mut model = Model::open(scene.path()).expect("the scene opens");
    let hidden = 100..200;
    model.gaussians.opacities[hidden.clone()].fill(-8.0);
    let issue = Issue::new(&model, prf(60_002), STRENGTH);
    let copy = issue.stamp(5);
    let rows = copy.chunks_exact(SH_FLOATS).zip(model.gaussians.sh_coeffs.chunks_exact(SH_FLOATS));
    for (row, (stamped, original)) in rows.enumerate() {
        assert_eq!(stamped == original, hidden.contains(&row), "splat {row}");
    }
    // Whatever is said of them counts for no chip.
    let of_splats = |outside: f64, inside: f64| -> Vec<f64> {
        (0..model.gaussians.len()).map(|row| if hidden.contains(&row) { inside } else { outside }).collect()
    };
    let collected = |inside| issue.collect(&of_splats(1.0, inside)).expect("a number for each splat");
    assert_eq!(collected(1.0), collected(1e6));
}

#[test]
fn splats_that_cover_more_of_a_picture_move_less() {
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let mut model = Model::open(scene.path()).expect("the scene opens");
    model.gaussians.sh_coeffs.fill(0.0);
    model.gaussians.opacities.fill(20.0);
    model.gaussians.scales.fill([-8.0; 3]);
    // A picture of 400 px that takes in what a lens of 40 degrees does from four units away, as networks are trained.
    let px = LookAt::D_NERF.radius * (0.5 * USUAL_FOV_X_RAD).tan() / 200.0;
    let deviation = |covered_px: f64| (px * (covered_px / std::f64::consts::TAU).sqrt()).ln() as f32;
    for (row, covered_px) in [3.9, 64.0, 64.0 * 256.0].into_iter().enumerate() {
        // The shortest of the three axes covers nothing.
        model.gaussians.scales[row] = [deviation(covered_px), -20.0, deviation(covered_px)];
    }
    model.gaussians.scales[3] = [f32::NAN; 3];
    let issue = Issue::new(&model, prf(60_003), STRENGTH);
    let moved = issue.spread(&vec![1.0; issue.code().positions().len()]);
    let usual = moved[10];
    assert!(usual > 0.01 * STRENGTH, "{usual}");
    // Steps of 1/1024, and single precision.
    let shares: Vec<f32> = moved[..4].iter().map(|moved| (moved / usual) as f32).collect();
    assert_close(&shares, &[1.0, 0.5, 0.125, 1.0], 0.0, 6e-4);
}

#[test]
fn a_film_from_above_is_known_by_its_key_and_by_no_other() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let issue = Issue::of_owner(&model, prf(60_000), STRENGTH);
    let shots = shots_from_above(8);
    // On top of another mark, and under a recipient's stamp: both are noise to it.
    let copy = Issue::new(&model, prf(60_001), 1.0).stamp(5);
    let leaked = film(&gpu, &model, issue.stamp_onto(copy.clone(), 0), &shots);
    let without = film(&gpu, &model, copy, &shots);
    let read = |frames| estimate(&issue, &mut exposures(&gpu, &model, frames, &shots)).expect("of each splat").chips;
    let log10_p = |chips: &[f64]| {
        let SharedScore { score, chance } = issue.code().shared_score(chips).expect("of each chip");
        chance.log_tail(score).bound / std::f64::consts::LN_10
    };
    let (with, without) = (read(&leaked), read(&without));
    assert!(log10_p(&with) < -20.0, "10^{}", log10_p(&with));
    assert!(log10_p(&without) > -3.0, "10^{}", log10_p(&without));

    // By chance a score has mean 0 and variance 1, and tails below their bounds, whatever the film shows.
    for (what, chips) in [("with chips", &with), ("without", &without)] {
        let code = |key| Code::of_owner(&prf(key), model.digest(), chips.len());
        let chance = issue.code().shared_score(chips).expect("of each chip").chance;
        let score = |key| code(key).shared_score(chips).expect("of each chip").score / chance.deviation();
        let scores: Vec<f64> = (0..OTHERS).map(score).collect();
        let share = |of: &dyn Fn(f64) -> f64| scores.iter().map(|t| of(*t)).sum::<f64>() / f64::from(OTHERS);
        // Four deviations of the mean of 10,000, and of the mean of their squares.
        let (mean, variance) = (share(&|t| t), share(&|t| t * t));
        assert!(mean.abs() < 0.04 && (variance - 1.0).abs() < 0.06, "{what}: {mean}, {variance}");
        for least in [2.0, 3.0, 3.5] {
            let tail = share(&|t| f64::from(u8::from(t >= least)));
            let bound = chance.log_tail(least * chance.deviation()).bound.exp();
            assert!(tail <= bound, "{what}: {tail} of keys beyond {least}, bound {bound}");
        }
    }
}
