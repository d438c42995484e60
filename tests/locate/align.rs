//! Poses that are off are brought to where a film was taken.

use guard4d_engine::locate::align::{Detail, Plan, Way, align, moments};
use guard4d_engine::locate::gray::Gray;
use guard4d_engine::locate::pose::{PARAMETERS, Pose};
use guard4d_engine::locate::stage::{About, Stage};
use guard4d_engine::media::Frame;
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{FrameSize, Model};

use crate::support::gpu::{Gpu, device};

/// Steps from coarse to fine.
const PLANS: [Plan; 3] = [
    Plan { detail: Detail::Width(48), steps: 10, lens: false, time: true, way: Way::Small },
    Plan { detail: Detail::Width(96), steps: 10, lens: true, time: true, way: Way::Small },
    Plan { detail: Detail::Width(192), steps: 8, lens: true, time: true, way: Way::Small },
];

fn film(gpu: &Gpu, model: &Model, pose: &Pose) -> Gray {
    let camera = pose.camera(FrameSize::new(320, 240).expect("a size"));
    let mut renderer = SceneRenderer::new(gpu, &model.gaussians, &model.motion, model.background).expect("a renderer");
    let mut film = None;
    let shot = (camera, pose.time as f32);
    let each = |_: usize, camera: &guard4d_engine::scene::Camera, pixels: &[f32]| {
        film = Some(Gray::of_frame(&Frame::from_rgba32f(camera.width, camera.height, pixels)?));
        Ok(())
    };
    renderer.render_clips(&[vec![shot]], each).expect("films");
    film.expect("one frame")
}

#[test]
fn a_pose_that_is_off_comes_to_where_the_film_was_taken() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let mut stage = Stage::new(&gpu, &model, About::Middle).expect("it fits");
    let usual = guard4d_engine::scene::camera::paths::Orbit {
        views: 5,
        elevation_deg: 40.0,
        look_at: stage.look_at(),
        lens: guard4d_engine::scene::camera::paths::Lens {
            fov_x_rad: 0.7,
            size: FrameSize::new(320, 240).expect("a size"),
        },
    };
    let camera = usual.cameras().expect("an orbit").views[3].camera;
    let truth = Pose::of_camera(&camera, 0.5, stage.middle()).expect("the middle is in front");
    let frame = film(&gpu, &model, &truth);
    // Five degrees and more, a tenth of the size, and a moment that is a tenth off.
    let mut pose = truth.moved(&[0.08, -0.06, 0.05, 0.02, -0.02, 0.1, 0.0, 0.1]);
    let begun = pose;
    let mut likeness = 0.0;
    for plan in PLANS {
        pose = *moments(&mut stage, &frame, &pose, Detail::Width(64), 0.15)
            .expect("looks")
            .first()
            .expect("the pose's own at least");
        let fit = align(&mut stage, &frame, &pose, plan).expect("aligns");
        (pose, likeness) = (fit.pose, fit.correlation);
    }
    pose = align(&mut stage, &frame, &pose, PLANS[2]).expect("aligns").pose;
    let apart = pose.since(&truth);
    assert!(likeness > 0.8, "{likeness}");
    // Half a pixel of 320 for what is seen, and a hundredth of the motion.
    for (parameter, (step, reach)) in apart.iter().zip(truth.reach()).enumerate().take(6) {
        assert!((step * reach * 320.0).abs() < 0.5, "parameter {parameter}: {apart:?}");
    }
    assert!(apart[PARAMETERS - 1].abs() < 0.01, "{apart:?}");
    assert!(begun.since(&truth)[0].abs() > 10.0 * apart[0].abs(), "it was far off before");

    // A film of another asset is alike where the original is made faint: under half of its contrast it counts less.
    let mut likeness_at = |contrast: f32| {
        let values = frame.values.iter().map(|value| 0.5 + contrast * (value - 0.5)).collect();
        let faint = Gray { values, ..frame };
        align(&mut stage, &faint, &truth, Plan { steps: 0, ..PLANS[2] }).expect("compares").correlation
    };
    let [whole, faint, fainter] = [1.0, 0.7, 0.35].map(&mut likeness_at);
    // Which pixels fit differs a little.
    assert!((faint - whole).abs() < 0.02, "{faint} of {whole}");
    assert!((fainter - 0.7 * whole).abs() < 0.02, "{fainter} of {whole}");
}
