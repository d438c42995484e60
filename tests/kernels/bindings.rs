//! Buffers that are larger than a binding may be.

use guard4d_kernels::loss::Term;
use guard4d_kernels::loss::offset_penalty::{self, Blocks};
use guard4d_kernels::loss::sum::{self, SumScratch};
use guard4d_kernels::nn::axpy;
use guard4d_kernels::optim::adam::{self, AdamConfig, AdamState, Tail};
use guard4d_kernels::shape::{Accumulate, OffsetBases};
use guard4d_kernels::splat::sh::{self, ShInputs, VisibleSplats};
use guard4d_kernels::{Buffer, Device, DeviceOptions};

use crate::support::gpu::{each_family, each_family_with};
use crate::support::random::Random;

/// Coefficients of so many splats are 576 KB.
const SPLATS: usize = 3001;
const VISIBLE: usize = 2003;
const LIMIT: u32 = 256 << 10;

fn bits(buffer: &Buffer<f32>) -> Vec<u32> {
    buffer.read().expect("reads").into_iter().map(f32::to_bits).collect()
}

/// Colours, gradient of the offsets with their penalty, and the offsets after two steps.
fn run(gpu: &Device, bases: OffsetBases) -> [Vec<u32>; 6] {
    let mut random = Random(9);
    let mut input = |len: usize| gpu.buffer_from("input", &random.vec_f32(len, -0.5, 0.5)).expect("buffer");
    let len = SPLATS * bases.floats();
    let (coeffs, mut offsets, dirs, v_colours) =
        (input(48 * SPLATS), input(len), input(4 * VISIBLE), input(4 * VISIBLE));
    // Not in order, so that each piece has splats from everywhere.
    let splats: Vec<u32> = (0..VISIBLE).map(|i| (i * 1009 % SPLATS) as u32).collect();
    let splats = gpu.buffer_from("splats", &splats).expect("buffer");
    let seen = VisibleSplats { dirs: &dirs, splat_from_visible: &splats, count: VISIBLE };
    let buffer = |name: &str, len: usize| gpu.buffer::<f32>(name, len).expect("buffer");
    let (mut base, mut colours) = (buffer("base", 4 * VISIBLE), buffer("colours", 4 * VISIBLE));
    let (mut v_offsets, mut values) = (buffer("v_offsets", len), buffer("values", sum::VALUES));
    let mut sums = SumScratch::new(gpu, len.div_ceil(4)).expect("scratch");
    let mut state = AdamState::new(gpu, "offsets", len).expect("state");
    let tail = Some(Tail { row: bases.floats(), head: 3, lr: 1e-3 });
    let config = AdamConfig { lr: 1e-2, keep: 0.9, tail, ..AdamConfig::default() };
    for _ in 0..2 {
        let mut rec = gpu.recorder().expect("recorder");
        let unmarked = ShInputs { sh_coeffs: &coeffs, offsets: None, degree: 3, max_colour: f32::INFINITY };
        let marked = ShInputs { offsets: Some((&offsets, bases)), ..unmarked };
        sh::before_clamp(&mut rec, &unmarked, &seen, &mut base).expect("records");
        sh::forward(&mut rec, &marked, &seen, &mut colours).expect("records");
        rec.fill(&mut v_offsets, 0.0);
        sh::backward(&mut rec, &marked, &seen, &v_colours, &mut v_offsets).expect("records");
        let blocks = Blocks { bases, degree: 3, dc: 1.0, rest: 0.5 };
        let term = Term { values: &mut values, slot: 1, weight: 10.0, accumulate: Accumulate::Add };
        offset_penalty::step(&mut rec, &offsets, blocks, &mut v_offsets, term, &mut sums).expect("records");
        adam::step(&mut rec, &mut offsets, &v_offsets, &mut state, &config).expect("records");
        rec.submit().expect("runs");
    }
    [&base, &colours, &v_offsets, &values, &offsets, &state.exp_avg_sq].map(bits)
}

#[test]
fn splats_in_pieces_give_the_bits_of_one_piece() {
    let small = DeviceOptions { max_storage_bytes: Some(LIMIT), ..DeviceOptions::default() };
    let (Some(large), Some(small)) = (each_family(), each_family_with(small)) else { return };
    for (large, small) in large.iter().zip(&small) {
        assert_eq!(small.info().max_storage_bytes, LIMIT);
        for bases in [OffsetBases::Dc, OffsetBases::All] {
            let (want, got) = (run(large, bases), run(small, bases));
            assert!(want.iter().all(|part| part.iter().any(|v| *v != 0)), "{bases:?}: something of everything");
            for (i, (want, got)) in want.iter().zip(&got).enumerate() {
                assert!(want == got, "{:?}, {bases:?}: output {i}", large.family());
            }
        }
    }
}

#[test]
fn kernels_that_take_a_buffer_whole_refuse_one_that_is_too_large() {
    let small = DeviceOptions { max_storage_bytes: Some(LIMIT), ..DeviceOptions::default() };
    for gpu in each_family_with(small).into_iter().flatten() {
        for (floats, fits) in [(LIMIT as usize / 4, true), (LIMIT as usize / 4 + 4, false)] {
            let [a, b] = ["a", "b"].map(|name| gpu.buffer::<f32>(name, floats).expect("buffer"));
            let mut out = gpu.buffer("out", floats).expect("buffer");
            let mut rec = gpu.recorder().expect("recorder");
            let recorded = axpy::forward(&mut rec, 2.0, &a, &b, &mut out);
            assert_eq!(recorded.is_ok(), fits, "{floats} floats: {recorded:?}");
        }
    }
}
