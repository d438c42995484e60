//! Gradients smoothed over neighbouring splats.

use guard4d_engine::render::OffsetBases;
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Estimate, Ladder, Profile, Rung};
use guard4d_engine::watermark::evidence::ExtractorMode;

use super::spread::{offsets_after, prepare, small};
use crate::support::gpu::{device, own_device};
use crate::support::owner::Owner;

const PASS: &str = "optim/neighbour_mean_mix";
/// Neighbours that are smoothed over.
const K: usize = 8;

fn smooth(owner: &Owner) -> EmbedConfig {
    EmbedConfig { smooth: 0.5, ..small(owner) }
}

/// Coefficients at the end, and the kernels that ran.
fn finished(mut embedding: Embedding<'_>) -> (Vec<u32>, Vec<&'static str>) {
    while embedding.step().expect("steps").is_some() {}
    let embedded = embedding.finish().expect("finishes");
    (embedded.sh_coeffs.iter().map(|v| v.to_bits()).collect(), embedded.device_seconds.into_keys().collect())
}

/// Mean over splats with an offset of the squared distance of its DC offset from the mean of its neighbours', over the mean
/// square of offsets: 1 + 1/K for a field without any order.
fn roughness(offsets: &[f32], means: &[[f32; 3]]) -> f64 {
    let row = offsets.len() / means.len();
    let dc = |i: usize| [0, 1, 2].map(|c| f64::from(offsets[i * row + c]));
    let (mut off, mut all) = (0.0, 0.0);
    for (i, own) in means.iter().enumerate().step_by(7) {
        let distance = |j: &usize| own.iter().zip(&means[*j]).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        let mut others: Vec<usize> = (0..means.len()).filter(|j| *j != i).collect();
        others.select_nth_unstable_by(K, |a, b| distance(a).total_cmp(&distance(b)));
        for c in 0..3 {
            let mean = others[..K].iter().map(|j| dc(*j)[c]).sum::<f64>() / K as f64;
            off += (dc(i)[c] - mean).powi(2);
            all += dc(i)[c].powi(2);
        }
    }
    assert!(all > 0.0, "something moved");
    off / all
}

#[test]
fn neighbours_move_alike_and_without_smoothing_nothing_is_there_for_it() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let means = &owner.model.gaussians.means;
    let rough = |config: &EmbedConfig| roughness(&offsets_after(prepare(&gpu, &owner, config), 3), means);
    let (plain, half) = (small(&owner), smooth(&owner));
    let whole = EmbedConfig { smooth: 1.0, ..half.clone() };
    let [none, some, most] = [&plain, &half, &whole].map(rough);
    // Adam makes steps of a size out of any gradient, so that what is smooth of it is its sign.
    assert!(some < 0.8 * none && most < some, "roughness {none}, {some} and {most} at 0, 0.5 and 1");

    let (without, kernels) = finished(prepare(&gpu, &owner, &plain));
    assert!(!kernels.contains(&PASS), "off costs nothing: {kernels:?}");
    let (with, kernels) = finished(prepare(&gpu, &owner, &half));
    assert!(kernels.contains(&PASS) && with != without, "another mark: {kernels:?}");
}

#[test]
fn smoothing_goes_on_where_it_was_also_on_a_wider_rung() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let first = Rung { bases: OffsetBases::Dc, reach: 0.5, views: 1, steps: 1 };
    let second = Rung { bases: OffsetBases::All, reach: 1.0, views: 2, steps: 2 };
    let ladder = Ladder { rungs: vec![first, second], sure: 1.0, every: 1, patience: 100, held_out: 1 };
    let config = EmbedConfig { ladder: Some(ladder), bases: OffsetBases::All, steps: 3, ..smooth(&owner) };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |step: usize| folder.path().join(step.to_string());
    let mut embedding = prepare(&gpu, &owner, &config);
    for step in [1, 2] {
        embedding.step().expect("steps").expect("there are more");
        embedding.save(&path(step)).expect("saves");
    }
    let (unbroken, _) = finished(embedding);
    for step in [1, 2] {
        let mut resumed = prepare(&gpu, &owner, &config);
        resumed.restore(&path(step)).expect("restores");
        assert!(finished(resumed).0 == unbroken, "the same mark with and without a break after step {step}");
    }
}

#[test]
fn an_estimate_has_room_for_neighbours() {
    let Some(gpu) = own_device() else { return };
    let owner = Owner::new(&gpu);
    let estimate = |config: &EmbedConfig| Estimate::of(owner.subject(&gpu), config).expect("estimates");
    let want = estimate(&smooth(&owner));
    drop((owner, gpu));
    let Some(gpu) = own_device() else { return };
    let owner = Owner::new(&gpu);
    finished(prepare(&gpu, &owner, &smooth(&owner)));
    let most = gpu.memory_use();
    let off = want.peak_memory_bytes as f64 / most.peak_reserved_bytes as f64;
    assert!((0.95..1.05).contains(&off), "the estimate is within 5 %: {want:?}, {most:?}");
    assert!(want.plan_seconds > 0.0 && want.plan_seconds.is_finite(), "{want:?}");
}

#[test]
fn impossible_shares_are_refused_and_settings_name_only_what_is_asked_for() {
    let plain = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind);
    let said = |config: &EmbedConfig| serde_json::to_value(config).expect("JSON")["smooth"].clone();
    assert!(said(&plain).is_null(), "as before there was a choice");
    for share in [0.5, 1.0] {
        let config = EmbedConfig { smooth: share, ..plain.clone() };
        config.validate().expect("possible");
        assert_eq!(said(&config), share);
    }
    for (smooth, what) in [(-0.5, "smooth: -0.5"), (1.5, "smooth: 1.5"), (f32::NAN, "smooth: NaN")] {
        let refused = EmbedConfig { smooth, ..plain.clone() }.validate().expect_err(what).to_string();
        assert!(refused.contains(what), "{refused}");
    }
}
