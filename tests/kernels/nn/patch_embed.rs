//! nn/patch_embed

use guard4d_kernels::nn::patch_embed::{PatchShape, fold, unfold};
use guard4d_kernels::reference::nn::patch_embed as twin;
use guard4d_kernels::{Device, KernelError};

use super::{dot, run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
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

/// Rows and v_pixels.
fn on_gpu(gpu: &Device, shape: PatchShape, pixels: &[f32], v_rows: &[f32]) -> [Vec<f32>; 2] {
    let (mut rows, mut v_pixels) = (unwritten(gpu, v_rows.len()), unwritten(gpu, pixels.len()));
    let (pixels, v_rows) = (upload(gpu, pixels), upload(gpu, v_rows));
    run(gpu, |rec| {
        unfold(rec, shape, &pixels, &mut rows)?;
        fold(rec, shape, &v_rows, &mut v_pixels)
    });
    [rows.read().expect("read"), v_pixels.read().expect("read")]
}

#[test]
fn gpu_equals_the_twin() {
    let Some(gpu) = device() else { return };
    for shape in SHAPES.into_iter().chain([PatchShape { batch: 0, side_px: 2, patch_px: 1 }]) {
        let mut random = Random(shape.side_px as u64);
        let (pixels, v_rows) =
            (random.vec_f32(shape.pixels_len(), -1.0, 1.0), random.vec_f32(shape.rows_len(), -1.0, 1.0));
        let [rows, v_pixels] = on_gpu(&gpu, shape, &pixels, &v_rows);
        assert_eq!(rows, twin::unfold(shape, &pixels), "{shape:?}: copies");
        assert_eq!(v_pixels, twin::fold(shape, &v_rows), "{shape:?}: copies");
    }
}

#[test]
fn poison_moves_with_its_colour_and_is_no_colour_elsewhere() {
    let Some(gpu) = device() else { return };
    let shape = PatchShape { batch: 1, side_px: 7, patch_px: 3 };
    let split = shape.pixels_len();
    let clean = Random(14).vec_f32(split + shape.rows_len(), -1.0, 1.0);
    let on_gpu = |data: &[f32]| on_gpu(&gpu, shape, &data[..split], &data[split..]).concat();
    let on_host = |data: &[f32]| [twin::unfold(shape, &data[..split]), twin::fold(shape, &data[split..])].concat();
    // A colour, a fourth channel, a pixel outside the whole patches; then of rows a colour, a fourth channel, the class
    // token.
    let row = split + shape.row_len();
    let places = [4, 7, split - 4, row + 1, row + 3, split];
    // Copies: nothing is rounded.
    let reach = poison::spread(&clean, &places, (0.0, 0.0), on_gpu, on_host);
    assert_eq!(reach, [1, 0, 0, 1, 0, 0], "only colours of patches move");
}

#[test]
fn wrong_lengths_are_refused() {
    let Some(gpu) = device() else { return };
    let shape = PatchShape { batch: 1, side_px: 2, patch_px: 1 };
    let (pixels, mut rows) = (upload(&gpu, &[0.0; 12]), unwritten(&gpu, 20));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = unfold(&mut rec, shape, &pixels, &mut rows);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "pixels", .. })), "{wrong:?}");
    let wrong = unfold(&mut rec, PatchShape { patch_px: 3, ..shape }, &pixels, &mut rows);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "patch_px", .. })), "{wrong:?}");
}
