//! A browser opens the page of `verify --report`, and films copies by other people's viewers. `./x interop` fetches
//! what that takes.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use guard4d_engine::media::codec::Codec;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::render::profile::Viewer;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{FrameSize, LookAt, Model};
use serde_json::Value;

use super::controls::{Rigged, views};
use super::{guard4d, scratch};
use crate::support::gpu::device;
use crate::support::interop::{filmed, program, run};
use crate::support::owner::delivered;
use crate::support::repo;

/// A name that would be markup, if anybody took it for it, and that turns what stands behind it.
const HOSTILE: &str = "\"'><img src=x onerror=alert(1)><svg onload=alert(2)> \u{202e}4pm & {{7*7}}";

/// What the browser says of a page; nothing where there is no browser.
fn browse(page: &Path) -> Option<Value> {
    let (modules, browser) = (program("GUARD4D_NODE_MODULES")?, program("GUARD4D_CHROMIUM")?);
    let script = repo("tests/interop/page.cjs");
    let said = run(Command::new("node").env("NODE_PATH", modules).arg(script).arg(browser).arg(page));
    Some(serde_json::from_str(&said).expect("JSON"))
}

/// The page of a film of hostile name, beside the original and a control of hostile name.
fn page(rigged: &Rigged, folder: &Path) -> PathBuf {
    let (film, page) = (folder.join(HOSTILE), folder.join("verdict.html"));
    fs::create_dir(&film).expect("a name that files may have");
    for entry in fs::read_dir(rigged.file("suspect")).expect("frames") {
        let path = entry.expect("a frame").path();
        fs::copy(&path, film.join(path.file_name().expect("a name"))).expect("writable");
    }
    let marked: [&dyn AsRef<OsStr>; 4] = [&"--report", &page, &"--unrelated", &film];
    let run = rigged.verify_film(&film, &rigged.file("owner.key"), &[&marked[..], &views()].concat());
    assert_eq!(run.code, 4, "the film is its own control: {}{}", run.stdout, run.stderr);
    page
}

fn list<'a>(value: &'a Value, name: &str) -> &'a Vec<Value> {
    value[name].as_array().unwrap_or_else(|| panic!("a list {name} in {value}"))
}

#[test]
fn a_page_is_quiet_reachable_and_takes_no_name_for_markup() {
    let Some(gpu) = device() else { return };
    let folder = scratch();
    let page = page(Rigged::get(&gpu), folder.path());
    let Some(seen) = browse(&page) else { return };
    let views = list(&seen, "views");
    assert_eq!(views.len(), 4, "two widths, light and dark");
    for view in views.iter().chain([&seen["keyboard"], &seen["scriptless"], &seen["paper"], &seen["elements"]]) {
        assert!(list(view, "console").is_empty() && list(view, "requests").is_empty(), "{view}");
    }
    for view in views {
        assert!(list(view, "axe").is_empty() && view["rules"].as_u64() > Some(10), "axe-core: {view}");
        assert_eq!(view["overflows"], false, "nothing is wider than the window: {view}");
    }
    let elements = &seen["elements"];
    assert_eq!(
        (&elements["scripts"], &elements["handlers"]),
        (&1.into(), &0.into()),
        "only the page's own: {elements}"
    );
    assert_eq!(elements["broken"], 0, "all pictures are there");
    let text = seen["scriptless"]["text"].as_str().expect("text");
    let shown = HOSTILE.replace('\u{202e}', "\u{fffd}");
    assert!(text.contains(&shown) && text.contains("INCONCLUSIVE"), "the name as text: {text}");
}

#[test]
fn pictures_are_compared_by_keyboard_and_stand_apart_on_paper() {
    let Some(gpu) = device() else { return };
    let (owner, folder, scene) = (delivered(&gpu), scratch(), DemoScene::unpack().expect("the scene unpacks"));
    let (film, page) = (folder.path().join("film"), folder.path().join("verdict.html"));
    let render: [&dyn AsRef<OsStr>; 4] = [&"render", &owner.join("out/marked"), &"--out", &film];
    guard4d(&[&render[..], &views()].concat()).done();
    let (key, receipt) = (owner.join("owner.key"), owner.join("out/private/receipt.json"));
    let verify: [&dyn AsRef<OsStr>; 6] = [&"verify", &film, &"--key", &key, &"--receipt", &receipt];
    let more: [&dyn AsRef<OsStr>; 5] = [&"--report", &page, &"--original", &scene.path(), &"--no-locate"];
    let run = guard4d(&[&verify[..], &more, &views()].concat());
    assert!([1, 4].contains(&run.code), "one step of training writes nothing: {}", run.stderr);
    let Some(seen) = browse(&page) else { return };
    let stops = list(&seen["keyboard"], "stops");
    let of = |tag: &str| stops.iter().filter(|stop| stop["tag"] == tag).collect::<Vec<_>>();
    assert_eq!((of("input").len(), of("summary").len(), of("pre").len()), (3, 1, 1), "{stops:?}");
    assert!(stops.iter().all(|stop| stop["outline"] != "none"), "the place is seen: {stops:?}");
    assert!(of("input").iter().all(|stop| stop["moved"] == true), "sliders move: {stops:?}");
    assert!(of("summary").iter().all(|stop| stop["opened"] == true), "numbers open: {stops:?}");
    let apart = list(&seen["paper"], "apart");
    assert!(apart.len() == 3 && apart.iter().all(|apart| apart == true), "{apart:?}");
}

/// The page forbids what it does not do, and the tests above would notice.
#[test]
fn a_page_that_was_changed_is_told() {
    let Some(gpu) = device() else { return };
    let (folder, rigged) = (scratch(), Rigged::get(&gpu));
    let page = folder.path().join("verdict.html");
    rigged.verify_with(&rigged.file("owner.key"), &[&"--report", &page]);
    let text = fs::read_to_string(&page).expect("a page");
    let added = "<img src=\"http://127.0.0.1:9/x.png\"><script>document.title = 'changed'</script><input>";
    fs::write(&page, text.replace("</main>", &format!("{added}</main>"))).expect("writable");
    let Some(seen) = browse(&page) else { return };
    let told = list(&seen["elements"], "console");
    assert!(told.len() >= 2, "picture and script are refused: {told:?}");
    assert!(seen["elements"]["title"] != "changed", "the script did not run");
    let view = &list(&seen, "views")[0];
    assert!(list(view, "axe").len() >= 2, "a picture without words, a field without a name: {view}");
}

/// A viewer films a copy at its own settings, nobody gives the cameras, and `trace` names the copy.
fn leak_by(page: &str) {
    if device().is_none() {
        return;
    }
    let (folder, demo) = (scratch(), DemoScene::unpack().expect("it unpacks"));
    let at = |name: &str| folder.path().join(name);
    let (scene, ledger) = (at("scene.ply"), at("show.ledger"));
    guard4d(&[&"convert", &demo.path(), &scene, &"--time", &"0.5"]).done();
    guard4d(&[&"stamp", &scene, &"--ledger", &ledger, &"--to", &"ana,bo,cleo", &"--out", &at("copies")]).done();
    let copy = Model::open(&at("copies/bo.ply")).expect("it opens");
    let fov_x_rad = 47.0_f64.to_radians();
    let lens = Lens { fov_x_rad, size: FrameSize::new(400, 300).expect("a size") };
    let orbit = Orbit { views: 8, elevation_deg: 23.0, look_at: LookAt::around(&copy.gaussians, fov_x_rad), lens };
    let cameras = orbit.cameras().expect("cameras").at_times(&[0.0]);
    let pictures = at("pictures");
    fs::create_dir(&pictures).expect("writable");
    let Some(frames) = filmed(page, &pictures, &copy.gaussians, &cameras) else { return };
    let options = EncodeOptions { codec: Some(Codec::H264), crf: Some(23), ..EncodeOptions::default() };
    write_video(&at("leak.mp4"), &frames, &options).expect("it is encoded");
    let run = guard4d(&[&"trace", &at("leak.mp4"), &"--original", &scene, &"--ledger", &ledger, &"--json"]);
    run.done();
    let report: Value = serde_json::from_str(&run.stdout).expect("JSON");
    let named: Vec<&Value> = list(&report, "copies").iter().map(|copy| &copy["recipient"]).collect();
    assert_eq!(named, ["bo"], "{report}");
    // Whose renderer it was is said too, but by cameras that were found some are too alike to tell.
    let drawn_as = report["drawn_as"][0]["viewer"].as_str().expect("a name");
    assert!(drawn_as.parse::<Viewer>().is_ok(), "{drawn_as}");
    // The first film measured had 52 in 24 frames; without its preset GaussianSplats3D's had 19.
    assert!(report["best_score"].as_f64() > Some(20.0), "{}", report["best_score"]);
}

#[test]
fn a_leak_by_spark_names_its_copy() {
    leak_by("spark");
}

#[test]
fn a_leak_by_gaussian_splats_3d_names_its_copy() {
    leak_by("gaussiansplats3d");
}

#[test]
fn a_leak_by_playcanvas_names_its_copy() {
    leak_by("playcanvas");
}
