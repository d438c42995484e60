mod activation;
mod attention;
mod axpy;
mod column_sum;
mod conv2d;
mod conv3d;
mod embedding;
mod l2_normalize;
mod layer_norm;
mod matmul;
mod max_pool;
mod pack;
mod patch_embed;
mod row_mean;
mod transpose;

use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

/// Records, runs and waits.
pub(super) fn run(gpu: &Device, record: impl FnOnce(&mut Recorder) -> Result<(), KernelError>) {
    let mut rec = gpu.recorder().expect("recorder");
    record(&mut rec).expect("records");
    rec.submit().expect("runs");
}

pub(super) fn upload(gpu: &Device, data: &[f32]) -> Buffer<f32> {
    gpu.buffer_from("test input", data).expect("buffer")
}

/// A buffer full of NaN: whatever a kernel forgets to write fails the comparison.
pub(super) fn unwritten(gpu: &Device, len: usize) -> Buffer<f32> {
    upload(gpu, &vec![f32::NAN; len])
}

/// What forward (y) and backward (v_x) write for `x` and `v_y`, all of one length.
pub(super) fn both_ways(
    gpu: &Device,
    x: &[f32],
    v_y: &[f32],
    record: impl FnOnce(&mut Recorder, [&Buffer<f32>; 2], [&mut Buffer<f32>; 2]) -> Result<(), KernelError>,
) -> [Vec<f32>; 2] {
    let (mut y, mut v_x) = (unwritten(gpu, x.len()), unwritten(gpu, x.len()));
    let (x, v_y) = (upload(gpu, x), upload(gpu, v_y));
    run(gpu, |rec| record(rec, [&x, &v_y], [&mut y, &mut v_x]));
    [y.read().expect("read"), v_x.read().expect("read")]
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}
