//! image/normalize: twin against differences, GPU against the twin.

use guard4d_kernels::image::normalize::{Normalization, backward, forward};
use guard4d_kernels::reference::image::normalize as twin;

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
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
        let mut data = Random(n as u64).vec_f32(n * 4, 0.0, 1.0);
        if n > 64 {
            data[8] = 1e-40;
            data[20] = f32::NAN;
        }
        let x = upload(&gpu, &data);
        let (mut y, mut v_x) = (unwritten(&gpu, n * 4), unwritten(&gpu, n * 4));
        run(&gpu, |rec| {
            forward(rec, &BY, &x, &mut y)?;
            backward(rec, &BY, &x, &mut v_x)
        });
        let pairs = [(y, twin::forward(BY.mean, BY.std, &data)), (v_x, twin::backward(BY.std, &data))];
        for (got, mut want) in pairs {
            let mut got = got.read().expect("read");
            if n > 64 {
                assert!(got[20].is_nan() && want[20].is_nan(), "NaN stays NaN");
                (got[20], want[20]) = (0.0, 0.0);
            }
            // One subtraction and one division.
            assert_close(&got, &want, 1e-6, 1e-6);
        }
    }
}
