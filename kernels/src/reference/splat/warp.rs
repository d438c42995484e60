//! Twin of `splat/warp_apply`.

use super::deform::{Splats, normalize};
use crate::reference::real::Real;

const COLUMNS: usize = 16;
const LEAST_ANGLE: f64 = 1e-20;
const NUDGE: f64 = 1e-5;
const LEAST_SCALE: f64 = 1e-12;

/// Adds the heads `[N,16]` = dx or v, 0 | ds, 0 | dr | w, 0 to splats after activation (Yang et al. 2024).
#[must_use]
pub fn apply<R: Real>(splats: &Splats<R>, heads: &[R], screw_motion: bool) -> Splats<R> {
    let mut out = splats.clone();
    for (i, head) in heads.chunks_exact(COLUMNS).enumerate() {
        let at = |part: usize, k: usize| splats[part][4 * i + k];
        let (mean, shift) = ([at(0, 0), at(0, 1), at(0, 2)], [head[0], head[1], head[2]]);
        let moved = match screw_motion {
            true => screw(mean, [head[12], head[13], head[14]], shift),
            false => std::array::from_fn(|k| mean[k] + shift[k]),
        };
        out[0][4 * i..4 * i + 3].copy_from_slice(&moved);
        for k in 0..3 {
            out[1][4 * i + k] = (at(1, k).exp() + head[4 + k]).abs().max(R::of(LEAST_SCALE)).ln();
        }
        out[1][4 * i + 3] = R::of(1.0);
        let quat = normalize([at(2, 0), at(2, 1), at(2, 2), at(2, 3)]);
        for k in 0..4 {
            out[2][4 * i + k] = quat[k] + head[8 + k];
        }
    }
    out
}

/// x after the screw motion exp of the twist (w, v).
fn screw<R: Real>(x: [R; 3], w: [R; 3], v: [R; 3]) -> [R; 3] {
    let theta = w.iter().map(|a| *a * *a).sum::<R>().sqrt();
    let inverse = R::of(1.0) / theta.max(R::of(LEAST_ANGLE));
    let (w, v) = (w.map(|a| a * inverse + R::of(NUDGE)), v.map(|a| a * inverse + R::of(NUDGE)));
    let (sine, cosine) = sine_and_cosine(theta);
    let versine = R::of(1.0) - cosine;
    let (wx, wv) = (cross(w, x), cross(w, v));
    let (wwx, wwv) = (cross(w, wx), cross(w, wv));
    std::array::from_fn(|k| {
        x[k] + sine * wx[k] + versine * wwx[k] + theta * v[k] + versine * wv[k] + (theta - sine) * wwv[k]
    })
}

fn sine_and_cosine<R: Real>(angle: R) -> (R, R) {
    let (sine, cosine) = angle.f64().sin_cos();
    (R::of(sine), R::of(cosine))
}

fn cross<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
