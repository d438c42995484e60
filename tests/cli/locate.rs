//! Films whose cameras nobody knows: `locate` finds them, `trace` names a recipient, and neither finds what is not
//! there.

use std::fs;
use std::path::{Path, PathBuf};

use glam::Vec3;
use guard4d_engine::scene::camera::View;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt, Model, ply};
use serde_json::Value;

use super::{Run, scratch, unwatched};
use crate::support::fixture::gaussians;
use crate::support::gpu::device;
use crate::support::room::{self, Standing};

const SIZE: (u32, u32) = (224, 168);
/// Frames of the film.
const FRAMES: usize = 6;

fn json(run: &Run) -> Value {
    serde_json::from_str(&run.stdout).unwrap_or_else(|e| panic!("{e} in:\n{}", run.stdout))
}

/// A copy of the built-in scene, filmed by a camera of which only this file knows.
struct Leak {
    folder: tempfile::TempDir,
    scene: DemoScene,
    cameras: CameraSet,
}

impl Leak {
    fn new() -> Self {
        let scene = DemoScene::unpack().expect("the scene unpacks");
        let lens = Lens { fov_x_rad: 0.62, size: FrameSize::new(SIZE.0, SIZE.1).expect("a size") };
        let model = Model::open(scene.path()).expect("the scene opens");
        let look_at = LookAt::of(&model, f64::from(0.7f32));
        let orbit = Orbit { views: 90, elevation_deg: 28.0, look_at, lens };
        let mut cameras = orbit.cameras().expect("an orbit");
        cameras.views = cameras.views.split_off(40);
        cameras.views.truncate(FRAMES);
        for (number, view) in cameras.views.iter_mut().enumerate() {
            view.times = vec![0.3 + 0.02 * number as f32];
        }
        let leak = Self { folder: scratch(), scene, cameras: CameraSet { in_sequence: true, ..cameras } };
        fs::write(leak.at("true.json"), leak.cameras.film_json()).expect("writable");
        let out = leak.at("copies");
        unwatched(&[
            &"stamp",
            &leak.scene.path(),
            &"--ledger",
            &leak.at("show.ledger"),
            &"--to",
            &"ana,bo,cleo",
            &"--out",
            &out,
        ])
        .done();
        let film = leak.at("leak.mp4");
        unwatched(&[&"render", &out.join("bo"), &"--cameras", &leak.at("true.json"), &"--out", &film]).done();
        leak
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn locate(&self, film: &str, original: &Path, more: &[&str]) -> Run {
        let (film, out) = (self.at(film), self.at("found.json"));
        let mut args: Vec<&dyn AsRef<std::ffi::OsStr>> = Vec::new();
        args.extend([&"locate" as &dyn AsRef<_>, &film, &"--original", &original, &"--out", &out, &"--json"]);
        args.extend(more.iter().map(|word| word as &dyn AsRef<_>));
        unwatched(&args)
    }

    fn trace(&self, film: &str, more: &[&dyn AsRef<std::ffi::OsStr>]) -> Value {
        let (film, ledger) = (self.at(film), self.at("show.ledger"));
        let scene = self.scene.path();
        let mut args: Vec<&dyn AsRef<std::ffi::OsStr>> = vec![&"trace", &film, &"--original", &scene, &"--ledger"];
        args.extend([&ledger as &dyn AsRef<_>, &"--json"]);
        args.extend(more);
        json(&unwatched(&args))
    }

    /// Pictures of one colour.
    fn grey(&self, name: &str, side: u32) {
        let folder = self.at(name);
        fs::create_dir(&folder).expect("writable");
        for number in 0..2 {
            let picture = image::RgbImage::from_pixel(side, side, image::Rgb([90, 120, 90]));
            picture.save(folder.join(format!("{number}.png"))).expect("writable");
        }
    }
}

#[test]
fn a_film_of_an_unknown_camera_is_located_and_names_the_recipient() {
    if device().is_none() {
        return;
    }
    let leak = Leak::new();
    let run = leak.locate("leak.mp4", leak.scene.path(), &["--sheet", leak.at("sheet.png").to_str().expect("UTF-8")]);
    run.done();
    let found = json(&run);
    assert_eq!((&found["verdict"], &found["located"]), (&"located".into(), &FRAMES.into()), "{found}");
    let back = CameraSet::open(&leak.at("found.json"), FrameSize::DNERF).expect("a camera file");
    let points = [[0.3, 0.2, 0.1], [-0.4, 0.1, 0.5], [0.1, -0.5, 0.3], [0.0, 0.3, -0.4]].map(Vec3::from);
    for (found, view) in back.film().into_iter().zip(&leak.cameras.views) {
        let (camera, time) = found.expect("every frame is located");
        for point in points {
            let [a, b] = [camera, view.camera].map(|camera| camera.project(point).expect("in front").0);
            // The bar: half a pixel, and a 200th of the motion.
            assert!(a.distance(b) < 0.5, "{a} and {b}");
        }
        assert!((time - view.times[0]).abs() < 1.0 / 200.0, "{time} and {:?}", view.times);
    }
    let sheet = image::open(leak.at("sheet.png")).expect("a picture");
    assert_eq!((sheet.width(), sheet.height()), (3 * SIZE.0, 3 * SIZE.1), "three frames, the original, what differs");

    // A film whose cameras `trace` looks for itself is that of the room, below.
    let traced = leak.trace("leak.mp4", &[&"--cameras", &leak.at("found.json")]);
    assert_eq!((&traced["verdict"], &traced["copies"][0]["recipient"]), (&"traced".into(), &"bo".into()), "{traced}");
    assert!(traced["copies"][0]["p_family"].as_f64().expect("a number") < 1e-6, "{traced}");
    assert!(!leak.at("found.json.checkpoint.safetensors").exists(), "a finished search leaves none");
    leak.locate("leak.mp4", leak.scene.path(), &[]).refused(73, &["found.json", "exists"]);
}

#[test]
fn what_is_not_in_a_film_is_not_found_in_it_and_nobody_is_named() {
    if device().is_none() {
        return;
    }
    let leak = Leak::new();
    leak.grey("grey", 64);
    let resumed = leak.locate("grey", leak.scene.path(), &["--resume"]);
    resumed.refused(66, &["found.json.checkpoint.safetensors"]);
    let traced = leak.trace("grey", &[]);
    assert_eq!((&traced["verdict"], &traced["frames"]), (&"inconclusive".into(), &0.into()), "{traced}");
    assert_eq!(traced["copies"].as_array().expect("a list").len(), 0);
    // No film at all, before anything is looked for.
    let run = leak.locate("nothing.mp4", &leak.at("nowhere"), &[]);
    run.refused(66, &["nothing.mp4"]);
    // Another asset.
    let other = leak.at("other.ply");
    fs::write(&other, ply::encode(&gaussians(400, 1, 3))).expect("writable");
    let run = leak.locate("leak.mp4", &other, &["--max-frames", "1"]);
    assert_eq!((run.code, &json(&run)["verdict"]), (4, &"inconclusive".into()), "{}", run.stdout);
    let guess = CameraSet::open(&leak.at("found.json"), FrameSize::DNERF).expect("a camera file");
    assert!(guess.film().iter().all(Option::is_none), "what is written is called a guess");
    // Too small to say anything.
    leak.grey("tiny", 3);
    let run = leak.locate("tiny", leak.scene.path(), &["--overwrite"]);
    assert_eq!((run.code, &json(&run)["verdict"]), (4, &"inconclusive".into()), "{}", run.stdout);
}

#[test]
fn a_film_from_within_a_room_names_the_recipient_where_its_capture_is_known() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let at = |name: &str| folder.path().join(name);
    let size = FrameSize::new(SIZE.0, SIZE.1).expect("a size");
    fs::write(at("room.ply"), ply::encode(&room::room())).expect("writable");
    let set = |standing: &[Standing]| {
        let view = |standing: &Standing| View {
            name: "frame".to_owned(),
            camera: standing.camera(size),
            times: vec![0.0],
            located: true,
        };
        CameraSet { views: standing.iter().map(view).collect(), in_sequence: true }.film_json()
    };
    fs::write(at("capture.json"), set(&room::capture())).expect("writable");
    let path = |number: usize| Standing {
        place: [-0.4 + 0.1 * number as f64, 0.0],
        looks_deg: [200.0 + 20.0 * number as f64, 4.0],
        fov_deg: 50.0,
    };
    fs::write(at("true.json"), set(&(0..4).map(path).collect::<Vec<_>>())).expect("writable");
    let (room, ledger, film) = (at("room.ply"), at("show.ledger"), at("leak.mp4"));
    unwatched(&[&"stamp", &room, &"--ledger", &ledger, &"--to", &"ana,bo", &"--out", &at("copies")]).done();
    let copy = at("copies").join("bo.ply");
    unwatched(&[&"render", &copy, &"--cameras", &at("true.json"), &"--out", &film]).done();
    let trace = |near: &Path| {
        unwatched(&[&"trace", &film, &"--original", &room, &"--ledger", &ledger, &"--near", &near, &"--json"])
    };
    let traced = json(&trace(&at("capture.json")));
    assert_eq!((&traced["verdict"], &traced["copies"][0]["recipient"]), (&"traced".into(), &"bo".into()), "{traced}");
    assert_eq!(traced["located"][0]["located"], 4, "{traced}");
    fs::write(at("empty.json"), r#"{"frames": []}"#).expect("writable");
    trace(&at("empty.json")).refused(65, &["empty.json"]);
    trace(&at("nowhere.json")).refused(66, &["nowhere.json"]);
}
