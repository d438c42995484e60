//! nn/attention

use guard4d_kernels::nn::attention::{
    AttentionShape, AttentionState, Mask, ProjectionGrads, Projections, Upstream, backward, forward,
};
use guard4d_kernels::nn::pack::Precision;
use guard4d_kernels::reference::nn::attention as twin;
use guard4d_kernels::{Device, KernelError};

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{device, each_family, half_device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const fn shape(batch: usize, heads: usize, head_dim: usize, tokens: usize, mask: Mask) -> AttentionShape {
    let precision = Precision::F32;
    AttentionShape { batch, heads, head_dim, queries: tokens, keys: tokens, mask, precision }
}

/// `s` in 16-bit floats.
const fn halved(s: AttentionShape) -> AttentionShape {
    AttentionShape { precision: Precision::Half, ..s }
}

/// Head sizes of one, two and more fetches, one that fills no fetch; tokens below, at and above tile borders.
const SHAPES: [AttentionShape; 8] = [
    shape(1, 1, 4, 1, Mask::Full),
    shape(2, 2, 64, 17, Mask::Full),
    shape(1, 3, 12, 16, Mask::Causal),
    shape(2, 1, 32, 50, Mask::Full),
    shape(1, 2, 64, 77, Mask::Causal),
    shape(1, 1, 40, 33, Mask::Causal),
    shape(1, 1, 64, 257, Mask::Full),
    shape(1, 2, 96, 65, Mask::Causal),
];

#[test]
fn twin_gradients_match_differences() {
    for s in [shape(1, 2, 4, 3, Mask::Full), shape(2, 1, 4, 4, Mask::Causal)] {
        let mut random = Random(17);
        let qkv = random.vec(s.batch * s.keys * 3 * s.width(), -1.0, 1.0);
        let v_attn = random.vec(s.batch * s.queries * s.width(), -1.0, 1.0);
        let (v_q, v_kv) = twin::backward(&s, &twin::fused(&s, &qkv), &v_attn);
        let v_qkv: Vec<f64> = v_q.iter().zip(&v_kv).map(|(a, b)| a + b).collect();
        let error = gradcheck(|x| dot(&twin::forward(&s, &twin::fused(&s, x)).0, &v_attn), &qkv, &v_qkv);
        assert!(error < 1e-6, "{s:?}: {error}");
    }
    let s = AttentionShape { queries: 2, ..shape(1, 2, 4, 5, Mask::Causal) };
    let mut random = Random(18);
    let (q, kv) = (random.vec(2 * s.width(), -1.0, 1.0), random.vec(5 * 2 * s.width(), -1.0, 1.0));
    let v_attn = random.vec(q.len(), -1.0, 1.0);
    let (v_q, v_kv) = twin::backward(&s, &twin::split(&s, &q, &kv), &v_attn);
    let loss = |q: &[f64], kv: &[f64]| dot(&twin::forward(&s, &twin::split(&s, q, kv)).0, &v_attn);
    let errors = [gradcheck(|q| loss(q, &kv), &q, &v_q), gradcheck(|kv| loss(&q, kv), &kv, &v_kv)];
    assert!(errors.iter().all(|e| *e < 1e-6), "{errors:?}");
}

/// Runs forward and backward on fused inputs: output, log-sum-exp, gradient.
fn run_fused(gpu: &Device, s: &AttentionShape, qkv: &[f32], v_attn: &[f32]) -> [Vec<f32>; 3] {
    let (qkv_buffer, v_attn_buffer) = (upload(gpu, qkv), upload(gpu, v_attn));
    let (mut attn, mut v_qkv) = (unwritten(gpu, v_attn.len()), unwritten(gpu, qkv.len()));
    let mut state = AttentionState::new(gpu, "state", s).expect("state");
    let inputs = Projections::Fused(&qkv_buffer);
    run(gpu, |rec| {
        forward(rec, s, inputs, &mut state, &mut attn)?;
        let upstream = Upstream { inputs, attn: &attn, v_attn: &v_attn_buffer };
        backward(rec, s, &upstream, &mut state, ProjectionGrads::Fused(&mut v_qkv))
    });
    [attn.read().expect("read"), state.lse.read().expect("read"), v_qkv.read().expect("read")]
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for s in SHAPES {
        let (qkv, v_attn) = operands(&s);
        let [attn, lse, v_qkv] = run_fused(&gpu, &s, &qkv, &v_attn);
        let [want, want_lse, want_grad] = on_host(&s, &qkv, &v_attn);
        // Scores reach 32 in steps of 4e-6, exp2 doubles that as relative error of a probability; outputs are <= 2.
        assert_close(&attn, &want, 2e-5, 1e-5);
        assert_close(&lse, &want_lse, 1e-5, 1e-6);
        // Gradients sum up to 257 such terms of size 2 with both signs.
        assert_close(&v_qkv, &want_grad, 5e-5, 2e-5);
    }
}

/// Queries of their own: output and both gradients of device and twin, which gets operands that went through `operand`.
fn few_queries(gpu: &Device, s: &AttentionShape, operand: fn(&[f32]) -> Vec<f32>) -> [[Vec<f32>; 3]; 2] {
    let mut random = Random(s.queries as u64);
    let q = random.vec_f32(s.batch * s.queries * s.width(), -2.0, 2.0);
    let kv = random.vec_f32(s.batch * s.keys * 2 * s.width(), -2.0, 2.0);
    let v_attn = random.vec_f32(q.len(), -1.0, 1.0);
    let (q_buffer, kv_buffer, v_attn_buffer) = (upload(gpu, &q), upload(gpu, &kv), upload(gpu, &v_attn));
    let (mut attn, mut v_q, mut v_kv) = (unwritten(gpu, q.len()), unwritten(gpu, q.len()), unwritten(gpu, kv.len()));
    let mut state = AttentionState::new(gpu, "state", s).expect("state");
    let inputs = Projections::Split { q: &q_buffer, kv: &kv_buffer };
    run(gpu, |rec| {
        forward(rec, s, inputs, &mut state, &mut attn)?;
        let upstream = Upstream { inputs, attn: &attn, v_attn: &v_attn_buffer };
        backward(rec, s, &upstream, &mut state, ProjectionGrads::Split { v_q: &mut v_q, v_kv: &mut v_kv })
    });
    let got = [attn, v_q, v_kv].map(|buffer| buffer.read().expect("read"));
    let (q, kv) = (operand(&q), operand(&kv));
    let inputs = twin::split(s, &q, &kv);
    let (want_q, want_kv) = twin::backward(s, &inputs, &operand(&v_attn));
    [got, [twin::forward(s, &inputs).0, want_q, want_kv]]
}

#[test]
fn few_queries_follow_the_twin() {
    let Some(gpu) = device() else { return };
    for (queries, mask) in [(1, Mask::Full), (3, Mask::Causal), (20, Mask::Causal)] {
        let s = AttentionShape { queries, ..shape(2, 2, 64, 50, mask) };
        let [got, want] = few_queries(&gpu, &s, <[f32]>::to_vec);
        // As above, with fewer terms.
        assert_close(&got[0], &want[0], 2e-5, 1e-5);
        assert_close(&got[1], &want[1], 5e-5, 2e-5);
        assert_close(&got[2], &want[2], 5e-5, 2e-5);
    }
}

/// Factors as cooperative matrices take them.
fn rounded(x: &[f32]) -> Vec<f32> {
    x.iter().map(|v| half::f16::from_f32(*v).to_f32()).collect()
}

/// What the twin makes of these operands: output, log-sum-exp, gradient of fused inputs.
fn on_host(s: &AttentionShape, qkv: &[f32], v_attn: &[f32]) -> [Vec<f32>; 3] {
    let inputs = twin::fused(s, qkv);
    let (attn, lse) = twin::forward(s, &inputs);
    let (v_q, v_kv) = twin::backward(s, &inputs, v_attn);
    [attn, lse, v_q.iter().zip(&v_kv).map(|(a, b)| a + b).collect()]
}

/// Inputs and a gradient for `s`.
fn operands(s: &AttentionShape) -> (Vec<f32>, Vec<f32>) {
    let mut random = Random((s.keys * s.head_dim) as u64);
    let qkv = random.vec_f32(s.batch * s.keys * 3 * s.width(), -2.0, 2.0);
    (qkv, random.vec_f32(s.batch * s.queries * s.width(), -1.0, 1.0))
}

// Outputs in 16-bit floats: probabilities add up to 1, each is off by at most 2^-11 of itself, and values are <= 2.
const HALF_OUTPUT: f32 = 1e-3;
// Base-2 logarithms: sums of up to 64 exact products below 4, where a unit that adds several at once may drop what lies
// 2^-22 below the largest partial sum, here below 64, in each of up to 16 steps; times log2(e) / sqrt(head_dim).
const HALF_LSE: f32 = 2e-4;
// Gradients: a slope is off by 2^-11 of itself and, by its row term, by its probability times the rounding of the
// output and of the gradient, 2e-3 in all for 64 elements of both signs; slopes of up to 8 times a probability, factors
// of 2 and 1/sqrt(head_dim), and probabilities that add up to 5 over the queries of a key.
const HALF_GRADIENT: f32 = 5e-3;

#[test]
fn half_precision_follows_the_twin_on_rounded_operands() {
    let Some(gpu) = half_device() else { return };
    // Heads that fill their matrices and that do not; tokens below, at and above the edges of tiles of 32.
    for s in [
        shape(1, 1, 4, 1, Mask::Full),
        shape(2, 2, 64, 17, Mask::Full),
        shape(1, 3, 40, 32, Mask::Full),
        shape(2, 1, 40, 65, Mask::Full),
        shape(1, 2, 64, 97, Mask::Full),
    ] {
        let (qkv, v_attn) = operands(&s);
        let [attn, lse, v_qkv] = run_fused(&gpu, &halved(s), &qkv, &v_attn);
        let [want, want_lse, want_grad] = on_host(&s, &rounded(&qkv), &rounded(&v_attn));
        assert_close(&attn, &want, HALF_OUTPUT, 0.0);
        assert_close(&lse, &want_lse, HALF_LSE, 1e-6);
        assert_close(&v_qkv, &want_grad, HALF_GRADIENT, 0.0);
    }
    for queries in [1, 33] {
        let s = AttentionShape { queries, ..shape(2, 2, 64, 50, Mask::Full) };
        let [got, want] = few_queries(&gpu, &halved(s), rounded);
        assert_close(&got[0], &want[0], HALF_OUTPUT, 0.0);
        assert_close(&got[1], &want[1], HALF_GRADIENT, 0.0);
        assert_close(&got[2], &want[2], HALF_GRADIENT, 0.0);
    }
}

#[test]
fn half_precision_moves_results_by_its_rounding_alone() {
    let Some(gpu) = half_device() else { return };
    let s = shape(2, 2, 64, 65, Mask::Full);
    let (qkv, v_attn) = operands(&s);
    let [floats, halves] = [s, halved(s)].map(|s| run_fused(&gpu, &s, &qkv, &v_attn));
    for (half, float) in halves.iter().zip(&floats) {
        let length = |v: &mut dyn Iterator<Item = f32>| v.map(|v| v * v).sum::<f32>().sqrt();
        let error = length(&mut half.iter().zip(float).map(|(h, f)| h - f)) / length(&mut float.iter().copied());
        // Scores up to 32 are off by some 2^-11 of their terms, and probabilities by as much of themselves; the
        // gradient passes three more roundings of 2^-12 on average.
        assert!(error > 1e-6 && error < 3e-3, "{error} of the length: rounded, and no more");
    }
    // What the kernels do not have runs in floats.
    for s in [shape(1, 2, 64, 33, Mask::Causal), shape(1, 1, 68, 9, Mask::Full)] {
        let (qkv, v_attn) = operands(&s);
        let [floats, halves] = [s, halved(s)].map(|s| run_fused(&gpu, &s, &qkv, &v_attn));
        assert_eq!(floats, halves, "{s:?}");
    }
}

#[test]
fn a_device_whose_attention_is_right_in_half_precision_may_be_used() {
    let Some(gpu) = half_device() else { return };
    guard4d_kernels::nn::half_check::check_attention(&gpu).expect("as the tests around this one find it");
}

#[test]
fn half_precision_keeps_small_gradients() {
    let Some(gpu) = half_device() else { return };
    let s = halved(shape(1, 1, 64, 70, Mask::Full));
    let (qkv, v_attn) = operands(&s);
    let [.., v_qkv] = run_fused(&gpu, &s, &qkv, &v_attn);
    let times = |v: &[f32], factor: f32| v.iter().map(|v| v * factor).collect::<Vec<_>>();
    // Far below what 16 bits hold, and far above; the scale is a power of two, so not a bit may differ.
    for factor in [2.0f32.powi(-40), 2.0f32.powi(40)] {
        let [.., got] = run_fused(&gpu, &s, &qkv, &times(&v_attn, factor));
        assert_close(&got, &times(&v_qkv, factor), 0.0, 0.0);
    }
    // Gradients that grow from one tile of queries to the next: the sums so far are brought to each new scale.
    let growing =
        |v: &[f32]| v.iter().enumerate().map(|(i, v)| v * 64.0f32.powi((i / (32 * 64)) as i32)).collect::<Vec<_>>();
    let [.., got] = run_fused(&gpu, &s, &qkv, &growing(&v_attn));
    let [.., want] = on_host(&s, &rounded(&qkv), &growing(&rounded(&v_attn)));
    assert_close(&got, &want, HALF_GRADIENT * 4096.0, 0.0);
    // The queries of the first tile have a scale of their own.
    assert_close(&got[..32], &want[..32], HALF_GRADIENT, 0.0);
}

#[test]
fn both_families_agree() {
    let Some(devices) = each_family() else { return };
    for s in [shape(2, 2, 64, 50, Mask::Full), shape(1, 1, 132, 77, Mask::Causal)] {
        let mut random = Random(31);
        let qkv = random.vec_f32(s.batch * s.keys * 3 * s.width(), -2.0, 2.0);
        let v_attn = random.vec_f32(s.batch * s.queries * s.width(), -1.0, 1.0);
        let [lanes, tiles] = devices.each_ref().map(|gpu| run_fused(gpu, &s, &qkv, &v_attn));
        for (tiles, lanes) in tiles.iter().zip(&lanes) {
            // Twice what each may be off from the twin.
            assert_close(tiles, lanes, 1e-4, 4e-5);
        }
    }
}

#[test]
fn large_scores_do_not_overflow() {
    let Some(gpu) = device() else { return };
    let s = shape(1, 1, 4, 20, Mask::Full);
    let qkv = Random(23).vec_f32(20 * 12, -40.0, 40.0);
    let v_attn = vec![1.0; 20 * 4];
    let [attn, lse, v_qkv] = run_fused(&gpu, &s, &qkv, &v_attn);
    assert!(attn.iter().chain(&lse).chain(&v_qkv).all(|v| v.is_finite()), "scores of +-3200");
}

#[test]
fn poison_reaches_what_attends_to_it() {
    let Some(gpu) = device() else { return };
    let (tokens, width) = (18, 8);
    let clean = Random(29).vec_f32(tokens * 4 * width, -1.0, 1.0);
    let at = |token: usize, part: usize| token * 3 * width + part * width + 2;
    let v_attn = tokens * 3 * width;
    // Query, key and value behind the first tile, a key and a value inside it, the gradient of a late and of an early
    // query.
    let places = [at(17, 0), at(17, 1), at(17, 2), at(5, 1), at(5, 2), v_attn + 17 * width + 2, v_attn + 3 * width + 2];
    let all = tokens * width;
    // attn and lse, then v_q, v_k, v_v.
    let full = [
        width + 1 + width + all + all,
        all + tokens + 3 * all,
        tokens + all + all,
        all + tokens + 3 * all,
        tokens + all + all,
        width + all + tokens,
        width + all + tokens,
    ];
    // The last token is seen by itself only, token 5 by 13 queries; query 3 sees four keys.
    let rows = |n: usize| n * width;
    let causal = [
        width + 1 + width + all + all,
        width + 1 + width + all + all,
        1 + width + all,
        rows(13) + 13 + rows(13) + all + all,
        13 + rows(13) + all,
        width + all + tokens,
        width + rows(4) + 4,
    ];
    for (mask, want) in [(Mask::Full, full), (Mask::Causal, causal)] {
        let s = shape(1, 1, width, tokens, mask);
        let on_gpu = |data: &[f32]| run_fused(&gpu, &s, &data[..v_attn], &data[v_attn..]).concat();
        let twin = |data: &[f32]| on_host(&s, &data[..v_attn], &data[v_attn..]).concat();
        // As above, with fewer terms.
        assert_eq!(poison::spread(&clean, &places, (5e-5, 2e-5), on_gpu, twin), want, "{mask:?}");
    }
    if gpu.info().cooperation.is_some() {
        let s = halved(shape(1, 1, width, tokens, Mask::Full));
        let on_gpu = |data: &[f32]| run_fused(&gpu, &s, &data[..v_attn], &data[v_attn..]).concat();
        let twin = |data: &[f32]| on_host(&s, &rounded(&data[..v_attn]), &rounded(&data[v_attn..])).concat();
        assert_eq!(poison::spread(&clean, &places, (HALF_GRADIENT, 0.0), on_gpu, twin), full, "f16");
    }
}

#[test]
fn wrong_shapes_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let s = shape(1, 1, 4, 2, Mask::Causal);
    let (qkv, mut attn) = (upload(&gpu, &[0.0; 24]), unwritten(&gpu, 8));
    let mut state = AttentionState::new(&gpu, "state", &s).expect("state");
    let mut rec = gpu.recorder().expect("recorder");
    for (wrong, name) in [
        (AttentionShape { head_dim: 3, ..s }, "head_dim"),
        (AttentionShape { queries: 3, ..s }, "queries"),
        (AttentionShape { queries: 1, ..s }, "queries"),
        (AttentionShape { batch: 2, ..s }, "qkv"),
    ] {
        let error = forward(&mut rec, &wrong, Projections::Fused(&qkv), &mut state, &mut attn);
        assert!(matches!(error, Err(KernelError::Shape { buffer, .. }) if buffer == name), "{name}: {error:?}");
    }
    let recorded = forward(&mut rec, &halved(s), Projections::Fused(&qkv), &mut state, &mut attn);
    let can = gpu.info().cooperation.is_some();
    assert!(matches!(recorded, Ok(())) == can, "16-bit floats where the device has matrices of them: {recorded:?}");
    assert!(can || matches!(recorded, Err(KernelError::Unsuitable { .. })), "{recorded:?}");
    let none = AttentionShape { batch: 0, ..s };
    assert!(run_fused(&gpu, &none, &[], &[]).concat().is_empty(), "no image, no output, no gradient");
}
