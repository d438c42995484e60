//! nn/embedding

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::embedding::{Tables, gather};
use guard4d_kernels::reference::nn::embedding as twin;

use super::{run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn gpu_equals_the_twin_poison_included() {
    let Some(gpu) = device() else { return };
    for (batch, tokens, width, vocab) in [(1, 1, 4, 1), (3, 5, 12, 17), (2, 18, 128, 300)] {
        let mut random = Random(vocab as u64);
        let clean = random.vec_f32((vocab + 20) * width, -1.0, 1.0);
        let ids: Vec<u32> = (0..batch * tokens).map(|_| random.below(vocab) as u32).collect();
        let ids_buffer = gpu.buffer_from("ids", &ids).expect("buffer");
        let on_gpu = |data: &[f32]| {
            let (table, position) = (upload(&gpu, &data[..vocab * width]), upload(&gpu, &data[vocab * width..]));
            let mut y = unwritten(&gpu, ids.len() * width);
            let tables = Tables { table: &table, position: &position, width };
            run(&gpu, |rec| gather(rec, &tables, &ids_buffer, tokens, &mut y));
            y.read().expect("read")
        };
        let on_host = |data: &[f32]| {
            let (table, position) = data.split_at(vocab * width);
            twin::gather(&ids, table, position, tokens, width)
        };
        let used = ids[0] as usize;
        let places = [used * width + 1, vocab * width + 2, (vocab + tokens) * width];
        // One sum each.
        let reach = poison::spread(&clean, &places, (0.0, 0.0), on_gpu, on_host);
        let uses = ids.iter().filter(|&&id| id == ids[0]).count();
        assert_eq!(reach, [uses, batch, 0], "where its token stands, where its position is, an unused position");
    }
}

#[test]
fn too_large_ids_read_the_last_row() {
    let Some(gpu) = device() else { return };
    let (table, position) = (upload(&gpu, &[0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0]), upload(&gpu, &[0.5; 4]));
    let tables = Tables { table: &table, position: &position, width: 4 };
    let ids = gpu.buffer_from("ids", &[1u32, u32::MAX]).expect("buffer");
    let mut y = unwritten(&gpu, 8);
    run(&gpu, |rec| gather(rec, &tables, &ids, 1, &mut y));
    assert_eq!(y.read().expect("read"), [1.5, 2.5, 3.5, 4.5].repeat(2), "ids 1 and too large");
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
