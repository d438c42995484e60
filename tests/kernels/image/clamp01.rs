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
        // A driver may take denormals for zeros, and either for the other on its way out.
        let tiny = |v: f32| v.abs() < f32::MIN_POSITIVE;
        let equal = |g: f32, w: f32| g == w || g.is_nan() && w.is_nan() || tiny(g) && tiny(w);
        let same = |got: &[f32], want: &[f32]| got.iter().zip(want).all(|(g, w)| equal(*g, *w));
        let flushed: Vec<f32> = data.iter().map(|v| if tiny(*v) { 0.0 } else { *v }).collect();
        assert!(same(&y, &twin::forward(&data)), "forward of {data:?}: {y:?}");
        let wants = [&data, &flushed].map(|x| twin::backward(x, &v_data));
        assert!(wants.iter().any(|want| same(&v_x, want)), "backward of {data:?}: {v_x:?}");
    }
}
