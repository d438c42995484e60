//! image/normalize: twin against differences, GPU against the twin.

use guard4d_kernels::image::normalize::{Normalization, backward, forward};
use guard4d_kernels::reference::image::normalize as twin;

use super::{dot, run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const BY: Normalization = Normalization { mean: [0.5, 0.4, 0.3], std: [0.2, 0.3, 0.4] };

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(1);
    let (x, v_y) = (random.vec(20, 0.0, 1.0), random.vec(20, -1.0, 1.0));
    let (mean, std) = (BY.mean.map(f64::from), BY.std.map(f64::from));
    let worst = gradcheck(|x| dot(&twin::forward(mean, std, x), &v_y), &x, &twin::backward(std, &v_y));
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn gpu_follows_the_twin_poison_included() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 65, 300] {
        let clean = Random(n as u64).vec_f32(n * 8, 0.0, 1.0);
        let on_gpu = |data: &[f32]| {
            let (x, v_y) = (upload(&gpu, &data[..n * 4]), upload(&gpu, &data[n * 4..]));
            let (mut y, mut v_x) = (unwritten(&gpu, n * 4), unwritten(&gpu, n * 4));
            run(&gpu, |rec| {
                forward(rec, &BY, &x, &mut y)?;
                backward(rec, &BY, &v_y, &mut v_x)
            });
            [y.read().expect("read"), v_x.read().expect("read")].concat()
        };
        let on_host = |data: &[f32]| {
            let (x, v_y) = data.split_at(n * 4);
            [twin::forward(BY.mean, BY.std, x), twin::backward(BY.std, v_y)].concat()
        };
        // A colour of the last pixel in x and in v_y, and their fourth channels, which nothing reads.
        let places: &[usize] = if n == 0 { &[] } else { &[n * 4 - 3, n * 8 - 3, n * 4 - 1, n * 8 - 1] };
        // One subtraction and one division.
        let reach = poison::spread(&clean, places, (1e-6, 1e-6), on_gpu, on_host);
        assert!(n == 0 || reach == [1, 1, 0, 0], "itself: {reach:?}");
    }
}
