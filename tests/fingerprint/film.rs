//! Copies of the built-in scene are stamped, filmed from where nobody trained anything, and told apart.

use std::f64::consts::PI;
use std::path::Path;

use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::drawing::Look;
use guard4d_engine::fingerprint::estimate::estimate;
use guard4d_engine::fingerprint::film::Exposures;
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::fingerprint::shot::Shot;
use guard4d_engine::fingerprint::trace::{Scored, Scorer};
use guard4d_engine::media::codec::Codec;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::{Frame, ReadOptions, read_clip};
use guard4d_engine::picture::metrics::{Picture, PsnrSummary, SquaredError};
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::render::making::Making;
use guard4d_engine::render::profile::Viewer;
use guard4d_engine::render::settings::Settings;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{Camera, FrameSize, LookAt, Model};

use crate::support::close::largest;
use crate::support::gpu::{Gpu, device};
use crate::support::has_ffmpeg;

/// Copies that are looked at: a family bound of 1e-6 wants 1e-11 of one.
const COPIES: u64 = 100_000;
const LEAKED: u64 = 70_123;
/// The usual amplitudes.
const STRENGTH: f64 = 1.0;

fn prf(seed: u8) -> Prf {
    Prf::new(&MasterSecret::from_bytes([seed; 32]))
}

/// Views and times of their own: a circle at 70 degrees above the horizon, 1.3 times as far away as a usual one.
pub(super) fn shots_from_above(frames: u32) -> Vec<(Camera, f32)> {
    let look_at = LookAt { target: glam::DVec3::new(0.1, 0.0, 0.2), radius: 5.2, up: glam::DVec3::Z };
    let lens = Lens { fov_x_rad: 39.6 * PI / 180.0, size: FrameSize::new(240, 240).expect("a size") };
    let orbit = Orbit { views: frames, elevation_deg: 70.0, look_at, lens };
    let cameras = orbit.cameras().expect("an orbit");
    let times = (0..frames).map(|i| (i as f32 + 0.37) / frames as f32);
    cameras.views.iter().map(|view| view.camera).zip(times).collect()
}

/// 8-bit frames of the model with these coefficients.
pub(super) fn film(gpu: &Gpu, model: &Model, sh_coeffs: Vec<f32>, shots: &[(Camera, f32)]) -> Vec<Frame> {
    film_by(gpu, model, sh_coeffs, shots, &Look::of(model))
}

/// The same as another viewer shows it, on another background.
fn film_by(gpu: &Gpu, model: &Model, sh_coeffs: Vec<f32>, shots: &[(Camera, f32)], look: &Look) -> Vec<Frame> {
    let mut gaussians = model.gaussians.clone();
    gaussians.sh_coeffs = sh_coeffs;
    let profile = look.making.settings.profile();
    let mut renderer =
        SceneRenderer::by_profile(gpu, &gaussians, &model.motion, look.background, &profile).expect("a renderer");
    let mut frames = Vec::new();
    let each = |_: usize, camera: &Camera, pixels: &[f32]| {
        frames.push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
        Ok(())
    };
    renderer.render_clips(&[shots.to_vec()], each).expect("films");
    frames
}

fn through_h264(path: &Path, frames: &[Frame]) -> Vec<Frame> {
    let options = EncodeOptions { codec: Some(Codec::H264), ..EncodeOptions::default() };
    write_video(path, frames, &options).expect("encodes");
    read_clip(path, &ReadOptions::default()).expect("decodes").frames().to_vec()
}

pub(super) fn exposures(gpu: &Gpu, model: &Model, frames: &[Frame], shots: &[(Camera, f32)]) -> Exposures {
    let mut exposures = Exposures::new(gpu, model.gaussians.len()).expect("it fits");
    for (frame, &(camera, time)) in frames.iter().zip(shots) {
        exposures.add(model, &Shot { frame, camera, time }, Look::of(model)).expect("gathers");
    }
    exposures
}

fn best(gpu: &Gpu, issue: &Issue<'_>, mut seen: Exposures) -> Vec<Scored> {
    let found = estimate(issue, &mut seen).expect("of each splat").chips;
    Scorer::new(gpu, issue, &found).and_then(|scorer| scorer.best(0..COPIES)).expect("scores")
}

#[test]
fn a_film_from_above_names_its_copy_and_no_other() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let issue = Issue::new(&model, prf(11), STRENGTH);
    let shots = shots_from_above(8);
    let stamped = issue.stamp(LEAKED);
    let frames = film(&gpu, &model, stamped.clone(), &shots);
    let clean = film(&gpu, &model, model.gaussians.sh_coeffs.clone(), &shots);

    // It is not seen.
    let error = |(a, b): (&Frame, &Frame)| {
        SquaredError::between(&Picture::from_frame(a), &Picture::from_frame(b)).expect("of one size")
    };
    let errors: Vec<SquaredError> = frames.iter().zip(&clean).map(error).collect();
    let psnr = PsnrSummary::of(&errors).expect("there are frames").pooled_db.0;
    assert!(psnr > 46.0, "{psnr} dB");

    let of_film = best(&gpu, &issue, exposures(&gpu, &model, &frames, &shots));
    eprintln!("psnr {psnr:.2}; pictures {:?}", of_film.first());
    assert_eq!(of_film[0].copy, LEAKED);
    assert!(of_film[0].log_p_family < 1e-6f64.ln(), "{:?}", of_film[0]);
    assert!(of_film[1..].iter().all(|other| other.log_p_family > 1e-3f64.ln()), "{of_film:?}");
    // Nobody is named by the original's film, nor by that of another issue's copy.
    let foreign = film(&gpu, &model, Issue::new(&model, prf(12), STRENGTH).stamp(LEAKED), &shots);
    for (what, frames) in [("unmarked", &clean), ("of another issue", &foreign)] {
        let best = best(&gpu, &issue, exposures(&gpu, &model, frames, &shots));
        assert!(best.iter().all(|copy| copy.log_p_family > 1e-3f64.ln()), "{what}: {best:?}");
    }
    if !has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let coded = through_h264(&folder.path().join("film.mp4"), &frames);
    let of_film = best(&gpu, &issue, exposures(&gpu, &model, &coded, &shots));
    assert_eq!(of_film[0].copy, LEAKED);
    assert!(of_film[0].log_p_family < 1e-6f64.ln(), "{:?}", of_film[0]);
}

#[test]
fn a_film_is_compared_as_it_was_drawn() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let issue = Issue::new(&model, prf(14), STRENGTH);
    let shots = shots_from_above(4);
    let score = |frames: &[Frame], told: &mut Option<Look>| {
        let mut exposures = Exposures::new(&gpu, model.gaussians.len()).expect("it fits");
        for (frame, &(camera, time)) in frames.iter().zip(&shots) {
            exposures.add_of_film(&model, &Shot { frame, camera, time }, told).expect("gathers");
        }
        let best = best(&gpu, &issue, exposures);
        assert_eq!(best[0].copy, LEAKED);
        best[0].score
    };
    let own = Look::of(&model);
    let usual = score(&film(&gpu, &model, issue.stamp(LEAKED), &shots), &mut None);
    let by = |settings: Settings| Look { making: Making { settings, times: 1 }, ..own };
    let viewer = by(Viewer::GaussianSplats3d.into());
    let green = Look { background: [0.1, 0.55, 0.2], ..own };
    let thin = by(Settings { dilation: Some(0.04), ..Viewer::Gsplat.into() });
    for look in [own, viewer, green, thin] {
        let frames = film_by(&gpu, &model, issue.stamp(LEAKED), &shots, &look);
        let mut told = None;
        let of_film = score(&frames, &mut told);
        let told = told.expect("the first frame tells");
        assert!(look == thin || told.making == look.making, "{told:?} of {look:?}");
        let [dilation, wanted] = [told, look].map(|look| look.making.settings.profile().rules.dilation);
        // Widths of 0.20 px and 0.28.
        assert!((dilation - wanted).abs() < 0.04, "{told:?} of {look:?}");
        let off = largest(told.background.iter().zip(look.background).map(|(a, b)| (a - b).abs()));
        // Levels of 8 bits, and a line through them.
        assert!(off < 0.02, "{told:?} of {look:?}");
        assert!(of_film > 0.8 * usual, "{of_film:.1} of {usual:.1} by {look:?}");
    }
    // Drawn as the reference on the model's own background, either film says less: of the green one only what shows
    // through is lost.
    for (look, share) in [(viewer, 0.0..0.95), (green, 0.85..0.99), (thin, 0.0..0.95)] {
        let frames = film_by(&gpu, &model, issue.stamp(LEAKED), &shots, &look);
        let (as_own, as_drawn) = (score(&frames, &mut Some(own)), score(&frames, &mut Some(look)));
        assert!(share.contains(&(as_own / as_drawn)), "{as_own:.1} of {as_drawn:.1}: {look:?}");
    }
    // Frames of which it is known, and of another film, which tells it.
    let [known, other] = [own, thin].map(|look| film_by(&gpu, &model, issue.stamp(LEAKED), &shots, &look));
    let (mut exposures, mut told) = (Exposures::new(&gpu, model.gaussians.len()).expect("it fits"), None);
    for ((known, other), &(camera, time)) in known.iter().zip(&other).zip(&shots[..2]) {
        exposures.add(&model, &Shot { frame: known, camera, time }, own).expect("gathers");
        exposures.add_of_film(&model, &Shot { frame: other, camera, time }, &mut told).expect("gathers");
    }
    assert_eq!(best(&gpu, &issue, exposures)[0].copy, LEAKED);
    // Levels that were bent, by as much as screens differ.
    let bent = |frame: &Frame| {
        let bend = |level: &u8| (255.0 * (f32::from(*level) / 255.0).powf(1.25)).round() as u8;
        Frame::new(frame.width(), frame.height(), frame.rgb().iter().map(bend).collect()).expect("of its size")
    };
    let frames: Vec<Frame> = film(&gpu, &model, issue.stamp(LEAKED), &shots).iter().map(bent).collect();
    let of_film = score(&frames, &mut None);
    assert!(of_film > 0.8 * usual, "{of_film:.1} of {usual:.1}");
}

#[test]
fn a_pattern_behind_the_asset_hides_no_copy() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let issue = Issue::new(&model, prf(14), STRENGTH);
    let shots = shots_from_above(4);
    // A picture is its own over black and over white in parts, by what is behind each pixel.
    let [dark, light] = [[0.0; 3], [1.0; 3]]
        .map(|background| film_by(&gpu, &model, issue.stamp(LEAKED), &shots, &Look { background, ..Look::of(&model) }));
    let patterned = |(dark, light): (&Frame, &Frame)| {
        let width = dark.width() as usize;
        let levels = dark.rgb().iter().zip(light.rgb()).enumerate().map(|(at, (dark, light))| {
            let [x, y] = [at / 3 % width, at / 3 / width].map(|side| side as f32 / 17.0);
            let behind = 0.5 + 0.2 * x.sin() * y.cos();
            ((1.0 - behind) * f32::from(*dark) + behind * f32::from(*light)).round() as u8
        });
        Frame::new(dark.width(), dark.height(), levels.collect()).expect("of its size")
    };
    let frames: Vec<Frame> = dark.iter().zip(&light).map(patterned).collect();
    let usual = film(&gpu, &model, issue.stamp(LEAKED), &shots);
    let [usual, patterned] = [usual, frames].map(|frames| {
        let mut exposures = Exposures::new(&gpu, model.gaussians.len()).expect("it fits");
        let mut told = None;
        for (frame, &(camera, time)) in frames.iter().zip(&shots) {
            exposures.add_of_film(&model, &Shot { frame, camera, time }, &mut told).expect("gathers");
        }
        best(&gpu, &issue, exposures)[0]
    });
    assert_eq!([usual.copy, patterned.copy], [LEAKED; 2]);
    let (usual, of_film) = (usual.score, patterned.score);
    // Where enough shows through nothing is read: the outline, and what the asset has of glass and hair.
    assert!(of_film > 0.6 * usual, "{of_film:.1} of {usual:.1}");
}

#[test]
fn stamps_move_base_colours_alone_and_less_where_there_is_no_room() {
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let issue = Issue::new(&model, prf(13), STRENGTH);
    let (one, two) = (issue.stamp(1), issue.stamp(2));
    assert_ne!(one, two);
    assert_eq!(one, issue.stamp(1), "the same copy again");
    let rows = model.gaussians.sh_coeffs.chunks_exact(48).zip(one.chunks_exact(48));
    let mut moved = 0;
    for (before, after) in rows {
        assert_eq!(before[3..], after[3..], "what turns with the view stays");
        let by: [f32; 3] = std::array::from_fn(|channel| after[channel] - before[channel]);
        // Up to rounding of numbers of about 1.
        assert!(by.iter().all(|b| (b - by[0]).abs() < 1e-6), "grey: {by:?}");
        // All three octaves at their largest: 2.29 times 0.026 of a colour, in units of Y0.
        assert!(by[0].abs() < 2.29 * 0.026 / 0.2820, "{by:?}");
        moved += usize::from(by[0] != 0.0);
    }
    assert!(moved > model.gaussians.len() / 2, "{moved} splats are moved");
    let refused = issue.collect(&[0.0; 3]);
    assert!(matches!(refused, Err(EngineError::Usage { .. })), "{refused:?}");
}
