//! Viewers in a browser film the embedded scene at their own settings. `./x interop` fetches them.

use guard4d_engine::media::Frame;
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::render::deform::DeformField;
use guard4d_engine::render::profile::Viewer;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{CameraSet, FrameSize, Gaussians, LookAt, Model, Motion};

use crate::support::gpu::{Gpu, device};
use crate::support::interop::filmed;

const SIDE: u32 = 400;
const FOV_DEG: f64 = 39.6;
/// What a preset is for. Sorts of theirs that we do not repeat leave some 50 dB of this scene.
const LEAST_DB: f64 = 45.0;

/// The embedded scene as it stands at a moment, and two cameras that see all of it.
fn scene(gpu: &Gpu) -> (Gaussians, CameraSet) {
    let demo = DemoScene::unpack().expect("it unpacks");
    let model = Model::open(demo.path()).expect("it opens");
    let mut field = DeformField::new(gpu, &model.gaussians, &model.motion).expect("it fits");
    let splats = field.at(0.5).expect("a moment").read().expect("read");
    let fov_x_rad = FOV_DEG.to_radians();
    let lens = Lens { fov_x_rad, size: FrameSize::new(SIDE, SIDE).expect("a size") };
    let look_at = LookAt::around(&splats, fov_x_rad);
    let orbit = Orbit { views: 2, elevation_deg: 20.0, look_at, lens };
    (splats, orbit.cameras().expect("cameras").at_times(&[0.0]))
}

fn drawn(gpu: &Gpu, viewer: Viewer, splats: &Gaussians, cameras: &CameraSet) -> Vec<Frame> {
    let mut frames = Vec::new();
    SceneRenderer::by_profile(gpu, splats, &Motion::Still, [0.0; 3], &viewer.profile())
        .expect("it fits")
        .render_clips(&cameras.clips(), |_, camera, pixels| {
            frames.push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
            Ok(())
        })
        .expect("it is drawn");
    frames
}

/// Of all pixels of a picture, in dB.
fn psnr(a: &Frame, b: &Frame) -> f64 {
    let errors = a.rgb().iter().zip(b.rgb()).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    let mean = errors.sum::<f64>() / a.rgb().len() as f64;
    10.0 * (255.0_f64.powi(2) / mean.max(f64::MIN_POSITIVE)).log10()
}

/// Films by the viewer and holds the preset and the reference beside it.
fn compare(viewer: Viewer, page: &str) {
    let Some(gpu) = device() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let (splats, cameras) = scene(&gpu);
    let Some(theirs) = filmed(page, folder.path(), &splats, &cameras) else { return };
    let ours = drawn(&gpu, viewer, &splats, &cameras);
    let reference = drawn(&gpu, Viewer::Reference, &splats, &cameras);
    for (number, theirs) in theirs.iter().enumerate() {
        let (close, without) = (psnr(&ours[number], theirs), psnr(&reference[number], theirs));
        println!("{} from camera {number}: {close:.1} dB, by the reference {without:.1} dB", viewer.name());
        assert!(close >= LEAST_DB, "{} from camera {number}: {close:.1} dB", viewer.name());
        assert!(without < close, "the preset is nearer: {without:.1} dB without, {close:.1} dB with it");
    }
}

#[test]
fn spark_shows_what_its_preset_does() {
    compare(Viewer::Spark, "spark");
}

#[test]
fn gaussian_splats_3d_shows_what_its_preset_does() {
    compare(Viewer::GaussianSplats3d, "gaussiansplats3d");
}

#[test]
fn playcanvas_shows_what_its_preset_does() {
    compare(Viewer::PlayCanvas, "playcanvas");
}
