//! Twin of `image/jpeg_fwd`: the standard's cosine sums, in plain loops.

use crate::reference::real::Real;

/// One frame `[H,W,4]` coded with 64 quantisation steps of luma and 64 of chroma, and how close any coefficient came to
/// a tie of its rounding, in steps. `[to, back]` are the maps to luma and two chroma and from there.
pub fn forward(
    x: &[f64],
    [height, width]: [usize; 2],
    steps: &[f64],
    [to, back]: [[[f64; 3]; 3]; 2],
) -> (Vec<f64>, f64) {
    let at = |component: usize, row: usize, column: usize| -> f64 {
        let pixel = &x[(row.min(height - 1) * width + column.min(width - 1)) * 4..][..3];
        255.0 * (0..3).map(|c| to[component][c] * pixel[c]).sum::<f64>()
    };
    let mean = |component: usize, row: usize, column: usize| -> f64 {
        (0..4).map(|q| at(component, 2 * row + q / 2, 2 * column + q % 2)).sum::<f64>() / 4.0
    };
    let mut tie = f64::INFINITY;
    let mut y = vec![0.0; x.len()];
    for top in (0..height).step_by(16) {
        for left in (0..width).step_by(16) {
            let mut chroma = |component: usize| {
                let block = |r: usize, c: usize| mean(component, top / 2 + r, left / 2 + c);
                lose(block, &steps[64..], &mut tie)
            };
            let (blue, red) = (chroma(1), chroma(2));
            for (dy, dx) in [(0, 0), (0, 8), (8, 0), (8, 8)] {
                let luma = lose(|r, c| at(0, top + dy + r, left + dx + c) - 128.0, &steps[..64], &mut tie);
                for (k, luma) in luma.into_iter().enumerate() {
                    let (r, c) = (dy + k / 8, dx + k % 8);
                    if top + r >= height || left + c >= width {
                        continue;
                    }
                    let quad = r / 2 * 8 + c / 2;
                    let t = [luma + 128.0, blue[quad], red[quad]];
                    for (channel, row) in back.iter().enumerate() {
                        let colour: f64 = (0..3).map(|i| row[i] * t[i]).sum();
                        y[((top + r) * width + left + c) * 4 + channel] = colour / 255.0;
                    }
                }
            }
        }
    }
    (y, tie)
}

/// An 8×8 block transformed, rounded to multiples of `steps`, and transformed back.
fn lose(block: impl Fn(usize, usize) -> f64, steps: &[f64], tie: &mut f64) -> Vec<f64> {
    let basis = |k: usize, n: usize| -> f64 {
        let scale = if k == 0 { 0.125_f64.sqrt() } else { 0.5 };
        scale * ((2 * n + 1) as f64 * k as f64 * std::f64::consts::PI / 16.0).cos()
    };
    let pairs = || (0..8).flat_map(|r| (0..8).map(move |c| (r, c)));
    let kept: Vec<f64> = pairs()
        .zip(steps)
        .map(|((v, u), step)| {
            let scaled = pairs().map(|(r, c)| basis(v, r) * basis(u, c) * block(r, c)).sum::<f64>() / step;
            *tie = tie.min((scaled.abs().fract() - 0.5).abs());
            scaled.round() * step
        })
        .collect();
    pairs().map(|(r, c)| pairs().zip(&kept).map(|((v, u), k)| basis(v, r) * basis(u, c) * k).sum()).collect()
}

/// Gradient to x with the rounding taken for the identity: the adjoint of averaging chroma.
pub fn backward<R: Real>(v_y: &[R], size: [usize; 2], [to, back]: [[[R; 3]; 3]; 2]) -> Vec<R> {
    let transposed = |m: [[R; 3]; 3]| std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]));
    super::chroma420::apply(v_y, size, [transposed(back), transposed(to)])
}
