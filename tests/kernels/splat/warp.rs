//! splat/warp: GPU against the twin, and the twin against motions worked out by hand.

use guard4d_kernels::reference::splat::warp as twin;
use guard4d_kernels::splat::deform::DeformedOut;
use guard4d_kernels::splat::project::RawSplats;
use guard4d_kernels::splat::warp::{Shift, WARP_COLUMNS, apply};
use guard4d_kernels::{Device, KernelError};

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

const SHIFTS: [Shift; 2] = [Shift::Offset, Shift::Screw];

#[test]
fn a_quarter_turn_about_z_takes_x_to_y() {
    let splats = [vec![1.0f64, 0.0, 0.0, 7.0], vec![0.0; 4], vec![2.0, 0.0, 0.0, 0.0]];
    let mut head = [0.0; WARP_COLUMNS];
    head[14] = std::f64::consts::FRAC_PI_2;
    // Growth by 1 of a standard deviation of 1, and half a turn's worth of z in the quaternion.
    head[4..12].copy_from_slice(&[1.0, 0.0, -3.0, 0.0, 0.0, 0.0, 0.0, 0.5]);
    let [means, scales, quats] = twin::apply(&splats, &head, true);
    // The axis is nudged by 1e-5 in every direction, as in the authors' code.
    let near = |got: &[f64], want: [f64; 4]| got.iter().zip(want).all(|(g, w)| (g - w).abs() < 5e-5);
    assert!(near(&means, [0.0, 1.0, 0.0, 7.0]), "{means:?}");
    assert!(near(&scales, [2.0f64.ln(), 0.0, 2.0f64.ln(), 1.0]), "{scales:?}: |1 - 3| is 2");
    assert_eq!(quats, [1.0, 0.0, 0.0, 0.5], "made a unit, then added to");
    let [means, ..] = twin::apply(&splats, &head, false);
    assert_eq!(means, splats[0], "without the screw nothing moves");
}

fn on_gpu(gpu: &Device, splats: &[Vec<f32>; 3], heads: &[f32], shift: Shift) -> Result<Vec<f32>, KernelError> {
    let [means, scales, quats] = splats.each_ref().map(|data| gpu.buffer_from("input", data).expect("buffer"));
    let heads = gpu.buffer_from("heads", heads)?;
    let mut out = splats.each_ref().map(|data| gpu.buffer::<f32>("out", data.len()).expect("buffer"));
    let [out_means, out_scales, out_quats] = &mut out;
    let mut rec = gpu.recorder()?;
    let raw = RawSplats { means: &means, scales: &scales, quats: &quats, buckets: None };
    let into = DeformedOut { means: out_means, scales: out_scales, quats: out_quats };
    apply(&mut rec, raw, &heads, shift, into)?;
    rec.submit()?;
    Ok(out.map(|buffer| buffer.read().expect("read")).concat())
}

/// Some twenty roundings of values up to 10, and a driver's sine, exponential and logarithm.
const TOLERANCE: (f32, f32) = (2e-5, 1e-5);

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 65, 200] {
        let mut random = Random(n as u64);
        let splats = [0, 1, 2].map(|_| random.vec_f32(4 * n, -1.0, 1.0));
        let mut heads = random.vec_f32(WARP_COLUMNS * n, -1.0, 1.0);
        // Standard deviations only grow: the logarithm of a difference of near numbers has no digits to compare.
        heads.chunks_exact_mut(WARP_COLUMNS).flat_map(|head| &mut head[4..7]).for_each(|ds| *ds = ds.abs());
        for shift in SHIFTS {
            let want = twin::apply(&splats, &heads, shift == Shift::Screw).concat();
            let got = on_gpu(&gpu, &splats, &heads, shift).expect("runs");
            assert_close(&got, &want, TOLERANCE.0, TOLERANCE.1);
        }
    }
    let short = on_gpu(&gpu, &[vec![0.0; 4], vec![0.0; 4], vec![0.0; 4]], &[0.0; 15], Shift::Offset);
    assert!(matches!(short, Err(KernelError::Shape { buffer: "heads", .. })), "{short:?}");
}

#[test]
fn poison_stays_in_its_splat() {
    let Some(gpu) = device() else { return };
    let n = 2;
    let clean = Random(9).vec_f32((12 + WARP_COLUMNS) * n, 0.2, 1.0);
    let parts = |data: &[f32]| ([0, 1, 2].map(|k| data[4 * k * n..4 * (k + 1) * n].to_vec()), data[12 * n..].to_vec());
    let on_device = |data: &[f32]| {
        let (splats, heads) = parts(data);
        on_gpu(&gpu, &splats, &heads, Shift::Offset).expect("runs")
    };
    let on_host = |data: &[f32]| {
        let (splats, heads) = parts(data);
        twin::apply(&splats, &heads, false).concat()
    };
    // A coordinate, an opacity, and the heads of a position and of a rotation.
    let reach = poison::spread(&clean, &[1, 3, 12 * n + 2, 12 * n + 9], TOLERANCE, on_device, on_host);
    assert_eq!(reach, [1, 1, 1, 1], "outputs that a NaN reaches");
}
