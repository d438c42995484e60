//! Twin of `loss/ssim_*`: SSIM with an 11×11 Gaussian window, σ = 1.5, zero padding, as the paper writes it.
//! Only in f64 does this form keep its precision for images that are nearly the same.

use crate::reference::real::Real;

/// The normalised window along one axis.
fn window<R: Real>() -> Vec<R> {
    let tap = |k: i32| (-f64::from((k - 5) * (k - 5)) / (2.0 * 1.5 * 1.5)).exp();
    let total: f64 = (0..11).map(tap).sum();
    (0..11).map(|k| R::of(tap(k) / total)).collect()
}

/// Windowed mean of one channel `[H,W]`.
fn blur<R: Real>(image: &[R], height: usize, width: usize) -> Vec<R> {
    let g = window::<R>();
    let pass = |image: &[R], along_rows: bool| -> Vec<R> {
        let at = |y: usize, x: usize, k: usize| {
            let (y, x) = if along_rows { (y + 5, x + k) } else { (y + k, x + 5) };
            let inside = y >= 5 && x >= 5 && y < height + 5 && x < width + 5;
            if inside { image[(y - 5) * width + x - 5] } else { R::of(0.0) }
        };
        (0..height * width).map(|i| (0..11).map(|k| g[k] * at(i / width, i % width, k)).sum()).collect()
    };
    pass(&pass(image, true), false)
}

/// Mean of 1 − SSIM of a frame `[H,W,4]` over three channels and its gradient to `image`, fourth channel 0.
pub fn step<R: Real>(image: &[R], reference: &[R], height: usize, width: usize) -> (R, Vec<R>) {
    let pixels = height * width;
    let mean = R::of(1.0 / (pixels as f64 * 3.0));
    let mut value = R::of(0.0);
    let mut grad = vec![R::of(0.0); image.len()];
    for channel in 0..3 {
        let x: Vec<R> = (0..pixels).map(|i| image[i * 4 + channel]).collect();
        let y: Vec<R> = (0..pixels).map(|i| reference[i * 4 + channel]).collect();
        let (v, g) = plane(&x, &y, height, width);
        value += mean * v;
        for (i, g) in g.into_iter().enumerate() {
            grad[i * 4 + channel] = mean * g;
        }
    }
    (value, grad)
}

/// Sum of 1 − SSIM over one channel, and its gradient.
fn plane<R: Real>(x: &[R], y: &[R], height: usize, width: usize) -> (R, Vec<R>) {
    let (one, two) = (R::of(1.0), R::of(2.0));
    let (c1, c2) = (R::of(0.01 * 0.01), R::of(0.03 * 0.03));
    let product = |a: &[R], b: &[R]| a.iter().zip(b).map(|(a, b)| *a * *b).collect::<Vec<_>>();
    let mean = |v: &[R]| blur(v, height, width);
    let (mx, my) = (mean(x), mean(y));
    let (exx, eyy, exy) = (mean(&product(x, x)), mean(&product(y, y)), mean(&product(x, y)));
    let mut sum = R::of(0.0);
    let mut slopes = [vec![], vec![], vec![]];
    for i in 0..x.len() {
        let n1 = two * mx[i] * my[i] + c1;
        let n2 = two * (exy[i] - mx[i] * my[i]) + c2;
        let d1 = mx[i] * mx[i] + my[i] * my[i] + c1;
        let d2 = exx[i] - mx[i] * mx[i] + eyy[i] - my[i] * my[i] + c2;
        let ssim = n1 * n2 / (d1 * d2);
        sum += one - ssim;
        // Minus those of SSIM, by the chain rule through n1, n2, d1, d2.
        slopes[0].push(two * my[i] * (n1 - n2) / (d1 * d2) + two * mx[i] * ssim * (one / d1 - one / d2));
        slopes[1].push(ssim / d2);
        slopes[2].push(-(two * n1 / (d1 * d2)));
    }
    let [by_mean, by_square, by_product] = slopes.map(|s| mean(&s));
    let grad = (0..x.len()).map(|i| by_mean[i] + two * x[i] * by_square[i] + y[i] * by_product[i]).collect();
    (sum, grad)
}
