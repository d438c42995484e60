//! nn/embedding

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::embedding::{Tables, gather};
use guard4d_kernels::reference::nn::embedding as twin;

use super::{run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::random::Random;

#[test]
fn gpu_equals_the_twin() {
    let Some(gpu) = device() else { return };
    for (batch, tokens, width, vocab) in [(1, 1, 4, 1), (3, 5, 12, 17), (2, 18, 128, 300)] {
        let mut random = Random(vocab as u64);
        let (table, position) = (random.vec_f32(vocab * width, -1.0, 1.0), random.vec_f32(20 * width, -1.0, 1.0));
        let ids: Vec<u32> = (0..batch * tokens).map(|_| random.below(vocab) as u32).collect();
        let (table_buffer, position_buffer) = (upload(&gpu, &table), upload(&gpu, &position));
        let tables = Tables { table: &table_buffer, position: &position_buffer, width };
        let ids_buffer = gpu.buffer_from("ids", &ids).expect("buffer");
        let mut y = unwritten(&gpu, ids.len() * width);
        run(&gpu, |rec| gather(rec, &tables, &ids_buffer, tokens, &mut y));
        assert_eq!(y.read().expect("read"), twin::gather(&ids, &table, &position, tokens, width), "one sum each");
    }
}

#[test]
fn poison_shows_where_its_row_is_used_and_too_large_ids_read_the_last_row() {
    let Some(gpu) = device() else { return };
    let (table, position) = (upload(&gpu, &[f32::NAN, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0]), upload(&gpu, &[0.5; 4]));
    let tables = Tables { table: &table, position: &position, width: 4 };
    let ids = gpu.buffer_from("ids", &[0u32, 1, u32::MAX]).expect("buffer");
    let mut y = unwritten(&gpu, 12);
    run(&gpu, |rec| gather(rec, &tables, &ids, 1, &mut y));
    let y = y.read().expect("read");
    assert!(y[0].is_nan() && y[1..4] == [0.5; 3], "{y:?}");
    assert_eq!((&y[4..8], &y[8..]), (&[1.5, 2.5, 3.5, 4.5][..], &[1.5, 2.5, 3.5, 4.5][..]), "ids 1 and too large");
}

#[test]
fn wrong_lengths_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let (table, position) = (upload(&gpu, &[0.0; 8]), upload(&gpu, &[0.0; 8]));
    let tables = Tables { table: &table, position: &position, width: 4 };
    let ids = gpu.buffer_from("ids", &[0u32; 3]).expect("buffer");
    let mut y = unwritten(&gpu, 12);
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = gather(&mut rec, &tables, &ids, 2, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "ids", .. })), "{wrong:?}");
    let wrong = gather(&mut rec, &tables, &ids, 3, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "position", .. })), "{wrong:?}");
    let (empty, mut none) = (gpu.buffer::<u32>("ids", 0).expect("buffer"), unwritten(&gpu, 0));
    run(&gpu, |rec| gather(rec, &tables, &empty, 2, &mut none));
}
