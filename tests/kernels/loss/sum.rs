//! loss/sum: GPU against the twin, odd lengths, slots, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::loss::sum::finish;
use guard4d_kernels::reference::loss::sum as twin;

use super::{run, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::random::Random;

#[test]
fn gpu_follows_the_twin_and_touches_one_slot() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 63, 64, 65, 5000] {
        let data = Random(n as u64).vec_f32(n, -1.0, 1.0);
        let partial = upload(&gpu, &data);
        let mut values = upload(&gpu, &[7.0, 7.0, 7.0]);
        run(&gpu, |rec| finish(rec, (&partial, 0..n), 0.5, (&mut values, 1)));
        let wide: Vec<f64> = data.iter().map(|v| f64::from(*v)).collect();
        // Lane sums of 79 values, then 64 of those: rounding of sums below 50.
        assert_close(&values.read().expect("read"), &[7.0, twin::finish(&wide, 0.5) as f32, 7.0], 2e-5, 0.0);
        run(&gpu, |rec| finish(rec, (&partial, n / 3..n / 2), 0.5, (&mut values, 2)));
        assert_close(&values.read().expect("read")[2..], &[twin::finish(&wide[n / 3..n / 2], 0.5) as f32], 2e-5, 0.0);
    }
}

#[test]
fn poison_shows_and_wrong_slots_are_refused() {
    let Some(gpu) = device() else { return };
    for poison in [f32::NAN, f32::INFINITY] {
        let partial = upload(&gpu, &[1.0, poison, 2.0]);
        let mut values = upload(&gpu, &[0.0]);
        run(&gpu, |rec| finish(rec, (&partial, 0..3), 1.0, (&mut values, 0)));
        assert!(!values.read().expect("read")[0].is_finite(), "{poison} is not hidden");
        let mut rec = gpu.recorder().expect("recorder");
        let refused = finish(&mut rec, (&partial, 0..3), 1.0, (&mut values, 1));
        assert!(matches!(refused, Err(KernelError::Shape { buffer: "values", .. })), "{refused:?}");
        let refused = finish(&mut rec, (&partial, 1..4), 1.0, (&mut values, 0));
        assert!(matches!(refused, Err(KernelError::Shape { buffer: "partial", .. })), "{refused:?}");
    }
}
