//! Twin of `splat/sh_fwd` and `splat/sh_bwd`.

use crate::reference::real::Real;

/// Real spherical harmonics in 3DGS order and sign (Kerbl et al. 2023); zero above `degree`.
#[must_use]
pub fn basis<R: Real>(d: [R; 3], degree: u32) -> [R; 16] {
    let [x, y, z] = d.map(R::f64);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let pi = std::f64::consts::PI;
    // Normalisation constants in closed form.
    let c1 = (3.0 / (4.0 * pi)).sqrt();
    let c2 = (15.0 / (4.0 * pi)).sqrt();
    let c20 = (5.0 / (16.0 * pi)).sqrt();
    let (c33, c32) = ((35.0 / (32.0 * pi)).sqrt(), (105.0 / (4.0 * pi)).sqrt());
    let (c31, c30) = ((21.0 / (32.0 * pi)).sqrt(), (7.0 / (16.0 * pi)).sqrt());
    let all = [
        (1.0 / (4.0 * pi)).sqrt(),
        -c1 * y,
        c1 * z,
        -c1 * x,
        c2 * x * y,
        -c2 * y * z,
        c20 * (2.0 * zz - xx - yy),
        -c2 * x * z,
        0.5 * c2 * (xx - yy),
        -c33 * y * (3.0 * xx - yy),
        c32 * x * y * z,
        -c31 * y * (4.0 * zz - xx - yy),
        c30 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -c31 * x * (4.0 * zz - xx - yy),
        0.5 * c32 * z * (xx - yy),
        -c33 * x * (xx - 3.0 * yy),
    ];
    std::array::from_fn(|j| R::of(if j < bases(degree) { all[j] } else { 0.0 }))
}

/// Number of bases up to `degree`.
fn bases(degree: u32) -> usize {
    ((degree + 1) * (degree + 1)) as usize
}

/// Colour before the clamp: the sum of `y` times row `splat` of `coeffs` `[N,16,3]`.
fn raw<R: Real>(coeffs: &[R], splat: usize, y: &[R]) -> [R; 3] {
    let term = |k: usize, (j, y): (usize, &R)| *y * coeffs[48 * splat + 3 * j + k];
    std::array::from_fn(|k| y.iter().enumerate().fold(R::of(0.5), |sum, basis| sum + term(k, basis)))
}

/// `v` where the colour before the clamp is not below zero; NaN is not, and shows.
fn unclamped<R: Real>(raw: R, v: R) -> R {
    if raw < R::of(0.0) { R::of(0.0) } else { v }
}

/// A colour from what it is before the clamp, at most `most`.
pub(super) fn clamped<R: Real>(raw: R, most: R) -> R {
    if raw > most { most } else { unclamped(raw, raw) }
}

/// The gradient before the clamp from the one behind it.
pub(super) fn v_raw<R: Real>(raw: R, v: R, most: R) -> R {
    if raw > most { R::of(0.0) } else { unclamped(raw, v) }
}

/// Colours `[V,4]` of rows `splats` seen along `dirs` `[V,4]`, at most `most`; `coeffs` `[N,16,3]` with the offsets.
#[must_use]
pub fn forward<R: Real>(coeffs: &[R], dirs: &[R], splats: &[usize], degree: u32, most: R) -> Vec<R> {
    let mut colours = Vec::new();
    for (d, &splat) in dirs.chunks_exact(4).zip(splats) {
        let y = basis([d[0], d[1], d[2]], degree);
        let colour = raw(coeffs, splat, &y[..bases(degree)]).map(|v| clamped(v, most));
        colours.extend([colour[0], colour[1], colour[2], R::of(0.0)]);
    }
    colours
}

/// The same before the clamp.
#[must_use]
pub fn before_clamp<R: Real>(coeffs: &[R], dirs: &[R], splats: &[usize], degree: u32) -> Vec<R> {
    let mut colours = Vec::new();
    for (d, &splat) in dirs.chunks_exact(4).zip(splats) {
        let y = basis([d[0], d[1], d[2]], degree);
        colours.extend(raw(coeffs, splat, &y[..bases(degree)]));
        colours.push(R::of(0.0));
    }
    colours
}

/// Gradient `[N,16,3]` of the coefficients; a channel whose colour is clamped has none.
#[must_use]
pub fn backward<R: Real>(coeffs: &[R], dirs: &[R], splats: &[usize], degree: u32, most: R, v_colours: &[R]) -> Vec<R> {
    let mut v_coeffs = vec![R::of(0.0); coeffs.len()];
    for ((d, &splat), v) in dirs.chunks_exact(4).zip(splats).zip(v_colours.chunks_exact(4)) {
        let y = basis([d[0], d[1], d[2]], degree);
        let y = &y[..bases(degree)];
        let colour = raw(coeffs, splat, y);
        for (j, y) in y.iter().enumerate() {
            for k in 0..3 {
                v_coeffs[48 * splat + 3 * j + k] += *y * v_raw(colour[k], v[k], most);
            }
        }
    }
    v_coeffs
}
