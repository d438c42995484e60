//! Twin of `nn/matmul`.

use super::activation;
use crate::nn::activation::Activation;
use crate::reference::real::Real;

/// What happens to s = A Wᵀ + bias, as in the wrapper's `Epilogue`.
#[derive(Clone, Copy, Debug)]
pub enum Epilogue<'a, R> {
    /// act(s)
    Activate(Activation),
    /// s + residual
    Add(&'a [R]),
    /// s act'(pre)
    Grad(Activation, &'a [R]),
}

/// `epilogue(A Wᵀ + bias)`: `a` `[rows, k]`, `w` `[n, k]`, `bias` `[n]` → `[rows, n]`.
pub fn forward<R: Real>(a: &[R], w: &[R], bias: &[R], k: usize, epilogue: Epilogue<R>) -> Vec<R> {
    let mut c = Vec::with_capacity(a.len() / k * bias.len());
    for row in a.chunks_exact(k) {
        for (column, shift) in w.chunks_exact(k).zip(bias) {
            let mut s = R::of(0.0);
            for (x, y) in row.iter().zip(column) {
                s += *x * *y;
            }
            s += *shift;
            c.push(match epilogue {
                Epilogue::Activate(act) => activation::value(act, s),
                Epilogue::Add(residual) => s + residual[c.len()],
                Epilogue::Grad(act, pre) => s * activation::slope(act, pre[c.len()]),
            });
        }
    }
    c
}

/// `v_w = v_cᵀ A`: `a` `[rows, k]`, `v_c` `[rows, n]` → `[n, k]`.
pub fn weight_gradient<R: Real>(a: &[R], v_c: &[R], n: usize, k: usize) -> Vec<R> {
    let mut v_w = vec![R::of(0.0); n * k];
    for (row, v_row) in a.chunks_exact(k).zip(v_c.chunks_exact(n)) {
        for i in 0..n {
            for j in 0..k {
                v_w[i * k + j] += v_row[i] * row[j];
            }
        }
    }
    v_w
}
