//! nn/max_pool

use guard4d_kernels::nn::max_pool::{MaxPool, backward, forward};
use guard4d_kernels::reference::nn::max_pool as twin;
use guard4d_kernels::{Device, KernelError};

use super::{dot, run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

/// The windows of VGG and of `AlexNet`, over sizes that they do not cover, and windows with gaps between them.
const SHAPES: [MaxPool; 5] = [
    MaxPool { frames: 1, height: 2, width: 2, channels: 4, side: 2, stride: 2 },
    MaxPool { frames: 2, height: 5, width: 7, channels: 8, side: 2, stride: 2 },
    MaxPool { frames: 2, height: 7, width: 6, channels: 4, side: 3, stride: 2 },
    MaxPool { frames: 1, height: 9, width: 8, channels: 12, side: 2, stride: 3 },
    MaxPool { frames: 1, height: 3, width: 3, channels: 4, side: 1, stride: 1 },
];

#[test]
fn twin_gradient_matches_differences() {
    for s in SHAPES {
        let mut random = Random(s.width as u64);
        let (x, v_y) = (random.vec(s.lens().0, -1.0, 1.0), random.vec(s.lens().1, -1.0, 1.0));
        let error = gradcheck(|x| dot(&twin::forward(&s, x), &v_y), &x, &twin::backward(&s, &x, &v_y));
        assert!(error < 1e-6, "{s:?}: {error}");
    }
}

/// Both passes; x is longer than the gradient needs it, as behind a batch of which the first half has one.
fn on_gpu(gpu: &Device, s: &MaxPool, x: &[f32], v_y: &[f32]) -> Vec<f32> {
    let (mut y, mut v_x) = (unwritten(gpu, v_y.len()), unwritten(gpu, x.len()));
    let (once, twice, v_y) = (upload(gpu, x), upload(gpu, &[x, x].concat()), upload(gpu, v_y));
    run(gpu, |rec| {
        forward(rec, s, &once, &mut y)?;
        backward(rec, s, &twice, &v_y, &mut v_x)
    });
    [y.read().expect("read"), v_x.read().expect("read")].concat()
}

fn on_host(s: &MaxPool, x: &[f32], v_y: &[f32]) -> Vec<f32> {
    [twin::forward(s, x), twin::backward(s, x, v_y)].concat()
}

#[test]
fn gpu_equals_the_twin() {
    let Some(gpu) = device() else { return };
    for s in SHAPES.into_iter().chain([MaxPool { frames: 0, ..SHAPES[0] }]) {
        let mut random = Random(s.height as u64);
        // Of few levels, so that many windows hold their largest value several times: the first counts.
        let x: Vec<f32> = random.vec_f32(s.lens().0, -2.0, 2.0).iter().map(|v| v.round()).collect();
        // Halves: their sums are exact, in any order.
        let v_y: Vec<f32> = random.vec_f32(s.lens().1, -8.0, 8.0).iter().map(|v| v.round() / 2.0).collect();
        assert_eq!(on_gpu(&gpu, &s, &x, &v_y), on_host(&s, &x, &v_y), "{s:?}");
    }
}

#[test]
fn of_equal_values_the_first_gets_the_gradient() {
    let s = SHAPES[0];
    let v_x = twin::backward(&s, &[1.0_f64; 16], &[5.0; 4]);
    assert_eq!(v_x, [vec![5.0; 4], vec![0.0; 12]].concat(), "as PyTorch has it");
}

#[test]
fn poison_reaches_the_windows_over_it() {
    let Some(gpu) = device() else { return };
    let s = SHAPES[2];
    let (x, v_y) = s.lens();
    let clean = Random(5).vec_f32(x + v_y, -1.0, 1.0);
    let on_gpu = |data: &[f32]| on_gpu(&gpu, &s, &data[..x], &data[x..]);
    let on_host = |data: &[f32]| on_host(&s, &data[..x], &data[x..]);
    // Pixels in four windows, in one and in none (a last column that no window reaches); then a gradient. Up to four
    // gradients below 1 are added.
    let places = [(2 * 6 + 2) * 4, 0, 5 * 4, x];
    let reach = poison::spread(&clean, &places, (1e-6, 1e-6), on_gpu, on_host);
    assert_eq!(reach, [4, 1, 0, 1], "windows");
}

#[test]
fn what_does_not_fit_is_refused() {
    let Some(gpu) = device() else { return };
    let s = SHAPES[0];
    let (x, mut y) = (upload(&gpu, &[0.0; 16]), unwritten(&gpu, 4));
    let mut rec = gpu.recorder().expect("recorder");
    for (pool, name) in [
        (MaxPool { channels: 3, ..s }, "channels"),
        (MaxPool { side: 3, ..s }, "side"),
        (MaxPool { stride: 0, ..s }, "side"),
        (MaxPool { side: 0, ..s }, "side"),
        (MaxPool { frames: 2, ..s }, "x"),
        (MaxPool { stride: 1, side: 1, ..s }, "y"),
    ] {
        let wrong = forward(&mut rec, &pool, &x, &mut y);
        assert!(matches!(wrong, Err(KernelError::Shape { buffer, .. }) if buffer == name), "{pool:?}: {wrong:?}");
    }
    let mut v_x = unwritten(&gpu, 12);
    let wrong = backward(&mut rec, &s, &x, &y, &mut v_x);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "v_x", .. })), "{wrong:?}");
}
