//! loss/offset_penalty: twin against differences, GPU against the twin, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::loss::offset_penalty::{Blocks, step};
use guard4d_kernels::loss::sum::SumScratch;
use guard4d_kernels::reference::loss::offset_penalty as twin;
use guard4d_kernels::shape::{Accumulate, OffsetBases};

use super::{run, term, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const BLOCKS: Blocks = Blocks { bases: OffsetBases::All, degree: 3, dc: 1.5, rest: 0.25 };

#[test]
fn twin_gradient_matches_differences() {
    let offsets = Random(1).vec(96, -1.0, 1.0);
    for (row, num_rest) in [(4, 0), (48, 24), (48, 45)] {
        let grad = twin::step(&offsets, row, num_rest, 1.5, 0.25).1;
        let worst = gradcheck(|x| twin::step(x, row, num_rest, 1.5, 0.25).0, &offsets, &grad);
        assert!(worst < 1e-6, "{row}, {num_rest}: {worst}");
    }
}

fn on_gpu(gpu: &Gpu, blocks: Blocks, data: &[f32], accumulate: Accumulate) -> (f32, Vec<f32>) {
    let offsets = upload(gpu, data);
    let mut v_offsets = upload(gpu, &vec![0.5; data.len()]);
    let mut values = upload(gpu, &[0.0; 2]);
    let mut scratch = SumScratch::new(gpu, data.len() / 4).expect("scratch");
    run(gpu, |rec| step(rec, &offsets, blocks, &mut v_offsets, term(&mut values, 10.0, accumulate), &mut scratch));
    (values.read().expect("read")[1], v_offsets.read().expect("read"))
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for splats in [0, 1, 3, 86, 300] {
        for (bases, degree, num_rest, accumulate) in [
            (OffsetBases::All, 3, 45, Accumulate::Overwrite),
            (OffsetBases::All, 2, 24, Accumulate::Add),
            (OffsetBases::All, 0, 0, Accumulate::Overwrite),
            (OffsetBases::Dc, 3, 0, Accumulate::Overwrite),
            (OffsetBases::Dc, 3, 0, Accumulate::Add),
        ] {
            let row = bases.floats();
            let mut data = Random(splats as u64).vec_f32(splats * row, -1.0, 1.0);
            // What does not exist is zero.
            data.chunks_mut(row).for_each(|row| row[3 + num_rest..].fill(0.0));
            let blocks = Blocks { bases, degree, ..BLOCKS };
            let (want, grad) = twin::step(&data, row, num_rest, BLOCKS.dc, BLOCKS.rest);
            let before = if accumulate == Accumulate::Add { 0.5 } else { 0.0 };
            let (value, v_offsets) = on_gpu(&gpu, blocks, &data, accumulate);
            // A mean of squares below 1, summed in another order.
            assert_close(&[value], &[want], 1e-6, 1e-5);
            let want: Vec<f32> = grad.iter().map(|g| before + 10.0 * g).collect();
            assert_close(&v_offsets, &want, 1e-7, 1e-5);
        }
    }
}

#[test]
fn poison_shows_and_wrong_shapes_are_refused() {
    let Some(gpu) = device() else { return };
    let clean = Random(3).vec_f32(96, -1.0, 1.0);
    let on_gpu = |data: &[f32]| {
        let (value, v_offsets) = on_gpu(&gpu, BLOCKS, data, Accumulate::Overwrite);
        [vec![value], v_offsets].concat()
    };
    let on_host = |data: &[f32]| {
        let (value, grad) = twin::step(data, 48, 45, BLOCKS.dc, BLOCKS.rest);
        [vec![value], grad.iter().map(|g| 10.0 * g).collect()].concat()
    };
    // As above: the value and the own slope, of a DC term and of another.
    assert_eq!(poison::spread(&clean, &[49, 60], (1e-6, 1e-5), on_gpu, on_host), [2, 2], "value and slope");
    let (odd, mut v_odd) = (upload(&gpu, &[0.0; 52]), upload(&gpu, &[0.0; 52]));
    let mut values = upload(&gpu, &[0.0; 2]);
    let mut scratch = SumScratch::new(&gpu, 13).expect("scratch");
    let mut rec = gpu.recorder().expect("recorder");
    let to = term(&mut values, 1.0, Accumulate::Add);
    let refused = step(&mut rec, &odd, BLOCKS, &mut v_odd, to, &mut scratch);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "offsets", .. })), "{refused:?}");
}
