//! image/colour_map: twin against differences, GPU against the twin.

use guard4d_kernels::image::colour_map::{ColourMap, backward, forward};
use guard4d_kernels::reference::image::colour_map as twin;

use super::{dot, run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
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
        let clean = Random(n as u64).vec_f32(n * 8, 0.0, 1.0);
        let on_gpu = |data: &[f32]| {
            let (x, v_y) = (upload(&gpu, &data[..n * 4]), upload(&gpu, &data[n * 4..]));
            let (mut y, mut v_x) = (unwritten(&gpu, n * 4), unwritten(&gpu, n * 4));
            run(&gpu, |rec| {
                forward(rec, &MAP, &x, &mut y)?;
                backward(rec, &MAP, &v_y, &mut v_x)
            });
            [y.read().expect("read"), v_x.read().expect("read")].concat()
        };
        let on_host = |data: &[f32]| {
            let (x, v_y) = data.split_at(n * 4);
            [twin::forward(MAP, x), twin::backward(MAP, v_y)].concat()
        };
        // A colour of the last pixel in x and in v_y, and their fourth channels, which nothing reads.
        let places: &[usize] = if n == 0 { &[] } else { &[n * 4 - 3, n * 8 - 3, n * 4 - 1, n * 8 - 1] };
        // Three products of numbers up to 3, summed.
        let reach = poison::spread(&clean, places, (2e-6, 1e-6), on_gpu, on_host);
        assert!(n == 0 || reach == [3, 3, 0, 0], "every colour of its pixel: {reach:?}");
    }
}
