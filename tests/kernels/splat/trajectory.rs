//! splat/trajectory: GPU against the twin, and the twin against paths worked out by hand.

use guard4d_kernels::reference::splat::trajectory as twin;
use guard4d_kernels::splat::trajectory::{PATH_FLOATS, Paths, forward};
use guard4d_kernels::{Device, KernelError};

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn a_splat_rises_turns_and_fades() {
    // Centre 0.5 and duration 0.25, so that at 0.75 the opacity 1/2 has fallen by a factor e.
    let path = [1.0, 0.0, 0.0, 0.5, 0.0, 2.0, 0.0, 4.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 8.0];
    let (means, quats) = twin::forward(&[0.0f64; 4], &[1.0, 0.0, 0.0, 0.0], &path, 0.75);
    let opacity = 0.5 * (-1.0f64).exp();
    let want = [0.25, 2.0 * 0.0625, 3.0 * 0.015_625, (opacity / (1.0 - opacity)).ln()];
    let error = means.iter().zip(want).map(|(g, w)| (g - w).abs()).sum::<f64>();
    assert!(error < 1e-12, "{means:?} instead of {want:?}");
    assert_eq!(quats, [1.0, 0.0, 0.0, 2.0], "the quaternion turns by dt times 8");
}

#[test]
fn opaque_splats_fade_without_cancellation() {
    // 1 - sigmoid(20) is 2e-9, far below the steps of floats near 1.
    let path = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    for (logit, time) in [(20.0f32, 0.0f32), (20.0, 1e-3), (-30.0, 0.5), (3.0, 4.0)] {
        let (low, _) = twin::forward(&[0.0, 0.0, 0.0, logit], &[1.0, 0.0, 0.0, 0.0], &path, time);
        let path = path.map(f64::from);
        let splat = [0.0, 0.0, 0.0, f64::from(logit)];
        let (high, _) = twin::forward(&splat, &[1.0, 0.0, 0.0, 0.0], &path, f64::from(time));
        // A few roundings of terms of the size of the result; 1 - exp(-1e-6) keeps four digits.
        assert!((f64::from(low[3]) - high[3]).abs() < 3e-2, "{logit} at {time}: {} against {}", low[3], high[3]);
    }
}

fn on_gpu(gpu: &Device, splats: [&[f32]; 3], time: f32) -> Result<Vec<f32>, KernelError> {
    let [means, quats, paths] = splats.map(|data| gpu.buffer_from("input", data).expect("buffer"));
    let mut moved = [means.len(), means.len()].map(|len| gpu.buffer("moved", len).expect("buffer"));
    let [moved_means, moved_quats] = &mut moved;
    let mut rec = gpu.recorder()?;
    let splats = Paths { means: &means, quats: &quats, paths: &paths };
    forward(&mut rec, splats, time, moved_means, moved_quats)?;
    rec.submit()?;
    Ok(moved.map(|buffer| buffer.read().expect("read")).concat())
}

/// Rounding of a dozen operations on values up to about 10, with the exponential and the logarithm of a driver.
const TOLERANCE: (f32, f32) = (1e-5, 1e-5);

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 63, 200] {
        let mut random = Random(n as u64);
        let (means, quats) = (random.vec_f32(4 * n, -3.0, 3.0), random.vec_f32(4 * n, -1.0, 1.0));
        let paths = random.vec_f32(PATH_FLOATS * n, -2.0, 2.0);
        for time in [0.0, 0.37, 1.0] {
            let (want_means, want_quats) = twin::forward(&means, &quats, &paths, time);
            let got = on_gpu(&gpu, [&means, &quats, &paths], time).expect("runs");
            assert_close(&got, &[want_means, want_quats].concat(), TOLERANCE.0, TOLERANCE.1);
        }
    }
    let short = on_gpu(&gpu, [&[0.0; 4], &[0.0; 4], &[0.0; 15]], 0.0);
    assert!(matches!(short, Err(KernelError::Shape { buffer: "paths", .. })), "{short:?}");
}

#[test]
fn poison_stays_in_its_splat() {
    let Some(gpu) = device() else { return };
    let n = 2;
    let clean = Random(7).vec_f32((8 + PATH_FLOATS) * n, 0.2, 1.0);
    let parts = |data: &[f32]| [data[..4 * n].to_vec(), data[4 * n..8 * n].to_vec(), data[8 * n..].to_vec()];
    let on_device = |data: &[f32]| {
        let [means, quats, paths] = parts(data);
        on_gpu(&gpu, [&means, &quats, &paths], 0.5).expect("runs")
    };
    let on_host = |data: &[f32]| {
        let [means, quats, paths] = parts(data);
        let (means, quats) = twin::forward(&means, &quats, &paths, 0.5);
        [means, quats].concat()
    };
    // A coordinate, an opacity, a quaternion; a coefficient and the turn of a path, and its centre, which moves
    // everything.
    let places = [1, 3, 4 * n + 2, 8 * n + 4, 8 * n + 13, 8 * n + 3];
    let reach = poison::spread(&clean, &places, TOLERANCE, on_device, on_host);
    assert_eq!(reach, [1, 1, 1, 1, 1, 8], "outputs that a NaN reaches");
}
