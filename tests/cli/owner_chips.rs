//! The owner's chips: `embed` writes them, and `verify --original --cameras` reads them in films from where nothing
//! was trained.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt};
use serde_json::Value;

use super::{Run, put, scratch, unwatched};
use crate::support::gpu::{Gpu, device};
use crate::support::owner::key_file;

/// The built-in scene with a mark of next to no training, and films of it.
struct Owner {
    folder: tempfile::TempDir,
    scene: DemoScene,
}

impl Owner {
    fn new(gpu: &Gpu) -> Self {
        let owner = Self { folder: scratch(), scene: DemoScene::unpack().expect("the scene unpacks") };
        let clip = ClipModel::load(gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
        put(owner.folder.path(), "owner.key", &key_file(&clip).to_bytes().expect("serialises"));
        owner
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn embed(&self, out: &str, more: &[&str]) -> Run {
        let (scene, key, out) = (self.scene.path(), self.at("owner.key"), self.at(out));
        let small = "--steps 2 --train-clips 2 --probes 16 --size 32x32 --orbit 1 --frames 2 --min-accuracy 0 --quiet";
        let mut args: Vec<&dyn AsRef<OsStr>> = vec![&"embed", &scene, &"--key", &key, &"--out", &out];
        let words: Vec<&str> = small.split(' ').chain(more.iter().copied()).collect();
        args.extend(words.iter().map(|word| word as &dyn AsRef<OsStr>));
        unwatched(&args)
    }

    /// From 70 degrees above; training stays below 60.
    fn film(&self, model: &Path, name: &str) {
        let (out, cameras) = (self.at(name), self.at("cameras.json"));
        let from = "--orbit 8 --frames 1 --elevation 70 --size 240x240 -w";
        let mut args: Vec<&dyn AsRef<OsStr>> = vec![&"render", &model, &"--out", &out, &"--save-cameras", &cameras];
        let words: Vec<&str> = from.split(' ').collect();
        args.extend(words.iter().map(|word| word as &dyn AsRef<OsStr>));
        unwatched(&args).done();
    }

    /// A few degrees from 30 above.
    fn film_around(&self, model: &Path, name: &str) {
        let lens = Lens { fov_x_rad: 0.69, size: FrameSize::new(224, 168).expect("a size") };
        let orbit = Orbit { views: 90, elevation_deg: 30.0, look_at: LookAt::D_NERF, lens };
        let mut cameras = orbit.cameras().expect("an orbit");
        cameras.views.truncate(8);
        let (out, around) = (self.at(name), self.at("around.json"));
        fs::write(&around, CameraSet { in_sequence: true, ..cameras.at_times(&[0.0]) }.film_json()).expect("writable");
        unwatched(&[&"render", &model, &"--cameras", &around, &"--out", &out]).done();
    }

    fn verify(&self, film: &str, receipt: &str, more: &[&dyn AsRef<OsStr>]) -> Run {
        let (film, key) = (self.at(film), self.at("owner.key"));
        let receipt = self.at(receipt).join("private/receipt.json");
        let args: [&dyn AsRef<OsStr>; 6] = [&"verify", &film, &"--key", &key, &"--receipt", &receipt];
        unwatched(&[&args[..], more].concat())
    }
}

fn json(run: &Run) -> Value {
    serde_json::from_str(&run.stdout).unwrap_or_else(|e| panic!("{e} in:\n{}{}", run.stdout, run.stderr))
}

#[test]
fn a_film_from_above_proves_the_asset_by_its_chips_alone() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    owner.embed("out", &[]).done();
    owner.film(&owner.at("out/marked"), "leak");
    owner.film(owner.scene.path(), "clean");
    let (scene, cameras) = (owner.scene.path(), owner.at("cameras.json"));
    let by_cameras: [&dyn AsRef<OsStr>; 5] = [&"--original", &scene, &"--cameras", &cameras, &"--json"];

    let run = owner.verify("leak", "out", &by_cameras);
    let found = json(&run);
    let chips = &found["owner_chips"];
    assert_eq!((run.code, &found["verdict"], &chips["proves"]), (0, &"present".into(), &true.into()), "{found}");
    assert_ne!(found["evidence"]["verdict"], "present", "eight bits prove nothing");
    assert_eq!((&chips["frames"], &chips["searched"]), (&8.into(), &3.into()), "{chips}");
    // What the issue asks of 24 frames through a codec; these are eight, and exact.
    assert!(chips["log10_p"].as_f64().is_some_and(|p| p < -9.0), "{chips}");
    // The message alone, and beside the original, are two of three readings.
    assert_eq!(found["evidence"]["p_value"]["searched"], 3, "{found}");
    let beside = &found["compared_message"];
    assert_eq!((&beside["frames"], &beside["num_bits"]), (&8.into(), &8.into()), "{found}");
    assert_eq!((&beside["p_value"]["searched"], &beside["proves"]), (&3.into(), &false.into()), "{found}");
    // Ten claims, ten chances; and in words.
    let words = owner.verify("leak", "out", &[&by_cameras[..4], &[&"--claims", &"10"]].concat()).stdout;
    assert!(words.contains("PRESENT") && words.contains("times 30): they prove it alone"), "{words}");
    assert!(words.contains("beside the original"), "{words}");

    let found = json(&owner.verify("clean", "out", &by_cameras));
    assert_eq!((&found["owner_chips"]["proves"], &found["owner_chips"]["frames"]), (&false.into(), &8.into()));
    assert!(found["owner_chips"]["p"].as_f64().is_some_and(|p| p > 1e-3), "{found}");
    assert_ne!(found["verdict"], "present", "{found}");

    // A film whose cameras nobody gives is located.
    owner.film_around(&owner.at("out/marked"), "round");
    let found = json(&owner.verify("round", "out", &[&"--original", &scene, &"--max-frames", &"6", &"--json"]));
    assert_eq!((&found["located"][0]["located"], &found["owner_chips"]["frames"]), (&6.into(), &6.into()), "{found}");
    assert_eq!((&found["verdict"], &found["owner_chips"]["proves"]), (&"present".into(), &true.into()), "{found}");
    assert_eq!(found["evidence"]["p_value"]["searched"], 3, "all readings count: {found}");
    assert_eq!(found["compared_message"]["frames"], 6, "{found}");

    // Without the original they are not read, nor unasked.
    let blind = json(&owner.verify("leak", "out", &[&"--json"]));
    assert!(blind["owner_chips"].is_null() && blind["evidence"]["p_value"]["kind"] == "exact", "{blind}");
    let orbit = json(&owner.verify("leak", "out", &[&"--original", &scene, &"--no-locate", &"--json"]));
    assert!(orbit["owner_chips"].is_null() && orbit["compared_message"].is_null(), "{orbit}");

    // A mark without chips says nothing by them.
    owner.embed("plain", &["--chips-db", "0"]).done();
    owner.film(&owner.at("plain/marked"), "plain-film");
    let plain = json(&owner.verify("plain-film", "plain", &by_cameras));
    assert!(plain["owner_chips"].is_null() && plain["compared_message"]["frames"] == 8, "{plain}");
    owner.embed("much", &["--chips-db", "4"]).refused(2, &["chips_db: 4", "0 to 3 dB"]);
}
