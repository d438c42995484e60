//! image/clamp01: twin against differences, GPU against the twin bit by bit, the ends of the range.

use guard4d_kernels::image::clamp01::{backward, forward};
use guard4d_kernels::reference::image::clamp01 as twin;

use super::{both_ways, dot};
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(2);
    let (mut x, v_y) = (random.vec(40, -0.5, 1.5), random.vec(40, -1.0, 1.0));
    // The fourth channel is copied but carries no gradient; leave it out of the sum.
    x.iter_mut().skip(3).step_by(4).for_each(|v| *v = 0.0);
    let weights: Vec<f64> = v_y.iter().enumerate().map(|(i, v)| if i % 4 < 3 { *v } else { 0.0 }).collect();
    let worst = gradcheck(|x| dot(&twin::forward(x), &weights), &x, &twin::backward(&x, &v_y));
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn gpu_equals_the_twin() {
    let Some(gpu) = device() else { return };
    let edges = [0.0, 1.0, -0.0, 0.5, 1.0 + f32::EPSILON, -1e-40, 1e-40, 2.0];
    let poison = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN, f32::NAN];
    let mut random = Random(5);
    let cases = [vec![], edges.to_vec(), poison.to_vec(), random.vec_f32(67 * 4, -0.5, 1.5)];
    for data in cases {
        let v_data = random.vec_f32(data.len(), -1.0, 1.0);
        let [y, v_x] = both_ways(&gpu, (&data, &v_data), |rec, [x, v_y], [y, v_x]| {
            forward(rec, x, y)?;
            backward(rec, x, v_y, v_x)
        });
        // Vulkan lets a device take a denormal for zero, also where it asks on which side of zero it lies.
        let near = |g: f32, w: f32| g == w || g.is_nan() && w.is_nan() || (g - w).abs() < f32::MIN_POSITIVE;
        let want = twin::forward(&data);
        assert!(y.iter().zip(&want).all(|(g, w)| near(*g, *w)), "forward of {data:?}: {y:?}");
        let flushed: Vec<f32> = data.iter().map(|x| if x.is_subnormal() { 0.0 } else { *x }).collect();
        let [kept, flushed] = [&data, &flushed].map(|x| twin::backward(x, &v_data));
        let either = (0..v_x.len()).all(|i| near(v_x[i], kept[i]) || near(v_x[i], flushed[i]));
        assert!(either, "backward of {data:?}: {v_x:?}");
    }
}
