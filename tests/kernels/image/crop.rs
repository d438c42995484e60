//! image/crop: twin against differences, GPU against the twin, poison.

use guard4d_kernels::image::crop::{Cells, Crop, Window, backward, forward};
use guard4d_kernels::image::normalize::Normalization;
use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::reference::image::crop as twin;
use guard4d_kernels::{Device, KernelError};

use super::{dot, run, upload};
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const BY: Normalization = Normalization { mean: [0.5, 0.4, 0.3], std: [0.2, 0.3, 0.4] };

const fn crop(frame: usize, frames: usize, corner: [usize; 2], size: [usize; 2], cells: Cells) -> Crop {
    let [height, width] = size;
    let full = ImageSize { height: 9, width: 11 };
    Crop { window: Window { frame, frames, corner, size: ImageSize { height, width }, full }, cells }
}

/// A whole clip pixel by pixel, windows in cells of four with a border, cells that leave out the last pixels, an empty
/// one.
const CROPS: [Crop; 5] = [
    crop(0, 2, [0, 0], [9, 11], Cells { grid: [9, 11], patch: 1, padding: 0 }),
    crop(1, 1, [2, 3], [7, 8], Cells { grid: [3, 3], patch: 4, padding: 2 }),
    crop(0, 2, [1, 0], [8, 10], Cells { grid: [2, 2], patch: 4, padding: 0 }),
    crop(1, 1, [8, 10], [1, 1], Cells { grid: [2, 3], patch: 3, padding: 1 }),
    crop(0, 0, [0, 0], [4, 4], Cells { grid: [2, 2], patch: 2, padding: 0 }),
];
/// Floats of a clip of two frames.
const CLIP: usize = 2 * 9 * 11 * 4;

#[test]
fn twin_gradient_matches_differences() {
    let (mean, std) = (BY.mean.map(f64::from), BY.std.map(f64::from));
    for crop in &CROPS {
        let mut random = Random(1);
        let (x, v_y) = (random.vec(CLIP, 0.0, 1.0), random.vec(crop.cells.len(crop.window.frames), -1.0, 1.0));
        let mut v_x = vec![0.0; CLIP];
        twin::backward(crop, std, &v_y, &mut v_x);
        let worst = gradcheck(|x| dot(&twin::forward(crop, mean, std, x), &v_y), &x, &v_x);
        assert!(worst < 1e-6, "{crop:?}: {worst}");
    }
}

/// Cells from the second frame of a longer buffer on, and the gradient on top of 0.5 everywhere.
fn on_gpu(gpu: &Device, crop: &Crop, x: &[f32], v_y: &[f32]) -> Vec<f32> {
    let first = crop.cells.len(1);
    let mut y = upload(gpu, &vec![7.0; first + v_y.len()]);
    let (x, v_y, mut v_x) = (upload(gpu, x), upload(gpu, v_y), upload(gpu, &[0.5; CLIP]));
    run(gpu, |rec| {
        forward(rec, crop, &BY, &x, &mut y, 1)?;
        backward(rec, crop, &BY, &v_y, &mut v_x)
    });
    let y = y.read().expect("read");
    assert!(y[..first].iter().all(|v| *v == 7.0), "the frame before is untouched");
    [&y[first..], &v_x.read().expect("read")].concat()
}

fn on_host(crop: &Crop, x: &[f32], v_y: &[f32]) -> Vec<f32> {
    let mut v_x = vec![0.5; CLIP];
    twin::backward(crop, BY.std, v_y, &mut v_x);
    [twin::forward(crop, BY.mean, BY.std, x), v_x].concat()
}

#[test]
fn gpu_follows_the_twin_poison_included() {
    let Some(gpu) = device() else { return };
    for crop in &CROPS {
        let clean = Random(2).vec_f32(CLIP + crop.cells.len(crop.window.frames), 0.0, 1.0);
        let Window { frame, corner, full, .. } = crop.window;
        let pixel = ((frame * full.height + corner[0]) * full.width + corner[1]) * 4;
        // A colour of the window's first pixel, and its fourth channel, which is not read.
        let places = [pixel + 1, pixel + 3];
        let (on_gpu, on_host) = (
            |data: &[f32]| on_gpu(&gpu, crop, &data[..CLIP], &data[CLIP..]),
            |data: &[f32]| on_host(crop, &data[..CLIP], &data[CLIP..]),
        );
        // One subtraction, one division, one sum.
        let reach = poison::spread(&clean, &places, (1e-6, 1e-6), on_gpu, on_host);
        let seen = usize::from(crop.window.frames > 0);
        assert_eq!(reach, [seen, 0], "{crop:?}");
    }
}

#[test]
fn windows_outside_the_clip_are_refused() {
    let Some(gpu) = device() else { return };
    let (x, mut y) = (upload(&gpu, &[0.0; CLIP]), upload(&gpu, &[0.0; 2 * 9 * 11 * 8]));
    let mut rec = gpu.recorder().expect("recorder");
    let mut refused = |crop: Crop, y_frame| forward(&mut rec, &crop, &BY, &x, &mut y, y_frame);
    let whole = CROPS[0];
    let wrong = refused(Crop { window: Window { corner: [1, 0], ..whole.window }, ..whole }, 0);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "window", .. })), "{wrong:?}");
    let wrong = refused(Crop { window: Window { frame: 1, ..whole.window }, ..whole }, 0);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "x", .. })), "{wrong:?}");
    let wrong = refused(whole, 1);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "y", .. })), "{wrong:?}");
}
