//! image/chroma420: the inverse map, twin against differences, GPU against the twin, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::image::chroma420::{JFIF, backward, forward, inverse};
use guard4d_kernels::image::colour_map::ColourMap;
use guard4d_kernels::reference::image::chroma420 as twin;
use guard4d_kernels::shape::ClipShape;

use super::{both_ways, dot, run, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

fn transposed(m: ColourMap) -> ColourMap {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]))
}

#[test]
fn the_inverse_is_the_standards_way_back() {
    // JFIF 1.02 prints the way back with five digits.
    let printed = [[1.0, 0.0, 1.402], [1.0, -0.344_14, -0.714_14], [1.0, 1.772, 0.0]];
    assert_close(inverse(&JFIF).as_flattened(), printed.as_flattened(), 1e-5, 0.0);
}

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(6);
    let (a, b) = (JFIF.map(|r| r.map(f64::from)), inverse(&JFIF).map(|r| r.map(f64::from)));
    let flip = |m: [[f64; 3]; 3]| std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]));
    for size in [[3, 5], [4, 2]] {
        let n = size[0] * size[1] * 4;
        let (x, v_y) = (random.vec(n, 0.0, 1.0), random.vec(n, -1.0, 1.0));
        let grad = twin::apply(&v_y, size, [flip(b), flip(a)]);
        let worst = gradcheck(|x| dot(&twin::apply(x, size, [a, b]), &v_y), &x, &grad);
        assert!(worst < 1e-6, "{size:?}: {worst}");
    }
}

#[test]
fn gpu_follows_the_twin_poison_included() {
    let Some(gpu) = device() else { return };
    let maps = [JFIF, inverse(&JFIF)];
    let adjoint = [transposed(maps[1]), transposed(maps[0])];
    for (frames, height, width) in [(0, 3, 4), (1, 1, 1), (2, 5, 7), (1, 6, 130)] {
        let clip = ClipShape { frames, height, width };
        let n = clip.pixels() * 4;
        let clean = Random(n as u64).vec_f32(2 * n, 0.0, 1.0);
        let on_gpu = |data: &[f32]| {
            both_ways(&gpu, &data[..n], &data[n..], |rec, [x, v_y], [y, v_x]| {
                forward(rec, clip, x, y)?;
                backward(rec, clip, v_y, v_x)
            })
            .concat()
        };
        let each = |data: &[f32], maps| -> Vec<f32> {
            data.chunks_exact((height * width * 4).max(1)).flat_map(|x| twin::apply(x, [height, width], maps)).collect()
        };
        let on_host = |data: &[f32]| [each(&data[..n], maps), each(&data[n..], adjoint)].concat();
        // A colour of the first pixel, then its fourth channel.
        let places: &[usize] = if n == 0 { &[] } else { &[1, 3] };
        // Means of four and two maps with entries below 2: some ten roundings of numbers up to 2.
        let reached = poison::spread(&clean, places, (2e-6, 0.0), on_gpu, on_host);
        let quad = height.min(2) * width.min(2) * 3;
        assert!(n == 0 || reached == [quad, 0], "{reached:?} outputs, expected the {quad} colours of its quad");
    }
}

#[test]
fn wrong_shapes_are_refused() {
    let Some(gpu) = device() else { return };
    let clip = ClipShape { frames: 1, height: 2, width: 2 };
    let (x, mut y) = (upload(&gpu, &[0.0; 16]), upload(&gpu, &[0.0; 12]));
    run(&gpu, |rec| {
        let refused = forward(rec, clip, &x, &mut y);
        assert!(matches!(refused, Err(KernelError::Shape { buffer: "y", .. })), "{refused:?}");
        Ok(())
    });
}
