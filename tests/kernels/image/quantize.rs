//! image/quantize: GPU against the twin, every level, halves and poison.

use guard4d_kernels::image::quantize::forward;
use guard4d_kernels::reference::image::quantize as twin;

use super::{run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;

#[test]
fn every_level_is_kept_and_values_between_round() {
    let Some(gpu) = device() else { return };
    let mut data: Vec<f32> = (0..256).flat_map(|v| [v as f32 / 255.0, (v as f32 + 0.3) / 255.0, -0.5, 0.7]).collect();
    data.extend([1.5, (10.0 + 0.6) / 255.0, f32::INFINITY, 0.0]);
    let x = upload(&gpu, &data);
    let mut y = unwritten(&gpu, data.len());
    run(&gpu, |rec| forward(rec, &x, &mut y));
    let y = y.read().expect("read");
    // The quotient by 255 may round in the last place.
    assert_close(&y, &twin::forward(&data), 1e-7, 0.0);
    for (v, pixel) in y.chunks_exact(4).take(256).enumerate() {
        let level = v as f32 / 255.0;
        assert_close(pixel, &[level, level, 0.0, 0.7], 1e-7, 0.0);
    }
}

#[test]
fn nan_stays_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let x = upload(&gpu, &[f32::NAN, 1e-40, 0.5, 0.0]);
    let none = upload(&gpu, &[]);
    let (mut y, mut nothing) = (unwritten(&gpu, 4), unwritten(&gpu, 0));
    run(&gpu, |rec| {
        forward(rec, &x, &mut y)?;
        forward(rec, &none, &mut nothing)
    });
    let y = y.read().expect("read");
    assert!(y[0].is_nan() && y[1] == 0.0 && (y[2] - 128.0 / 255.0).abs() < 1e-7, "{y:?}");
}
