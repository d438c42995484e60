mod chroma420;
mod colour_map;
mod crop;
mod jpeg;
mod levels;
mod noise;
mod normalize;
mod quantize;
mod resize;
mod warp;

use guard4d_kernels::{Buffer, KernelError, Recorder};

use super::nn::{both_ways, dot, run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

/// The GPU against the twin for images of several sizes, poison included: one in a colour of `x` or `v_y` must reach
/// `reach` outputs, one in a fourth channel none, because nothing reads it.
#[track_caller]
fn follows_the_twin(
    tolerance: (f32, f32),
    reach: usize,
    on_gpu: impl Fn(&mut Recorder, [&Buffer<f32>; 2], [&mut Buffer<f32>; 2]) -> Result<(), KernelError>,
    on_host: impl Fn(&[f32], &[f32]) -> [Vec<f32>; 2],
) {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 65, 300] {
        let clean = Random(n as u64).vec_f32(n * 8, 0.0, 1.0);
        let on_gpu = |data: &[f32]| both_ways(&gpu, &data[..n * 4], &data[n * 4..], &on_gpu).concat();
        let on_host = |data: &[f32]| on_host(&data[..n * 4], &data[n * 4..]).concat();
        // The last pixel of x and of v_y: a colour, then the fourth channel.
        let places: &[usize] = if n == 0 { &[] } else { &[n * 4 - 3, n * 8 - 3, n * 4 - 1, n * 8 - 1] };
        let reached = poison::spread(&clean, places, tolerance, on_gpu, on_host);
        assert!(n == 0 || reached == [reach, reach, 0, 0], "{reached:?} outputs, expected {reach} of a colour");
    }
}
