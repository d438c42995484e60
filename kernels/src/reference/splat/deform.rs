//! Twin of `splat/deform_apply` and `splat/deform_sh`.

use crate::reference::real::Real;

/// What the rotation head does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RotationUpdate {
    /// Nothing.
    Keep,
    /// `quat + dr`
    Add,
    /// `normalise(quat dr)`, Hamilton product.
    Multiply,
}

/// Means, scales, quats, each `[N,4]`.
pub type Splats<R> = [Vec<R>; 3];

/// Adds the heads `[N,columns]` = dx, do | ds, 0 | dr | ... to raw splats (Wu et al. 2024).
#[must_use]
pub fn apply<R: Real>(splats: &Splats<R>, heads: &[R], columns: usize, rotation: RotationUpdate) -> Splats<R> {
    let mut out = splats.clone();
    for i in 0..splats[0].len() / 4 {
        let head = &heads[i * columns..];
        for k in 0..4 {
            out[0][4 * i + k] += head[k];
            out[1][4 * i + k] += head[4 + k];
        }
        let quat: [R; 4] = std::array::from_fn(|k| splats[2][4 * i + k]);
        let turn: [R; 4] = std::array::from_fn(|k| head[8 + k]);
        let new = match rotation {
            RotationUpdate::Keep => quat,
            RotationUpdate::Add => std::array::from_fn(|k| quat[k] + turn[k]),
            RotationUpdate::Multiply => normalize(product(quat, turn)),
        };
        out[2][4 * i..4 * i + 4].copy_from_slice(&new);
    }
    out
}

/// Adds the SH head, columns 12.. of each row, to the coefficients `[N,16,3]`.
#[must_use]
pub fn apply_sh<R: Real>(sh_coeffs: &[R], heads: &[R], columns: usize) -> Vec<R> {
    let rows = sh_coeffs.chunks_exact(48).zip(heads.chunks_exact(columns));
    rows.flat_map(|(row, head)| row.iter().zip(&head[12..]).map(|(h, d)| *h + *d)).collect()
}

/// `q / max(|q|, 1e-12)`
#[must_use]
pub fn normalize<R: Real>(q: [R; 4]) -> [R; 4] {
    let norm = q.iter().map(|v| *v * *v).sum::<R>().sqrt().max(R::of(1e-12));
    q.map(|v| v / norm)
}

/// Hamilton product of quaternions w, x, y, z.
fn product<R: Real>(a: [R; 4], b: [R; 4]) -> [R; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}
