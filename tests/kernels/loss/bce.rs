//! loss/bce: twin against differences, GPU against the twin, extremes.

use guard4d_kernels::loss::bce::{Answers, Groups, Objective, backward, forward};
use guard4d_kernels::reference::loss::bce as twin;
use guard4d_kernels::{Device, KernelError};

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const OBJECTIVES: [Objective; 5] = [
    Objective::Bce,
    Objective::Margin { margin: 2.0 },
    Objective::InverseBce { eps: 0.1 },
    Objective::Hinge { eps: 0.1 },
    Objective::Chance,
];

#[test]
fn twin_gradients_match_differences() {
    let mut random = Random(7);
    // Two sizes of logits: the hinge is active (B < ln 2) for one and idle for the other.
    for scale in [0.3, 3.0] {
        let target: Vec<f64> = (0..12).map(|i| f64::from(u8::from(i % 3 == 0))).collect();
        let logits: Vec<f64> = target
            .iter()
            .map(|t| scale * random.uniform(0.5, 1.5) * if scale < 1.0 { 2.0 * t - 1.0 } else { 1.0 })
            .collect();
        for objective in OBJECTIVES {
            let f = |x: &[f64]| 0.7 * twin::loss(objective, twin::forward(objective, x, &target));
            let grad = twin::backward(objective, 0.7, &logits, &target);
            let worst = gradcheck(f, &logits, &grad);
            assert!(worst < 1e-6, "{objective:?} at scale {scale}: {worst}");
        }
    }
}

fn run(
    gpu: &Device,
    objective: Objective,
    groups: Groups,
    logits: &[f32],
    target: &[f32],
) -> Result<(Vec<f32>, Vec<f32>), KernelError> {
    let logits = gpu.buffer_from("logits", logits)?;
    let target = gpu.buffer_from("target", target)?;
    let mut value = gpu.buffer("value", groups.groups)?;
    let mut v_logits = gpu.buffer("v_logits", logits.len())?;
    let mut rec = gpu.recorder()?;
    let answers = Answers { groups, logits: &logits, target: &target };
    forward(&mut rec, objective, &answers, &mut value)?;
    backward(&mut rec, objective, 0.7, &answers, &value, &mut v_logits)?;
    rec.submit()?;
    Ok((value.read()?, v_logits.read()?))
}

#[test]
fn gpu_matches_the_twin_for_shared_and_own_targets() {
    let Some(gpu) = device() else { return };
    let mut random = Random(11);
    for (groups, rows, bits) in [(1, 1, 8), (3, 8, 16), (2, 5, 48)] {
        let per_group = rows * bits;
        let logits = random.vec_f32(groups * per_group, -4.0, 4.0);
        let own: Vec<f32> = (0..groups * per_group).map(|_| random.below(2) as f32).collect();
        for objective in OBJECTIVES {
            for shared in [false, true] {
                let target: Vec<f32> = if shared { own[..bits].to_vec() } else { own.clone() };
                let full: Vec<f32> = if shared { target.repeat(groups * rows) } else { target.clone() };
                let shape = Groups { groups, rows, bits };
                let (value, v_logits) = run(&gpu, objective, shape, &logits, &target).expect("runs");
                for g in 0..groups {
                    let range = g * per_group..(g + 1) * per_group;
                    let (x, t) = (&logits[range.clone()], &full[range.clone()]);
                    // exp and log of the CPU driver: about 1e-6 relative each.
                    assert_close(&value[g..=g], &[twin::forward(objective, x, t)], 1e-6, 1e-5);
                    assert_close(&v_logits[range], &twin::backward(objective, 0.7, x, t), 1e-6, 1e-4);
                }
            }
        }
    }
}

#[test]
fn poison_spreads_as_in_the_twin() {
    let Some(gpu) = device() else { return };
    let (shape, target) = (Groups { groups: 2, rows: 1, bits: 4 }, [0.0, 1.0, 1.0, 0.0]);
    // Wrong answers make the hinge idle, right ones active.
    for clean in [[-1.0, 0.5, 2.0, -0.7, 1.5, -0.2, -1.0, 0.3], [0.5, -1.0, 0.5, 0.2, -1.5, 0.2, 1.0, -0.3]] {
        for objective in OBJECTIVES {
            let on_gpu = |x: &[f32]| {
                let (value, v_logits) = run(&gpu, objective, shape, x, &target).expect("runs");
                [value, v_logits].concat()
            };
            let on_host = |x: &[f32]| {
                let groups = || x.chunks_exact(4);
                let values = groups().map(|x| twin::forward(objective, x, &target));
                values.chain(groups().flat_map(|x| twin::backward(objective, 0.7, x, &target))).collect::<Vec<f32>>()
            };
            // As above. A logit of each target.
            let reach = poison::spread(&clean, &[4, 6], (1e-6, 1e-4), on_gpu, on_host);
            // The value and the own slope; the inverse's slopes all depend on the value, the hinge's idle ones do not.
            let want = if matches!(objective, Objective::InverseBce { .. }) { 5 } else { 2 };
            assert_eq!(reach, [want; 2], "{objective:?}");
        }
        let hinge = Objective::Hinge { eps: 0.1 };
        assert!(hinge.loss(f32::NAN).is_nan() && twin::loss(hinge, f32::NAN).is_nan(), "a NaN value is no loss");
    }
}

#[test]
fn extreme_logits_stay_finite_and_poison_shows() {
    let Some(gpu) = device() else { return };
    let shape = Groups { groups: 2, rows: 1, bits: 4 };
    let logits = [80.0, -80.0, 1e-40, 0.0, f32::NAN, 1.0, f32::INFINITY, -1.0];
    for objective in OBJECTIVES {
        let (value, v_logits) = run(&gpu, objective, shape, &logits, &[0.0, 1.0, 1.0, 0.0]).expect("runs");
        assert!(value[0].is_finite() && v_logits[..4].iter().all(|v| v.is_finite()), "{objective:?}: {v_logits:?}");
        assert!(value[1].is_nan() && v_logits[4].is_nan(), "{objective:?} hides a NaN: {value:?} {v_logits:?}");
    }
}

#[test]
fn wrong_shapes_are_refused() {
    let Some(gpu) = device() else { return };
    let cases = [((1, 2, 4), 7, 4), ((1, 2, 4), 8, 5), ((0, 0, 0), 0, 0), ((1, 70_000, 1), 70_000, 1)];
    for ((groups, rows, bits), logits, target) in cases {
        let shape = Groups { groups, rows, bits };
        let result = run(&gpu, Objective::Bce, shape, &vec![0.0; logits], &vec![0.0; target]);
        assert!(matches!(result, Err(KernelError::Shape { .. })), "{shape:?}: {result:?}");
    }
}
