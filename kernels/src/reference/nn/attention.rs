//! Twin of `nn/attention`.

use crate::nn::attention::{AttentionShape, Mask};
use crate::reference::real::{Real, count};

/// Queries, keys and values with their strides, all in elements.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a, R> {
    q: &'a [R],
    kv: &'a [R],
    q_stride: usize,
    kv_stride: usize,
    k_offset: usize,
    v_offset: usize,
}

/// q, k, v side by side in rows of `3*width`.
pub fn fused<'a, R>(shape: &AttentionShape, qkv: &'a [R]) -> Inputs<'a, R> {
    let width = shape.width();
    Inputs { q: qkv, kv: qkv, q_stride: 3 * width, kv_stride: 3 * width, k_offset: width, v_offset: 2 * width }
}

/// q in rows of `width`, k and v side by side in rows of `2*width`.
pub fn split<'a, R>(shape: &AttentionShape, q: &'a [R], kv: &'a [R]) -> Inputs<'a, R> {
    let width = shape.width();
    Inputs { q, kv, q_stride: width, kv_stride: 2 * width, k_offset: 0, v_offset: width }
}

/// One query of one head: where its vectors start, and how many keys it sees.
struct Query {
    q: usize,
    out: usize,
    k: usize,
    v: usize,
    stat: usize,
    visible: usize,
}

fn queries<R>(s: &AttentionShape, x: &Inputs<R>) -> Vec<Query> {
    let mut all = Vec::new();
    for image in 0..s.batch {
        for head in 0..s.heads {
            for i in 0..s.queries {
                let kv = image * s.keys * x.kv_stride + head * s.head_dim;
                all.push(Query {
                    q: (image * s.queries + i) * x.q_stride + head * s.head_dim,
                    out: (image * s.queries + i) * s.width() + head * s.head_dim,
                    k: kv + x.k_offset,
                    v: kv + x.v_offset,
                    stat: (image * s.heads + head) * s.queries + i,
                    visible: if s.mask == Mask::Causal { s.keys - s.queries + i + 1 } else { s.keys },
                });
            }
        }
    }
    all
}

fn dot<R: Real>(a: &[R], b: &[R]) -> R {
    a.iter().zip(b).map(|(x, y)| *x * *y).sum()
}

/// Softmax row of one query and the base-2 logarithm of its denominator.
fn probabilities<R: Real>(s: &AttentionShape, x: &Inputs<R>, query: &Query) -> (Vec<R>, R) {
    let scale = R::of(1.0) / count::<R>(s.head_dim).sqrt();
    let q = &x.q[query.q..][..s.head_dim];
    let scores: Vec<R> =
        (0..query.visible).map(|j| dot(q, &x.kv[query.k + j * x.kv_stride..][..s.head_dim]) * scale).collect();
    let top = scores.iter().fold(scores[0], |m, v| m.max(*v));
    let weights: Vec<R> = scores.iter().map(|v| (*v - top).exp()).collect();
    let sum: R = weights.iter().copied().sum();
    let lse = (top + sum.ln()) / R::of(std::f64::consts::LN_2);
    (weights.into_iter().map(|w| w / sum).collect(), lse)
}

/// Output `[batch*queries, width]` and base-2 log-sum-exp `[batch, heads, queries]`.
pub fn forward<R: Real>(s: &AttentionShape, x: &Inputs<R>) -> (Vec<R>, Vec<R>) {
    let mut attn = vec![R::of(0.0); s.batch * s.queries * s.width()];
    let mut lse = vec![R::of(0.0); s.batch * s.heads * s.queries];
    for query in queries(s, x) {
        let (p, log_sum) = probabilities(s, x, &query);
        lse[query.stat] = log_sum;
        for (j, weight) in p.iter().enumerate() {
            for d in 0..s.head_dim {
                attn[query.out + d] += *weight * x.kv[query.v + j * x.kv_stride + d];
            }
        }
    }
    (attn, lse)
}

/// Gradients shaped like `q` and `kv`; with fused inputs their sum is the gradient of `qkv`.
pub fn backward<R: Real>(s: &AttentionShape, x: &Inputs<R>, v_attn: &[R]) -> (Vec<R>, Vec<R>) {
    let scale = R::of(1.0) / count::<R>(s.head_dim).sqrt();
    let mut v_q = vec![R::of(0.0); x.q.len()];
    let mut v_kv = vec![R::of(0.0); x.kv.len()];
    for query in queries(s, x) {
        let (p, _) = probabilities(s, x, &query);
        let g = &v_attn[query.out..][..s.head_dim];
        let value = |j: usize| &x.kv[query.v + j * x.kv_stride..][..s.head_dim];
        let dp: Vec<R> = (0..p.len()).map(|j| dot(g, value(j))).collect();
        // p · dp by way of the output, as in Dao et al. 2022, appendix B.4.
        let attn = |d: usize| p.iter().enumerate().map(|(j, weight)| *weight * value(j)[d]).sum::<R>();
        let delta = g.iter().enumerate().map(|(d, v)| *v * attn(d)).sum::<R>();
        for j in 0..p.len() {
            let slope = p[j] * (dp[j] - delta) * scale;
            let (k, v) = (query.k + j * x.kv_stride, query.v + j * x.kv_stride);
            for d in 0..s.head_dim {
                v_q[query.q + d] += slope * x.kv[k + d];
                v_kv[k + d] += slope * x.q[query.q + d];
                v_kv[v + d] += p[j] * g[d];
            }
        }
    }
    (v_q, v_kv)
}
