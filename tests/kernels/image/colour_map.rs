//! image/colour_map: twin against differences, GPU against the twin.

use guard4d_kernels::image::colour_map::{ColourMap, backward, forward};
use guard4d_kernels::reference::image::colour_map as twin;

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

/// Not symmetric, so that a forgotten transposition shows.
const MAP: ColourMap = [[0.5, -0.25, 2.0], [1.5, 0.125, -1.0], [-0.75, 3.0, 0.25]];

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(1);
    let (x, v_y) = (random.vec(20, 0.0, 1.0), random.vec(20, -1.0, 1.0));
    let map = MAP.map(|row| row.map(f64::from));
    let worst = gradcheck(|x| dot(&twin::forward(map, x), &v_y), &x, &twin::backward(map, &v_y));
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn gpu_follows_the_twin_poison_included() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 65, 300] {
        let mut data = Random(n as u64).vec_f32(n * 4, 0.0, 1.0);
        if n > 64 {
            data[9] = 1e-40;
            data[20] = f32::NAN;
        }
        let x = upload(&gpu, &data);
        let (mut y, mut v_x) = (unwritten(&gpu, n * 4), unwritten(&gpu, n * 4));
        run(&gpu, |rec| {
            forward(rec, &MAP, &x, &mut y)?;
            backward(rec, &MAP, &x, &mut v_x)
        });
        for (got, mut want) in [(y, twin::forward(MAP, &data)), (v_x, twin::backward(MAP, &data))] {
            let mut got = got.read().expect("read");
            if n > 64 {
                for i in 20..23 {
                    assert!(got[i].is_nan() && want[i].is_nan(), "a pixel with NaN is NaN in every colour");
                    (got[i], want[i]) = (0.0, 0.0);
                }
            }
            // Three products of numbers up to 3, summed.
            assert_close(&got, &want, 2e-6, 1e-6);
        }
    }
}
