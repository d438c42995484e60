//! nn/patch_embed

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::patch_embed::{PatchShape, fold, unfold};
use guard4d_kernels::reference::nn::patch_embed as twin;

use super::{dot, run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

const SHAPES: [PatchShape; 4] = [
    PatchShape { batch: 1, side_px: 1, patch_px: 1 },
    PatchShape { batch: 2, side_px: 8, patch_px: 4 },
    PatchShape { batch: 3, side_px: 7, patch_px: 3 },
    PatchShape { batch: 1, side_px: 64, patch_px: 8 },
];

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(13);
    for shape in &SHAPES[..3] {
        let (pixels, v_rows) = (random.vec(shape.pixels_len(), -1.0, 1.0), random.vec(shape.rows_len(), -1.0, 1.0));
        let error = gradcheck(|x| dot(&twin::unfold(*shape, x), &v_rows), &pixels, &twin::fold(*shape, &v_rows));
        assert!(error < 1e-6, "{shape:?}: {error}");
    }
}

#[test]
fn gpu_equals_the_twin() {
    let Some(gpu) = device() else { return };
    for shape in SHAPES {
        let mut random = Random(shape.side_px as u64);
        let (pixels, v_rows) =
            (random.vec_f32(shape.pixels_len(), -1.0, 1.0), random.vec_f32(shape.rows_len(), -1.0, 1.0));
        let (pixels_buffer, v_rows_buffer) = (upload(&gpu, &pixels), upload(&gpu, &v_rows));
        let (mut rows, mut v_pixels) = (unwritten(&gpu, v_rows.len()), unwritten(&gpu, pixels.len()));
        run(&gpu, |rec| {
            unfold(rec, shape, &pixels_buffer, &mut rows)?;
            fold(rec, shape, &v_rows_buffer, &mut v_pixels)
        });
        assert_eq!(rows.read().expect("read"), twin::unfold(shape, &pixels), "{shape:?}: copies");
        assert_eq!(v_pixels.read().expect("read"), twin::fold(shape, &v_rows), "{shape:?}: copies");
    }
}

#[test]
fn poison_in_the_fourth_channel_is_not_colour() {
    let Some(gpu) = device() else { return };
    let shape = PatchShape { batch: 1, side_px: 2, patch_px: 1 };
    let pixels: Vec<f32> = (0..4).flat_map(|_| [1.0, 2.0, f32::INFINITY, f32::NAN]).collect();
    let (pixels, mut rows) = (upload(&gpu, &pixels), unwritten(&gpu, shape.rows_len()));
    run(&gpu, |rec| unfold(rec, shape, &pixels, &mut rows));
    let rows = rows.read().expect("read");
    assert_eq!(rows[..4], [0.0; 4], "class token row");
    assert!(rows[4..].chunks_exact(4).all(|t| t == [1.0, 2.0, f32::INFINITY, 0.0]), "{rows:?}");
}

#[test]
fn wrong_lengths_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let shape = PatchShape { batch: 1, side_px: 2, patch_px: 1 };
    let (pixels, mut rows, mut none) = (upload(&gpu, &[0.0; 12]), unwritten(&gpu, 20), unwritten(&gpu, 0));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = unfold(&mut rec, shape, &pixels, &mut rows);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "pixels", .. })), "{wrong:?}");
    let wrong = unfold(&mut rec, PatchShape { patch_px: 3, ..shape }, &pixels, &mut rows);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "patch_px", .. })), "{wrong:?}");
    let empty = upload(&gpu, &[]);
    run(&gpu, |rec| unfold(rec, PatchShape { batch: 0, ..shape }, &empty, &mut none));
}
