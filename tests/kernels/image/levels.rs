//! image/levels: GPU against the twin, every level there and back, and what 8 bits cannot hold.

use guard4d_kernels::image::levels::{pack, unpack};
use guard4d_kernels::image::quantize;
use guard4d_kernels::reference::image::levels as twin;
use guard4d_kernels::{Buffer, Device};

use super::{run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::random::Random;

/// What packing and unpacking make of pixels.
fn there_and_back(gpu: &Device, data: &[f32]) -> (Vec<u32>, Vec<f32>) {
    let x = upload(gpu, data);
    let mut levels: Buffer<u32> = gpu.buffer("levels", data.len() / 4).expect("a buffer");
    let mut y = unwritten(gpu, data.len());
    run(gpu, |rec| {
        pack(rec, &x, &mut levels)?;
        unpack(rec, &levels, &mut y)
    });
    (levels.read().expect("read"), y.read().expect("read"))
}

#[test]
fn gpu_follows_the_twin_and_every_level_is_kept() {
    let Some(gpu) = device() else { return };
    let mut data: Vec<f32> = (0..256).flat_map(|v| [v as f32 / 255.0, (255 - v) as f32 / 255.0, 0.5, 1.0]).collect();
    data.extend(Random(7).vec_f32(4 * 300, -0.5, 1.5));
    let (levels, y) = there_and_back(&gpu, &data);
    assert_eq!(levels, twin::pack(&data));
    // The quotient by 255 may round in the last place.
    assert_close(&y, &twin::unpack::<f32>(&levels), 1e-7, 0.0);
    for (v, word) in levels.iter().take(256).enumerate() {
        assert_eq!(word.to_le_bytes(), [v as u8, 255 - v as u8, 128, 255]);
    }
}

#[test]
fn colours_are_those_of_rounded_numbers_to_the_bit() {
    let Some(gpu) = device() else { return };
    let data = Random(8).vec_f32(4 * 1000, -0.1, 1.1);
    let (x, mut rounded) = (upload(&gpu, &data), unwritten(&gpu, data.len()));
    run(&gpu, |rec| quantize::forward(rec, &x, &mut rounded));
    let rounded = rounded.read().expect("read");
    let (_, y) = there_and_back(&gpu, &data);
    for (got, want) in y.chunks_exact(4).zip(rounded.chunks_exact(4)) {
        let bits = |pixel: &[f32]| [pixel[0], pixel[1], pixel[2]].map(f32::to_bits);
        assert_eq!(bits(got), bits(want));
    }
}

#[test]
fn what_8_bits_cannot_hold_stays_in_its_channel_and_wrong_lengths_are_refused() {
    let Some(gpu) = device() else { return };
    let data = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.5, 0.25, -f32::NAN, 1e-40, 2.0];
    let (levels, _) = there_and_back(&gpu, &data);
    assert_eq!(levels, twin::pack(&data));
    assert_eq!(levels.iter().map(|word| word.to_le_bytes()).collect::<Vec<_>>(), [[0, 255, 0, 128], [64, 0, 0, 255]]);
    let (nothing, back) = there_and_back(&gpu, &[]);
    assert!(nothing.is_empty() && back.is_empty());
    let (x, mut levels): (_, Buffer<u32>) = (upload(&gpu, &data), gpu.buffer("levels", 3).expect("a buffer"));
    let mut rec = gpu.recorder().expect("a recorder");
    let refused = pack(&mut rec, &x, &mut levels).expect_err("3 words for 2 pixels").to_string();
    assert!(refused.contains("image/levels") && refused.contains('x'), "{refused}");
    let refused = unpack(&mut rec, &levels, &mut unwritten(&gpu, 8)).expect_err("2 pixels for 3 words").to_string();
    assert!(refused.contains("image/levels") && refused.contains('y'), "{refused}");
}
