//! splat/deform: GPU against the twin, and the twin against rotations worked out by hand.

use guard4d_kernels::reference::splat::deform as twin;
use guard4d_kernels::splat::deform::{
    ALL_COLUMNS, DeformedOut, GEOMETRY_COLUMNS, Heads, RotationUpdate, apply, apply_sh,
};
use guard4d_kernels::splat::project::RawSplats;
use guard4d_kernels::{Device, KernelError};

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::poison;
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

/// Deformed means, scales and quaternions on the device; `splats` and `heads` as the twin takes them.
fn on_gpu(gpu: &Device, splats: &[Vec<f32>; 3], heads: &[f32], columns: usize, update: RotationUpdate) -> Vec<f32> {
    let [means, scales, quats] = splats.each_ref().map(|data| gpu.buffer_from("input", data).expect("buffer"));
    let heads = gpu.buffer_from("heads", heads).expect("buffer");
    let mut out = splats.each_ref().map(|data| gpu.buffer::<f32>("out", data.len()).expect("buffer"));
    let [out_means, out_scales, out_quats] = &mut out;
    let mut rec = gpu.recorder().expect("recorder");
    let raw = RawSplats { means: &means, scales: &scales, quats: &quats, buckets: None };
    let into = DeformedOut { means: out_means, scales: out_scales, quats: out_quats };
    apply(&mut rec, raw, Heads { data: &heads, columns }, update, into).expect("records");
    rec.submit().expect("runs");
    out.map(|buffer| buffer.read().expect("read")).concat()
}

fn sh_on_gpu(gpu: &Device, sh: &[f32], heads: &[f32], columns: usize) -> Result<Vec<f32>, KernelError> {
    let (sh_gpu, heads) = (gpu.buffer_from("sh", sh)?, gpu.buffer_from("heads", heads)?);
    let mut deformed = gpu.buffer("deformed", sh.len())?;
    let mut rec = gpu.recorder()?;
    apply_sh(&mut rec, &sh_gpu, Heads { data: &heads, columns }, &mut deformed)?;
    rec.submit()?;
    deformed.read()
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    let cases =
        [(0, ALL_COLUMNS), (1, GEOMETRY_COLUMNS), (100, GEOMETRY_COLUMNS + 4), (65, ALL_COLUMNS), (9, ALL_COLUMNS + 4)];
    for (n, columns) in cases {
        let mut random = Random(n as u64);
        let splats = [0, 1, 2].map(|_| random.vec_f32(4 * n, -1.0, 1.0));
        let heads = random.vec_f32(columns * n, -1.0, 1.0);
        let sh = random.vec_f32(48 * n, -1.0, 1.0);
        for (update, twin_update) in UPDATES {
            let want = twin::apply(&splats, &heads, columns, twin_update).concat();
            // Sums are exact; a normalised product has about ten roundings, and 16 for tiny norms.
            assert_close(&on_gpu(&gpu, &splats, &heads, columns, update), &want, 2e-6, 0.0);
        }
        let deformed = sh_on_gpu(&gpu, &sh, &heads, columns);
        if columns < ALL_COLUMNS {
            assert!(matches!(deformed, Err(KernelError::Shape { buffer: "heads", .. })), "{deformed:?}");
            continue;
        }
        assert_close(&deformed.expect("runs"), &twin::apply_sh(&sh, &heads, columns), 0.0, 0.0);
    }
}

#[test]
fn poison_stays_in_its_splat() {
    let Some(gpu) = device() else { return };
    let (n, columns) = (2, GEOMETRY_COLUMNS);
    let clean = Random(5).vec_f32(12 * n + columns * n, 0.2, 1.0);
    let parts = |data: &[f32]| ([0, 1, 2].map(|k| data[4 * k * n..4 * (k + 1) * n].to_vec()), data[12 * n..].to_vec());
    for (update, twin_update) in UPDATES {
        let on_gpu = |data: &[f32]| {
            let (splats, heads) = parts(data);
            on_gpu(&gpu, &splats, &heads, columns, update)
        };
        let on_host = |data: &[f32]| {
            let (splats, heads) = parts(data);
            twin::apply(&splats, &heads, columns, twin_update).concat()
        };
        // A mean, a scale and a quaternion; then the head of a mean and that of a rotation.
        let places = [1, 4 * n + 2, 8 * n + 3, 12 * n + 1, 12 * n + 9];
        // As above.
        let reach = poison::spread(&clean, &places, (2e-6, 0.0), on_gpu, on_host);
        // A product of quaternions mixes all four components.
        let (quat, turn) = match update {
            RotationUpdate::Keep => (1, 0),
            RotationUpdate::Add => (1, 1),
            RotationUpdate::Multiply => (4, 4),
        };
        assert_eq!(reach, [1, 1, quat, 1, turn], "{update:?}");
    }
    let clean = Random(6).vec_f32((48 + ALL_COLUMNS) * n, -1.0, 1.0);
    let on_gpu = |data: &[f32]| sh_on_gpu(&gpu, &data[..48 * n], &data[48 * n..], ALL_COLUMNS).expect("runs");
    let on_host = |data: &[f32]| twin::apply_sh(&data[..48 * n], &data[48 * n..], ALL_COLUMNS);
    // A coefficient, its head, and the head of a mean. One sum each.
    let reach = poison::spread(&clean, &[50, 48 * n + 20, 48 * n], (0.0, 0.0), on_gpu, on_host);
    assert_eq!(reach, [1, 1, 0], "one coefficient");
}
