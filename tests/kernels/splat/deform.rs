//! splat/deform: GPU against the twin, and the twin against rotations worked out by hand.

use guard4d_kernels::KernelError;
use guard4d_kernels::reference::splat::deform as twin;
use guard4d_kernels::splat::deform::{
    ALL_COLUMNS, DeformedOut, GEOMETRY_COLUMNS, Heads, RotationUpdate, apply, apply_sh,
};
use guard4d_kernels::splat::project::RawSplats;

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::random::Random;

const UPDATES: [(RotationUpdate, twin::RotationUpdate); 3] = [
    (RotationUpdate::Keep, twin::RotationUpdate::Keep),
    (RotationUpdate::Add, twin::RotationUpdate::Add),
    (RotationUpdate::Multiply, twin::RotationUpdate::Multiply),
];

#[test]
fn two_quarter_turns_make_a_half_turn() {
    // z then z by 90 degrees, of norms 2 and 3: 180 degrees about z, of norm 1.
    let splats = [vec![0.0; 4], vec![0.0; 4], vec![2.0f64, 0.0, 0.0, 2.0]];
    let heads = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 3.0];
    let out = twin::apply(&splats, &heads, 12, twin::RotationUpdate::Multiply);
    let error = out[2].iter().zip([0.0, 0.0, 0.0, 1.0]).map(|(g, w): (&f64, f64)| (g - w).abs()).sum::<f64>();
    assert!(error < 1e-12, "{:?}", out[2]);
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (n, columns) in [(1, GEOMETRY_COLUMNS), (100, GEOMETRY_COLUMNS + 4), (65, ALL_COLUMNS), (9, ALL_COLUMNS + 4)] {
        let mut random = Random(n as u64);
        let splats = [0, 1, 2].map(|_| random.vec_f32(4 * n, -1.0, 1.0));
        let heads = random.vec_f32(columns * n, -1.0, 1.0);
        let sh = random.vec_f32(48 * n, -1.0, 1.0);
        let buffer = |data: &[f32]| gpu.buffer_from("input", data).expect("buffer");
        let [means, scales, quats] = [0, 1, 2].map(|k| buffer(&splats[k]));
        let (heads_gpu, sh_gpu) = (buffer(&heads), buffer(&sh));
        let heads_in = Heads { data: &heads_gpu, columns };
        for (update, twin_update) in UPDATES {
            let mut out = [0, 1, 2].map(|_| gpu.buffer::<f32>("out", 4 * n).expect("buffer"));
            let [out_means, out_scales, out_quats] = &mut out;
            let mut rec = gpu.recorder().expect("recorder");
            let raw = RawSplats { means: &means, scales: &scales, quats: &quats };
            let into = DeformedOut { means: out_means, scales: out_scales, quats: out_quats };
            apply(&mut rec, raw, heads_in, update, into).expect("records");
            rec.submit().expect("runs");
            let want = twin::apply(&splats, &heads, columns, twin_update);
            for (got, want) in out.iter().zip(&want) {
                // Sums are exact; a normalised product has about ten roundings, and 16 for tiny norms.
                assert_close(&got.read().expect("read"), want, 2e-6, 0.0);
            }
        }
        let mut deformed = gpu.buffer("sh", 48 * n).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        let result = apply_sh(&mut rec, &sh_gpu, heads_in, &mut deformed);
        if columns < ALL_COLUMNS {
            assert!(matches!(result, Err(KernelError::Shape { buffer: "heads", .. })), "{result:?}");
            continue;
        }
        rec.submit().expect("runs");
        assert_close(&deformed.read().expect("read"), &twin::apply_sh(&sh, &heads, columns), 0.0, 0.0);
    }
}

#[test]
fn poison_stays_in_its_splat() {
    let Some(gpu) = device() else { return };
    let mut heads = vec![0.5f32; 24];
    heads[0] = f32::NAN;
    heads[9] = f32::INFINITY;
    let ones = gpu.buffer_from("ones", &[1.0f32; 8]).expect("buffer");
    let heads = gpu.buffer_from("heads", &heads).expect("buffer");
    let mut out = [0, 1, 2].map(|_| gpu.buffer::<f32>("out", 8).expect("buffer"));
    let [means, scales, quats] = &mut out;
    let mut rec = gpu.recorder().expect("recorder");
    let raw = RawSplats { means: &ones, scales: &ones, quats: &ones };
    let heads = Heads { data: &heads, columns: GEOMETRY_COLUMNS };
    apply(&mut rec, raw, heads, RotationUpdate::Multiply, DeformedOut { means, scales, quats }).expect("records");
    rec.submit().expect("runs");
    assert!(out[0].read().expect("read")[0].is_nan(), "a NaN shows");
    for buffer in &out {
        assert!(buffer.read().expect("read")[4..].iter().all(|v| v.is_finite()), "the other splat is untouched");
    }
}
