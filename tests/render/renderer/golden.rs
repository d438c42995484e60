//! The f64 reference renders of a random and of a trained scene, their gradients and their weights.

use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::render::deform::DeformField;
use guard4d_engine::render::{Frame, FramePlan, Offsets, Prune, Renderer};
use guard4d_engine::scene::{Motion, PlyFile};
use guard4d_kernels::shape::OffsetBases;
use guard4d_lab::dump::View;

use super::super::{Y_0, image, psnr};
use crate::support::close::{assert_close, cosine, worst_ratio};
use crate::support::gpu::{Gpu, device};
use crate::support::raster::{RasterCase, cases};

struct Golden {
    expected: TensorFile,
    renderer: Renderer,
    plan: FramePlan,
    background: [f32; 3],
    splats: usize,
}

impl Golden {
    fn open(gpu: &Gpu, case: &RasterCase, prune: Prune) -> Self {
        let expected = TensorFile::read(&case.expected).expect("the golden file opens");
        let gaussians = PlyFile::open(&case.ply).and_then(|ply| ply.decode()).expect("the splats decode");
        let view = View::open(&case.camera, None).expect("the camera opens");
        let mut field = DeformField::new(gpu, &gaussians, &Motion::Still).expect("uploads");
        let mut renderer = Renderer::new(gpu).expect("renderer");
        let state = field.at(0.0).expect("a static scene");
        let plan = renderer.plan(&state, &view.camera, prune).expect("plans");
        let background = view.background.expect("the camera's file names one");
        Self { expected, renderer, plan, background, splats: gaussians.len() }
    }

    fn size(&self) -> [usize; 2] {
        [self.plan.height() as usize, self.plan.width() as usize]
    }

    /// rgb `[H,W,3]` of the file with a fourth channel.
    fn four(&self, name: &str, fourth: &[f32]) -> Vec<f32> {
        let [height, width] = self.size();
        let rgb = self.expected.floats(name, &[height, width, 3]).expect("an image");
        rgb.chunks(3).zip(fourth).flat_map(|(c, t)| [c[0], c[1], c[2], *t]).collect()
    }

    /// Gradient to `offsets` from a gradient of the frame.
    fn backward(&mut self, gpu: &Gpu, offsets: &[f32], bases: OffsetBases, v_frame: &[f32]) -> Vec<f32> {
        let data = gpu.buffer_from("offsets", offsets).expect("buffer");
        let v_frame = gpu.buffer_from("v_frame", v_frame).expect("buffer");
        let mut v_offsets = gpu.buffer("v_offsets", data.len()).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        let (input, frame) = (Offsets { data: &data, bases }, Frame { clip: &v_frame, index: 0 });
        self.renderer.backward(&mut rec, &self.plan, input, frame, &mut v_offsets).expect("records");
        rec.submit().expect("runs");
        v_offsets.read().expect("read")
    }
}

#[test]
fn image_and_transmittance_match_the_reference() {
    let Some(gpu) = device() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    for case in cases(folder.path()) {
        for prune in [Prune::Keep, Prune::Remove] {
            let mut golden = Golden::open(&gpu, &case, prune);
            let transmittance = golden.expected.floats("final_T", &golden.size()).expect("final T").to_vec();
            let want = golden.four("image", &transmittance);
            let got = image(&gpu, &mut golden.renderer, &golden.plan, None, golden.background).expect("renders");
            let quality = psnr(&got, &want);
            assert!(quality > 55.0, "PSNR {quality} dB");
            let pixels = got.chunks(4).zip(want.chunks(4));
            let off = pixels.filter(|(g, w)| worst_ratio(g, w, case.tolerance, 0.0) > 1.0).count();
            let (all, tolerance) = (golden.plan.frame_len() / 4, case.tolerance);
            assert!(
                off * 1000 <= all * case.strays_per_mille,
                "{off} of {all} pixels are off by more than {tolerance}"
            );
        }
    }
}

#[test]
fn offset_gradients_match_the_reference() {
    let Some(gpu) = device() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    for case in cases(folder.path()) {
        let mut golden = Golden::open(&gpu, &case, Prune::Remove);
        let n = golden.splats;
        // What the fourth channel holds must not count.
        let v_image = golden.four("dL_dimage", &vec![f32::NAN; golden.plan.frame_len() / 4]);
        let want = golden.expected.floats("dL_dsh", &[n, 16, 3]).expect("the gradient").to_vec();
        for bases in [OffsetBases::Dc, OffsetBases::All] {
            let got = golden.backward(&gpu, &vec![0.0; n * bases.floats()], bases, &v_image);
            let kept = |all: &[f32], row: usize| -> Vec<f32> {
                all.chunks(row).flat_map(|row| row[..3 * bases.count()].to_vec()).collect()
            };
            let (got_kept, want_kept) = (kept(&got, bases.floats()), kept(&want, 48));
            let angle = cosine(&got_kept, &want_kept);
            // A few flipped decisions turn the gradient by about 1e-5.
            assert!(angle > 0.9999, "cosine {angle}");
            if case.strays_per_mille == 0 {
                // Without flips rounding alone: 4e-6 on lavapipe, in sums of up to 400 pixels.
                assert_close(&got_kept, &want_kept, 2e-5, 2e-5);
            }
            assert!(bases == OffsetBases::All || got.chunks(4).all(|row| row[3] == 0.0), "the fourth float stays zero");
        }
    }
}

#[test]
fn weights_match_the_reference() {
    let Some(gpu) = device() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    for case in cases(folder.path()) {
        let mut golden = Golden::open(&gpu, &case, Prune::Remove);
        let n = golden.splats;
        // A gradient of one everywhere gives each splat's sum of weights, times Y_0 in the DC term. The offset keeps
        // every colour off its cut at zero.
        let ones = vec![1.0; golden.plan.frame_len()];
        let rows = golden.backward(&gpu, &vec![9.0; 4 * n], OffsetBases::Dc, &ones);
        let got: Vec<f32> = rows.chunks(4).map(|row| row[0] / Y_0).collect();
        let want = golden.expected.floats("weight_sum", &[n]).expect("weights");
        assert!(cosine(&got, want) > 0.9999, "weights point the same way");
        // One flipped pixel of alpha 1/255 here or there; without flips rounding alone, as above.
        let (atol, rtol) = if case.strays_per_mille == 0 { (2e-5, 2e-5) } else { (0.05, 1e-2) };
        assert_close(&got, want, atol, rtol);
    }
}
