//! Frames are looked at again once their shot is known.

use guard4d_engine::locate::align::{Detail, Fit, Plan, Way, align};
use guard4d_engine::locate::mend::over_all_moments;
use guard4d_engine::locate::picture::Picture;
use guard4d_engine::locate::pose::Pose;
use guard4d_engine::locate::stage::{About, Canvas, Stage};
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{FrameSize, Model};

use crate::support::close::largest;
use crate::support::gpu::device;

const SIZE_PX: [u32; 2] = [240, 180];
const FRAMES: usize = 4;
/// To where a frame fits at the moment at which it is looked for.
const AT_THAT_MOMENT: Plan =
    Plan { detail: Detail::Width(SIZE_PX[0]), steps: 10, lens: false, time: false, way: Way::AsFilm };

/// Frames from one camera while time goes on, and where they were taken.
fn shot(stage: &mut Stage) -> Vec<(Picture, Pose)> {
    let size = FrameSize::new(SIZE_PX[0], SIZE_PX[1]).expect("a size");
    let orbit = Orbit { views: 5, elevation_deg: 40.0, look_at: stage.look_at(), lens: Lens { fov_x_rad: 0.7, size } };
    let camera = orbit.cameras().expect("an orbit").views[3].camera;
    let middle = stage.middle();
    let frame = |number: usize| {
        let pose = Pose::of_camera(&camera, 0.3 + 0.03 * number as f32, middle).expect("the middle is in front");
        let pixels = stage.draw_pixels(&pose, Canvas::as_film(size, size)).expect("draws");
        (Picture { gray: pixels.drawn().picture, thumbnail: pixels.thumbnail() }, pose)
    };
    (0..FRAMES).map(frame).collect()
}

#[test]
fn a_shot_that_was_followed_along_a_wrong_way_is_brought_back() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let mut stage = Stage::new(&gpu, &model, About::Middle).expect("it fits");
    let (frames, truth): (Vec<Picture>, Vec<Pose>) = shot(&mut stage).into_iter().unzip();
    // All but the first are taken to be a quarter of the motion later, each where it fits there.
    let late = |number: usize| if number > 0 { 0.25 } else { 0.0 };
    let mut fits: Vec<Fit> = (0..FRAMES)
        .map(|at| {
            let begun = Pose { time: truth[at].time + late(at), ..truth[at] };
            align(&mut stage, &frames[at].gray, &begun, AT_THAT_MOMENT).expect("aligns")
        })
        .collect();
    let apart = |fits: &[Fit]| -> Vec<f64> {
        fits.iter().zip(&truth).map(|(fit, truth)| fit.pose.apart_px(truth, f64::from(SIZE_PX[0]))).collect()
    };
    let before = apart(&fits);
    assert!(before[1..].iter().all(|apart| *apart > 5.0), "they are elsewhere to begin with: {before:?}");
    let mut looks = 0;
    let mut tell = || {
        looks += 1;
        Ok(())
    };
    over_all_moments(&mut stage, &frames, &mut fits, truth[0].lens, &mut tell).expect("it looks");
    // What is asked of cameras; moments count as the turns that move as much.
    let after = apart(&fits);
    assert!(largest(after.iter().copied()) < 0.5, "px: {after:?}, before: {before:?}");
    assert!((1..=FRAMES).contains(&looks), "{looks} frames were looked at");
    // What is where it is stays so, and is looked at once.
    looks = 0;
    let known = fits.clone();
    let mut tell = || {
        looks += 1;
        Ok(())
    };
    over_all_moments(&mut stage, &frames, &mut fits, truth[0].lens, &mut tell).expect("it looks");
    assert!(largest(apart(&fits)) < 0.5 && looks == 1, "{looks} looks: {fits:?} from {known:?}");
}
