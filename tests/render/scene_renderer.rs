//! Every sample loads and is drawn as it was when its picture was looked at and committed.
//!
//! `GUARD4D_WRITE_PICTURES=1` writes the pictures anew; look at them before they are committed.

use std::path::Path;

use guard4d_engine::media::Frame;
use guard4d_engine::media::ffmpeg::Ffmpeg;
use guard4d_engine::media::folder::read_picture;
use guard4d_engine::media::png::write_png;
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::{FrameSize, LookAt, Model};

use crate::support::gpu::device;
use crate::support::{repo, shared};

const SIDE: u32 = 96;
const FOV_DEG: f64 = 39.6;
/// Time of moving scenes.
const TIME: f32 = 0.5;
/// Drivers round differently, and a splat more or less at a threshold is some pixels; other colours are far below.
const LEAST_PSNR_DB: f64 = 40.0;

/// Samples with pictures; what may not be shown is only drawn.
const SAMPLES: [(&str, bool); 20] = [
    ("static/fruit_drops_minimal.ply", true),
    ("static/three_points_from_train.ply", true),
    ("static/biker.compressed.ply", true),
    ("static/biker.spz", true),
    ("static/guitar.compressed.ply", true),
    ("static/engine_test_sh3.compressed.ply", true),
    ("static/skull.sog", true),
    ("static/khr_conformance_matrix.glb", true),
    ("dynamic/monkey_flipbook", true),
    ("dynamic/wave_flipbook", true),
    ("dynamic/hanabi2.splatv", true),
    ("restricted-nc/spinach_4.splatv", false),
    ("restricted-nc/coffee10.splatv", false),
    ("models/fox", true),
    ("models/robot", true),
    ("models/stress4d", true),
    ("golden/dnerf_like", true),
    ("golden/dynerf_like", true),
    ("golden/deep_applyrot", true),
    ("golden/dnerf_like/point_cloud/iteration_20000/point_cloud.ply", true),
];

fn draw(gpu: &guard4d_kernels::Device, path: &Path) -> Frame {
    let model = Model::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let fov_x_rad = FOV_DEG.to_radians();
    // The made-up scenes of the goldens are no D-NeRF scenes: every sample is looked at from where it fills the frame.
    let look_at = LookAt::around(&model.gaussians, fov_x_rad);
    let lens = Lens { fov_x_rad, size: FrameSize::new(SIDE, SIDE).expect("a size") };
    let orbit = Orbit { views: 1, elevation_deg: 20.0, look_at, lens };
    let clips = orbit.cameras().expect("a camera").at_times(&[TIME]).clips();
    let mut renderer = SceneRenderer::new(gpu, &model.gaussians, &model.motion, [0.5; 3]).expect("the scene fits");
    let mut frames = Vec::new();
    renderer
        .render_clips(&clips, |_, camera, pixels| {
            assert!(pixels.iter().all(|v| v.is_finite()), "{}: a pixel is no number", path.display());
            frames.push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
            Ok(())
        })
        .expect("it is drawn");
    frames.remove(0)
}

#[test]
fn samples_are_drawn_as_their_pictures_show() {
    let Some(gpu) = device() else { return };
    let writes = std::env::var_os("GUARD4D_WRITE_PICTURES").is_some();
    for (name, has_picture) in SAMPLES {
        let Some(path) = shared(&format!("data/{name}")) else { continue };
        let got = draw(&gpu, &path);
        let grey = |pixel: &[u8]| pixel.iter().all(|&v| v.abs_diff(128) <= 1);
        let drawn = got.rgb().chunks_exact(3).filter(|pixel| !grey(pixel)).count();
        // The smallest sample has three splats, each some pixels wide.
        assert!(drawn > 5, "{name}: only {drawn} pixels show anything but the background");
        if !has_picture {
            continue;
        }
        let picture = repo("tests/golden/formats/pictures").join(format!("{}.png", name.replace('/', "_")));
        if writes {
            // The old one may not be there.
            let _ = std::fs::remove_file(&picture);
            write_png(&picture, &got).expect("writable");
            continue;
        }
        let want = read_picture(&picture, [0; 3], &Ffmpeg::default()).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!((want.width(), want.height()), (SIDE, SIDE), "{name}");
        let errors = got.rgb().iter().zip(want.rgb()).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
        let mean = errors.sum::<f64>() / got.rgb().len() as f64;
        let psnr = 10.0 * (255.0_f64.powi(2) / mean.max(f64::MIN_POSITIVE)).log10();
        assert!(psnr > LEAST_PSNR_DB, "{name}: {psnr:.1} dB");
    }
}
