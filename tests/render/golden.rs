//! The f64 reference render of real trained splats, its gradient and its weights.

use guard4d_engine::deform::DeformField;
use guard4d_engine::render::{Frame, FramePlan, Offsets, Prune, Renderer};
use guard4d_engine::scene::{CameraSet, ImageSize, PlyFile};
use guard4d_engine::tensor_file::TensorFile;
use guard4d_kernels::shape::OffsetBases;

use super::{image, psnr};
use crate::support::close::{assert_close, cosine, worst_ratio};
use crate::support::gpu::{Gpu, device};
use crate::support::shared;

const WIDTH: usize = 176;
const HEIGHT: usize = 132;
const SPLATS: usize = 4721;
const WHITE: [f32; 3] = [1.0; 3];

struct Golden {
    expected: TensorFile,
    renderer: Renderer,
    plan: FramePlan,
}

impl Golden {
    fn open(gpu: &Gpu, prune: Prune) -> Option<Self> {
        let path = shared("data/golden/raster_fruit/expected.safetensors")?;
        let expected = TensorFile::read(&path).expect("the golden file opens");
        let ply = PlyFile::open(&shared("data/static/fruit_drops_minimal.ply")?).expect("the splats open");
        let gaussians = ply.decode().expect("the splats decode");
        let size = ImageSize::new(WIDTH as u32, HEIGHT as u32).expect("an image size");
        let camera_file = shared("data/golden/raster_fruit/camera.json")?;
        let cameras = CameraSet::open(&camera_file, size).expect("the camera opens").at_times(&[0.0]);
        let (_, camera, _) = cameras.entries().next().expect("one camera");
        let mut field = DeformField::new(gpu, &gaussians, None).expect("uploads");
        let mut renderer = Renderer::new(gpu).expect("renderer");
        let state = field.at(0.0).expect("a static scene");
        let plan = renderer.plan(&state, camera, prune).expect("plans");
        Some(Self { expected, renderer, plan })
    }

    /// rgb `[H,W,3]` of the file with a fourth channel.
    fn four(&self, name: &str, fourth: &[f32]) -> Vec<f32> {
        let rgb = self.expected.floats(name, &[HEIGHT, WIDTH, 3]).expect("an image");
        rgb.chunks(3).zip(fourth).flat_map(|(c, t)| [c[0], c[1], c[2], *t]).collect()
    }
}

#[test]
fn image_and_transmittance_match_the_reference() {
    let Some(gpu) = device() else { return };
    for prune in [Prune::Keep, Prune::Remove] {
        let Some(mut golden) = Golden::open(&gpu, prune) else { return };
        let transmittance = golden.expected.floats("final_T", &[HEIGHT, WIDTH]).expect("final T").to_vec();
        let want = golden.four("image", &transmittance);
        let got = image(&gpu, &mut golden.renderer, &golden.plan, None, WHITE).expect("renders");
        // Alpha and stop decisions flip between f32 and f64 in a few pixels (formats, tolerances for goldens).
        let quality = psnr(&got, &want);
        assert!(quality > 55.0, "PSNR {quality} dB");
        let pixels = got.chunks(4).zip(want.chunks(4));
        let off = pixels.filter(|(g, w)| worst_ratio(g, w, 1e-4, 0.0) > 1.0).count();
        assert!(off * 1000 <= WIDTH * HEIGHT, "{off} pixels are off by more than 1e-4");
    }
}

#[test]
fn offset_gradient_and_weights_match_the_reference() {
    let Some(gpu) = device() else { return };
    let Some(mut golden) = Golden::open(&gpu, Prune::Remove) else { return };
    // What the fourth channel holds must not count.
    let v_image = golden.four("dL_dimage", &vec![f32::NAN; WIDTH * HEIGHT]);
    let v_image = gpu.buffer_from("v_image", &v_image).expect("buffer");
    let ones = gpu.buffer_from("ones", &vec![1.0f32; 4 * WIDTH * HEIGHT]).expect("buffer");
    let want = golden.expected.floats("dL_dsh", &[SPLATS, 16, 3]).expect("the gradient").to_vec();
    for bases in [OffsetBases::Dc, OffsetBases::All] {
        let offsets = gpu.buffer("offsets", SPLATS * bases.floats()).expect("buffer");
        let mut v_offsets = gpu.buffer("v_offsets", offsets.len()).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        let frame = Frame { clip: &v_image, index: 0 };
        let input = Offsets { data: &offsets, bases };
        golden.renderer.backward(&mut rec, &golden.plan, input, frame, &mut v_offsets).expect("records");
        rec.submit().expect("runs");
        let got = v_offsets.read().expect("read");
        let kept = |all: &[f32], row: usize| -> Vec<f32> {
            all.chunks(row).flat_map(|row| row[..3 * bases.count()].to_vec()).collect()
        };
        let angle = cosine(&kept(&got, bases.floats()), &kept(&want, 48));
        // A few flipped decisions turn the gradient by about 1e-5.
        assert!(angle > 0.9999, "cosine {angle}");
        assert!(bases == OffsetBases::All || got.chunks(4).all(|row| row[3] == 0.0), "the fourth float stays zero");
    }
    // A gradient of one everywhere gives each splat's sum of weights, times Y_0 in the DC term.
    let mut v_offsets = gpu.buffer("v_offsets", 4 * SPLATS).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    let bright = gpu.buffer_from("offsets", &[9.0f32; 4 * SPLATS]).expect("buffer");
    let input = Offsets { data: &bright, bases: OffsetBases::Dc };
    golden
        .renderer
        .backward(&mut rec, &golden.plan, input, Frame { clip: &ones, index: 0 }, &mut v_offsets)
        .expect("records");
    rec.submit().expect("runs");
    let rows = v_offsets.read().expect("read");
    let got: Vec<f32> = rows.chunks(4).map(|row| row[0] / 0.282_094_8).collect();
    let want = golden.expected.floats("weight_sum", &[SPLATS]).expect("weights");
    assert!(cosine(&got, want) > 0.9999, "weights point the same way");
    // One flipped pixel of alpha 1/255 here or there.
    assert_close(&got, want, 0.05, 1e-2);
}
