//! Frames of films are found whatever else they show.

use guard4d_engine::base::observer::{Progress, Unobserved};
use guard4d_engine::locate::film::Locator;
use guard4d_engine::locate::picture::Picture;
use guard4d_engine::locate::pose::Pose;
use guard4d_engine::locate::so_far::SoFar;
use guard4d_engine::locate::views::Vantage;
use guard4d_engine::media::Frame;
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::render::making::Making;
use guard4d_engine::render::profile::Viewer;
use guard4d_engine::render::settings::Settings;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{Camera, FrameSize, Model, Motion};

use crate::support::gpu::{Gpu, device};

const WIDTH_PX: u32 = 320;

/// What is behind the asset.
fn pattern(x: usize, y: usize) -> f32 {
    0.5 + 0.2 * (x as f32 / 17.0).sin() * (y as f32 / 17.0).cos()
}

/// A chequered logo over the lower right corner.
fn with_logo(frame: &Frame) -> Frame {
    let [width, height] = [frame.width(), frame.height()].map(|side| side as usize);
    let mut rgb = frame.rgb().to_vec();
    for (at, pixel) in rgb.chunks_exact_mut(3).enumerate() {
        let (x, y) = (at % width, at / width);
        if 4 * x > 3 * width && 5 * y > 4 * height {
            pixel.fill(if (x / 8 + y / 8) % 2 == 0 { 255 } else { 0 });
        }
    }
    Frame::new(frame.width(), frame.height(), rgb).expect("as large as before")
}

/// As it is looked at.
fn looked_at(frame: &Frame) -> Picture {
    Picture::of_frame(frame, WIDTH_PX)
}

/// The asset before grey, or before the pattern.
fn frame(gpu: &Gpu, model: &Model, camera: Camera, is_patterned: bool) -> Frame {
    frame_by(Viewer::Reference.into(), gpu, model, camera, is_patterned)
}

/// The same by another renderer.
fn frame_by(settings: Settings, gpu: &Gpu, model: &Model, camera: Camera, is_patterned: bool) -> Frame {
    let profile = settings.profile();
    let mut renderer =
        SceneRenderer::by_profile(gpu, &model.gaussians, &model.motion, [0.0; 3], &profile).expect("a renderer");
    let mut film = None;
    let each = |_: usize, camera: &Camera, pixels: &[f32]| {
        let mut pixels = pixels.to_vec();
        let width = camera.width as usize;
        for (at, pixel) in pixels.chunks_exact_mut(4).enumerate() {
            let behind = pixel[3] * if is_patterned { pattern(at % width, at / width) } else { 0.5 };
            pixel[..3].iter_mut().for_each(|value| *value += behind);
        }
        film = Some(Frame::from_rgba32f(camera.width, camera.height, &pixels)?);
        Ok(())
    };
    renderer.render_clips(&[vec![(camera, 0.0)]], each).expect("films");
    film.expect("one frame")
}

fn still_demo() -> Model {
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let mut model = Model::open(scene.path()).expect("the scene opens");
    model.motion = Motion::Still;
    model
}

/// One of five views around the asset.
fn view(locator: &Locator, number: usize) -> Camera {
    let lens = Lens { fov_x_rad: 0.7, size: FrameSize::new(WIDTH_PX, 240).expect("a size") };
    let orbit = Orbit { views: 5, elevation_deg: 35.0, look_at: locator.stage().look_at(), lens };
    orbit.cameras().expect("an orbit").views[number].camera
}

#[test]
fn a_search_goes_on_where_it_was_broken_off() {
    let Some(gpu) = device() else { return };
    let model = still_demo();
    let mut locator = Locator::new(&gpu, &model, Vantage::Around).expect("it fits");
    let frames = [3, 1].map(|number| looked_at(&frame(&gpu, &model, view(&locator, number), false)));
    let mut kept = Vec::new();
    let whole = locator.locate_from(SoFar::default(), &model, &frames, &mut Unobserved, &mut |so_far| {
        kept.push(so_far.clone());
        Ok(())
    });
    let whole = whole.expect("it looks");
    assert_eq!(whole.shots, [0..1, 1..2], "a cut");
    assert!(whole.frames.iter().all(Option::is_some), "both are found: {whole:?}");
    assert_eq!(kept.len(), 3, "the beginning, and two shots");
    let mut looks = Vec::new();
    for so_far in kept {
        let mut looked = 0;
        let mut observer = |_: Progress<'_>| {
            looked += 1;
            Ok(())
        };
        let again = locator.locate_from(so_far, &model, &frames, &mut observer, &mut |_| Ok(())).expect("it looks");
        assert_eq!(again, whole, "after {looks:?}");
        looks.push(looked);
    }
    assert!(looks[0] > looks[1] && looks[1] > 0 && looks[2] == 0, "less is left each time: {looks:?}");
}

#[test]
fn another_renderer_is_told_and_frames_are_fitted_by_it() {
    let Some(gpu) = device() else { return };
    let model = still_demo();
    let mut locator = Locator::new(&gpu, &model, Vantage::Around).expect("it fits");
    let middle = locator.stage().middle();
    // None that has a preset draws so wide.
    let wide = Settings { dilation: Some(1.0), ..Viewer::Reference.into() };
    for settings in [Viewer::PlayCanvas.into(), Viewer::GaussianSplats3d.into(), wide] {
        let camera = view(&locator, 3);
        let truth = Pose::of_camera(&camera, 0.0, middle).expect("the middle is in front");
        let film = frame_by(settings, &gpu, &model, camera, false);
        let track = locator.locate(&model, &[looked_at(&film)], &mut Unobserved).expect("it looks");
        let told = track.making.settings;
        if settings != wide {
            assert_eq!(track.making, Making { settings, times: 1 }, "of {settings}");
        }
        let [dilation, wanted] = [told, settings].map(|settings| settings.profile().rules.dilation);
        // Widths of 1 px and 0.8: it is told from where the frame fits the reference, whose camera makes up for some.
        assert!((dilation - wanted).abs() < 0.36, "{told} of {settings}");
        let fit = track.frames[0].unwrap_or_else(|| panic!("{settings} is not found: {:?}", track.guess));
        let apart = Pose { lens: truth.lens, ..fit.pose }.apart_px(&truth, f64::from(WIDTH_PX));
        // As the film was drawn, all but what the lens leaves open; by the reference it is ten times as much.
        assert!(apart < if settings == wide { 0.5 } else { 0.1 }, "{settings}: {apart} px");
    }
    // A film that comes after begins as if it were the first.
    let film = [looked_at(&frame(&gpu, &model, view(&locator, 1), false))];
    let after = locator.locate(&model, &film, &mut Unobserved).expect("it looks");
    let alone = Locator::new(&gpu, &model, Vantage::Around)
        .expect("it fits")
        .locate(&model, &film, &mut Unobserved)
        .expect("it looks");
    assert_eq!(after, alone);
}

#[test]
fn a_logo_and_what_is_behind_the_asset_do_not_hide_it() {
    let Some(gpu) = device() else { return };
    let model = still_demo();
    let mut locator = Locator::new(&gpu, &model, Vantage::Around).expect("it fits");
    let middle = locator.stage().middle();
    let camera = view(&locator, 3);
    let truth = Pose::of_camera(&camera, 0.0, middle).expect("the middle is in front");
    let [plain, patterned] = [false, true].map(|is_patterned| frame(&gpu, &model, camera, is_patterned));
    let films = [with_logo(&plain), with_logo(&patterned), patterned];
    for (film, name) in films.iter().zip(["a logo", "a logo before a pattern", "a pattern"]) {
        let track = locator.locate(&model, &[looked_at(film)], &mut Unobserved).expect("it looks");
        let fit = track.frames[0].unwrap_or_else(|| panic!("{name} hides it: {:?}", track.guess));
        // A single frame tells its lens less well than what it shows.
        let apart = Pose { lens: truth.lens, ..fit.pose }.apart_px(&truth, f64::from(WIDTH_PX));
        assert!(apart < 1.5, "{name}: {apart} px: {:?} for {truth:?}", fit.pose);
        assert!(fit.correlation > 0.8, "{name}: {}", fit.correlation);
    }
    let levels = |at: u32| (255.0 * pattern((at % WIDTH_PX) as usize, (at / WIDTH_PX) as usize)) as u8;
    let rgb = (0..WIDTH_PX * 240).flat_map(|at| [levels(at); 3]).collect();
    let nothing = with_logo(&Frame::new(WIDTH_PX, 240, rgb).expect("a frame"));
    let track = locator.locate(&model, &[looked_at(&nothing)], &mut Unobserved).expect("it looks");
    assert!(!track.is_found(), "there is a logo and a pattern, and no asset");
}
