//! nn/attention

use guard4d_kernels::nn::attention::{
    AttentionShape, AttentionState, Mask, ProjectionGrads, Projections, Upstream, backward, forward,
};
use guard4d_kernels::reference::nn::attention as twin;
use guard4d_kernels::{Device, KernelError};

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{device, each_family};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const fn shape(batch: usize, heads: usize, head_dim: usize, tokens: usize, mask: Mask) -> AttentionShape {
    AttentionShape { batch, heads, head_dim, queries: tokens, keys: tokens, mask }
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
        let mut random = Random((s.keys * s.head_dim) as u64);
        let qkv = random.vec_f32(s.batch * s.keys * 3 * s.width(), -2.0, 2.0);
        let v_attn = random.vec_f32(s.batch * s.queries * s.width(), -1.0, 1.0);
        let [attn, lse, v_qkv] = run_fused(&gpu, &s, &qkv, &v_attn);
        let inputs = twin::fused(&s, &qkv);
        let (want, want_lse) = twin::forward(&s, &inputs);
        let (v_q, v_kv) = twin::backward(&s, &inputs, &v_attn);
        let want_grad: Vec<f32> = v_q.iter().zip(&v_kv).map(|(a, b)| a + b).collect();
        // Scores reach 32 in steps of 4e-6, exp2 doubles that as relative error of a probability; outputs are <= 2.
        assert_close(&attn, &want, 2e-5, 1e-5);
        assert_close(&lse, &want_lse, 1e-5, 1e-6);
        // Gradients sum up to 257 such terms of size 2 with both signs.
        assert_close(&v_qkv, &want_grad, 5e-5, 2e-5);
    }
}

#[test]
fn few_queries_follow_the_twin() {
    let Some(gpu) = device() else { return };
    for (queries, mask) in [(1, Mask::Full), (3, Mask::Causal), (20, Mask::Causal)] {
        let s = AttentionShape { queries, ..shape(2, 2, 64, 50, mask) };
        let mut random = Random(queries as u64);
        let q = random.vec_f32(s.batch * queries * s.width(), -2.0, 2.0);
        let kv = random.vec_f32(s.batch * s.keys * 2 * s.width(), -2.0, 2.0);
        let v_attn = random.vec_f32(q.len(), -1.0, 1.0);
        let (q_buffer, kv_buffer, v_attn_buffer) = (upload(&gpu, &q), upload(&gpu, &kv), upload(&gpu, &v_attn));
        let (mut attn, mut v_q, mut v_kv) =
            (unwritten(&gpu, q.len()), unwritten(&gpu, q.len()), unwritten(&gpu, kv.len()));
        let mut state = AttentionState::new(&gpu, "state", &s).expect("state");
        let inputs = Projections::Split { q: &q_buffer, kv: &kv_buffer };
        run(&gpu, |rec| {
            forward(rec, &s, inputs, &mut state, &mut attn)?;
            let upstream = Upstream { inputs, attn: &attn, v_attn: &v_attn_buffer };
            backward(rec, &s, &upstream, &mut state, ProjectionGrads::Split { v_q: &mut v_q, v_kv: &mut v_kv })
        });
        let inputs = twin::split(&s, &q, &kv);
        let (want_q, want_kv) = twin::backward(&s, &inputs, &v_attn);
        // As above, with fewer terms.
        assert_close(&attn.read().expect("read"), &twin::forward(&s, &inputs).0, 2e-5, 1e-5);
        assert_close(&v_q.read().expect("read"), &want_q, 5e-5, 2e-5);
        assert_close(&v_kv.read().expect("read"), &want_kv, 5e-5, 2e-5);
    }
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
    // Query, key and value behind the first tile, a key and a value inside it, the gradient of a late and of an early query.
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
        let on_host = |data: &[f32]| {
            let inputs = twin::fused(&s, &data[..v_attn]);
            let (attn, lse) = twin::forward(&s, &inputs);
            let (v_q, v_kv) = twin::backward(&s, &inputs, &data[v_attn..]);
            [attn, lse, v_q.iter().zip(&v_kv).map(|(a, b)| a + b).collect()].concat()
        };
        // As above, with fewer terms.
        assert_eq!(poison::spread(&clean, &places, (5e-5, 2e-5), on_gpu, on_host), want, "{mask:?}");
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
    let none = AttentionShape { batch: 0, ..s };
    assert!(run_fused(&gpu, &none, &[], &[]).concat().is_empty(), "no image, no output, no gradient");
}
