//! Copies are stamped, one is filmed from where nobody expected it, and its recipient is named: `stamp`, `ledger`,
//! `render --save-cameras` and `trace`.

use std::fs;
use std::path::{Path, PathBuf};

use guard4d_engine::base::digest::Digest;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{Model, ply};
use serde_json::Value;

use super::{Run, guard4d, names, scratch, unwatched};
use crate::support::fixture::gaussians;
use crate::support::gpu::device;

fn json(run: &Run) -> Value {
    serde_json::from_str(&run.stdout).unwrap_or_else(|e| panic!("{e} in:\n{}", run.stdout))
}

/// The built-in scene with three copies, and a place for films.
struct Show {
    folder: tempfile::TempDir,
    scene: DemoScene,
}

impl Show {
    fn new() -> Self {
        let show = Self { folder: scratch(), scene: DemoScene::unpack().expect("the scene unpacks") };
        let run = show.stamp("ana,bo,cleo", "copies", &[]);
        run.done();
        assert!(run.stderr.contains("is a secret"), "{}", run.stderr);
        show
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn stamp(&self, to: &str, out: &str, more: &[&str]) -> Run {
        let (ledger, out) = (self.at("show.ledger"), self.at(out));
        let mut args: Vec<&dyn AsRef<std::ffi::OsStr>> = Vec::new();
        let scene = self.scene.path();
        args.extend([&"stamp" as &dyn AsRef<_>, &scene, &"--ledger", &ledger, &"--to", &to, &"--out", &out]);
        args.extend(more.iter().map(|word| word as &dyn AsRef<_>));
        guard4d(&args)
    }

    /// Films a model from 70 degrees above, as no usual camera does.
    fn film(&self, model: &Path, name: &str) {
        let (out, cameras) = (self.at(name), self.at("cameras.json"));
        guard4d(&[
            &"render",
            &model,
            &"--orbit",
            &"8",
            &"--frames",
            &"1",
            &"--elevation",
            &"70",
            &"--size",
            &"240x240",
            &"--out",
            &out,
            &"--save-cameras",
            &cameras,
            &"-w",
        ])
        .done();
    }

    fn trace(&self, leak: &str, more: &[&str]) -> Run {
        let (leak, ledger, cameras) = (self.at(leak), self.at("show.ledger"), self.at("cameras.json"));
        let scene = self.scene.path();
        let mut args: Vec<&dyn AsRef<std::ffi::OsStr>> = Vec::new();
        args.extend([&"trace" as &dyn AsRef<_>, &leak, &"--original", &scene, &"--ledger", &ledger]);
        args.extend([&"--cameras" as &dyn AsRef<_>, &cameras]);
        args.extend(more.iter().map(|word| word as &dyn AsRef<_>));
        guard4d(&args)
    }
}

#[test]
fn a_film_from_above_names_the_recipient_and_an_unmarked_one_nobody() {
    if device().is_none() {
        return;
    }
    let show = Show::new();
    show.film(&show.at("copies/bo"), "leak");
    let run = show.trace("leak", &[]);
    run.done();
    assert!(
        run.stdout.contains("copy 2 of bo contributed") && run.stdout.contains("not the probability"),
        "{}",
        run.stdout
    );
    let found = json(&show.trace("leak", &["--json"]));
    assert_eq!(
        (&found["verdict"], &found["frames"], &found["copies_scored"]),
        (&"traced".into(), &8.into(), &3.into())
    );
    let named = found["copies"].as_array().expect("a list");
    assert_eq!((named.len(), &named[0]["recipient"], &named[0]["copy"]), (1, &"bo".into(), &2.into()));
    let p = |value: &Value| value.as_f64().expect("a number");
    assert!(p(&named[0]["p_family"]) < 1e-6 && p(&found["owner"]["p"]) < 1e-3, "{found}");
    // 10,000 decoys: four deviations of their mean and of their mean square.
    let decoys = &found["decoys"];
    assert!(p(&decoys["mean"]).abs() < 0.04 && (p(&decoys["variance"]) - 1.0).abs() < 0.06, "{decoys}");
    // The same as a page, which is whole, fetches nothing, and is not overwritten unasked.
    let page = show.at("trace.html");
    let to_page = ["--report", page.to_str().expect("UTF-8")];
    show.trace("leak", &to_page).done();
    let html = fs::read_to_string(&page).expect("a page");
    let root =
        json(&guard4d(&[&"ledger", &"commit", &show.at("show.ledger"), &"--out", &show.at("r.json"), &"--json"]));
    let (leak, root) = (Digest::of_path(&show.at("leak")).expect("a folder"), root["root"].as_str().expect("a hash"));
    for words in
        ["TRACED", "<bdi>bo</bdi>", "It is not the probability", "dB from the original", &leak.to_string(), root]
    {
        assert!(html.contains(words), "`{words}` is not in {html:.2000}");
    }
    assert!(html.matches("data-compare").count() >= 3 && html.contains("default-src 'none'"), "{html:.2000}");
    assert!(!html.contains("<bdi>ana") && !html.contains("<bdi>cleo"), "who is not named is not on the page");
    show.trace("leak", &to_page).refused(73, &["trace.html", "exists"]);
    // A ledger that knows nobody: all numbers up to the tenth are looked at, and one has no name.
    let scored = json(&show.trace("leak", &["--json", "--copies", "10"]));
    assert_eq!((&scored["copies_scored"], &scored["copies"][0]["copy"]), (&10.into(), &2.into()));

    show.film(show.scene.path(), "clean");
    let run = show.trace("clean", &["--json"]);
    let found = json(&run);
    assert_eq!((run.code, &found["verdict"]), (1, &"none".into()), "{found}");
    assert_eq!(found["copies"].as_array().expect("a list").len(), 0);
    assert!(p(&found["owner"]["p"]) > 1e-3, "{found}");
    // Under so much noise a copy would not be found, so that its absence says nothing.
    let (clean, noisy) = (show.at("clean"), show.at("noisy"));
    guard4d(&[&"attack", &clean, &"--apply", &"noise:0.5", &"--out", &noisy]).done();
    let run = show.trace("noisy", &[]);
    assert_eq!(run.code, 4, "{}", run.stdout);
    assert!(run.stdout.contains("INCONCLUSIVE"), "{}", run.stdout);
}

#[test]
fn a_leaked_asset_names_its_recipient_without_cameras() {
    if device().is_none() {
        return;
    }
    let show = Show::new();
    let trace = |leak: &Path| {
        guard4d(&[&"trace", &leak, &"--original", &show.scene.path(), &"--ledger", &show.at("show.ledger")])
    };
    // As another program wrote it: another format, which rounds colours, and the first moment alone.
    let leak = show.at("leak.spz");
    guard4d(&[&"convert", &show.at("copies/cleo"), &leak, &"--lossy"]).done();
    let run = trace(&leak);
    run.done();
    assert!(run.stdout.contains("copy 3 of cleo contributed"), "{}", run.stdout);
    let run = trace(show.scene.path());
    assert_eq!(run.code, 1, "the original is nobody's copy: {}", run.stdout);
    let other = show.at("other.ply");
    fs::write(&other, ply::encode(&gaussians(40, 1, 3))).expect("writable");
    trace(&other).refused(65, &["other.ply", "splats", "of this asset"]);
}

#[test]
fn copies_differ_in_base_colours_alone_and_come_out_the_same_again() {
    if device().is_none() {
        return;
    }
    let show = Show::new();
    let open = |path: &Path| Model::open(path).expect("a model");
    let (original, copy) = (open(show.scene.path()), open(&show.at("copies/ana")));
    assert_eq!(original.gaussians.means, copy.gaussians.means);
    let rows = original.gaussians.sh_coeffs.chunks_exact(48).zip(copy.gaussians.sh_coeffs.chunks_exact(48));
    let (mut changed, mut others) = (0, 0);
    for (before, after) in rows {
        changed += usize::from(before[..3] != after[..3]);
        others += usize::from(before[3..] != after[3..]);
    }
    assert!(changed > original.gaussians.len() / 2 && others == 0, "{changed} and {others}");
    // With the original's base colours back, every byte is the original's.
    let words = copy.words_of(&original.gaussians.sh_coeffs).expect("words");
    assert_eq!(copy.digest_with(&words), original.digest(), "stamped out again");

    // The same copies again, and a second time for nobody.
    let hash = |run: &Run| json(run)["copies"][0]["hash"].clone();
    let again = show.stamp("ana", "again", &["--again", "--json"]);
    again.done();
    assert_eq!(hash(&again), Value::from(copy.digest().to_string()));
    show.stamp("ana", "third", &[]).refused(65, &["ana has copy 1", "--again"]);
    show.stamp("dora,../ana", "third", &[]).refused(2, &["../ana", "without a path"]);
    show.stamp("dora,Dora", "third", &[]).refused(2, &["Dora twice"]);
    // Dora has no copy there, though something is in the way of Ana's.
    show.stamp("dora,ana", "again", &["--again"]).refused(73, &["ana", "--overwrite"]);
    assert_eq!(names(&show.at("again")), ["ana"]);
    assert!(!show.at("third").exists(), "nothing is left of what was refused");
    // Another asset than the ledger's.
    let other = show.at("other.ply");
    fs::write(&other, ply::encode(&gaussians(40, 1, 3))).expect("writable");
    let stamp =
        guard4d(&[&"stamp", &other, &"--ledger", &show.at("show.ledger"), &"--to", &"eve", &"--out", &show.at("x")]);
    stamp.refused(65, &["show.ledger", "splats of the original", "40"]);
    let list = json(&guard4d(&[&"ledger", &"list", &show.at("show.ledger"), &"--json"]));
    let named: Vec<&str> =
        list.as_array().expect("a list").iter().filter_map(|copy| copy["recipient"].as_str()).collect();
    assert_eq!(named, ["ana", "bo", "cleo", "dora"], "dora's number is kept for her");
}

#[test]
fn cameras_that_do_not_fit_the_film_are_told() {
    if device().is_none() {
        return;
    }
    let show = Show::new();
    show.film(&show.at("copies/bo"), "leak");
    fs::remove_file(show.at("leak/00007.png")).expect("a frame");
    show.trace("leak", &[]).refused(2, &["cameras of", "leak", "8", "one for each of 7 frames"]);
    show.trace("nowhere", &[]).refused(66, &["nowhere", "not found"]);
    fs::create_dir(show.at("empty")).expect("a folder");
    show.trace("empty", &[]).refused(65, &["empty"]);
    let wide = show.at("wide");
    guard4d(&[
        &"render",
        &show.scene.path(),
        &"--orbit",
        &"8",
        &"--frames",
        &"1",
        &"--size",
        &"320x240",
        &"--out",
        &wide,
    ])
    .done();
    show.trace("wide", &[]).refused(2, &["240x240 pixels", "the shape of 320x240"]);
    show.trace("leak", &["--fpr", "0"]).refused(2, &["--fpr", "between 0 and 1"]);
    let two = wide.to_str().expect("UTF-8");
    show.trace("leak", &[two]).refused(2, &["--cameras", "1 for 2 films", "or none at all"]);
    guard4d(&[&"trace", &wide, &"--original", &show.scene.path(), &"--ledger", &wide.join("no.ledger")])
        .refused(66, &["no.ledger", "guard4d stamp"]);
}

#[test]
fn a_ledger_is_asked_exported_and_committed_to() {
    if device().is_none() {
        return;
    }
    let show = Show::new();
    let ledger = show.at("show.ledger");
    let add = guard4d(&[&"ledger", &"add", &ledger, &"dora", &"emil", &"--json"]);
    add.done();
    assert_eq!(json(&add)[1]["copy"], Value::from(5));
    let shown = json(&guard4d(&[&"ledger", &"show", &ledger, &"--json"]));
    assert_eq!((&shown["copies"], &shown["written"]), (&5.into(), &3.into()));
    let secret = fs::read(&ledger).expect("readable");
    assert!(!secret.is_empty() && !shown.to_string().contains("secret"), "{shown}");
    let bo = json(&guard4d(&[&"ledger", &"show", &ledger, &"bo", &"--json"]));
    let by_hash = guard4d(&[&"ledger", &"show", &ledger, &bo["hash"].as_str().expect("a hash"), &"--json"]);
    assert_eq!(json(&by_hash), bo);
    guard4d(&[&"ledger", &"show", &ledger, &"zoe"]).refused(2, &["zoe", "show.ledger"]);
    for (name, start) in [("out.csv", "copy,recipient"), ("out.json", "[")] {
        guard4d(&[&"ledger", &"export", &ledger, &"--out", &show.at(name)]).done();
        assert!(fs::read_to_string(show.at(name)).expect("readable").starts_with(start), "{name}");
    }
    guard4d(&[&"ledger", &"export", &ledger, &"--out", &show.at("out.txt")]).refused(2, &["out.txt", ".csv or .json"]);
    let root = show.at("root.json");
    guard4d(&[&"ledger", &"commit", &ledger, &"--out", &root]).done();
    // Any root can be dated.
    guard4d(&[&"timestamp", &"request", &root, &"--out", &show.at("root.tsq")]).done();
    let clone = show.at("clone.ledger");
    fs::copy(&ledger, &clone).expect("copied");
    guard4d(&[&"ledger", &"add", &clone, &"fay"]).done();
    let merged = guard4d(&[&"ledger", &"merge", &ledger, &clone]);
    merged.done();
    assert!(merged.stderr.contains("1 new"), "{}", merged.stderr);
}

#[test]
fn a_file_of_splats_becomes_a_file_for_each_recipient() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("scene.ply"), ply::encode(&gaussians(300, 1, 5))).expect("writable");
    fs::write(at("list.csv"), "recipient,mail\nana,a@x\nbo,b@x\n").expect("writable");
    let run = guard4d(&[
        &"stamp",
        &at("scene.ply"),
        &"--ledger",
        &at("l"),
        &"--recipients",
        &at("list.csv"),
        &"--out",
        &at("copies"),
    ]);
    run.done();
    assert_eq!(names(&at("copies")), ["ana.ply", "bo.ply"]);
    let [original, ana, bo] =
        ["scene.ply", "copies/ana.ply", "copies/bo.ply"].map(|name| fs::read(at(name)).expect("readable"));
    assert!(original.len() == ana.len() && ana != bo && ana != original);
}

#[test]
fn rows_of_a_farm_stamp_and_trace() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("scene.ply"), ply::encode(&gaussians(300, 1, 5))).expect("writable");
    let rows: String = (0..6).map(|n| format!("s{n},stamp,scene.ply,copies/{n},show.ledger,name{n}\n")).collect();
    fs::write(at("stamp.csv"), format!("id,job,input,output,ledger,to\n{rows}")).expect("writable");
    let run = |name: &str| guard4d(&[&"farm", &"run", &at(name), &"--json"]);
    // They are done beside each other, and none of them has the ledger made before.
    let stamped = run("stamp.csv");
    stamped.done();
    assert_eq!(json(&stamped)["done"], Value::from(6), "{}", stamped.stderr);
    let list = json(&guard4d(&[&"ledger", &"list", &at("show.ledger"), &"--json"]));
    let copies = list.as_array().expect("a list");
    let mut numbers: Vec<u64> = copies.iter().filter_map(|copy| copy["copy"].as_u64()).collect();
    numbers.sort_unstable();
    assert_eq!(numbers, [1, 2, 3, 4, 5, 6], "a number for each");
    assert!(copies.iter().all(|copy| copy["hash"].is_string()), "all are written: {list}");
    let trace = "id,job,input,output,ledger,original\nt,trace,copies/4/name4.ply,found.json,show.ledger,scene.ply\n";
    fs::write(at("trace.csv"), trace).expect("writable");
    run("trace.csv").done();
    let found: Value = serde_json::from_slice(&fs::read(at("found.json")).expect("made")).expect("JSON");
    assert_eq!((&found["verdict"], &found["copies"][0]["recipient"]), (&"traced".into(), &"name4".into()), "{found}");
    let records = fs::read_dir(at("trace.farm")).expect("made").map(|entry| entry.expect("readable").path());
    let texts: String = records.filter_map(|path| fs::read_to_string(path).ok()).collect();
    assert!(texts.contains("traced") && !texts.contains("\"recipient\""), "who is named stands in the file alone");
}

#[test]
fn the_lab_measures_how_far_a_copy_stands_out() {
    if device().is_none() || !crate::support::has_ffmpeg() {
        return;
    }
    let (folder, scene) = (scratch(), DemoScene::unpack().expect("the scene unpacks"));
    let out = folder.path().join("readings.csv");
    let measure = |more: &[&str]| {
        let mut args: Vec<&dyn AsRef<std::ffi::OsStr>> = vec![&"lab", &"tracing"];
        let path = scene.path();
        args.extend([&path as &dyn AsRef<_>, &"--keys", &"1", &"--frames", &"12", &"--side", &"160", &"--out", &out]);
        args.extend(more.iter().map(|word| word as &dyn AsRef<_>));
        unwatched(&args).done();
        fs::read_to_string(&out).expect("a table")
    };
    let films = measure(&["--films", "png,h264 23,rows,gamma 0.8"]);
    assert_eq!(films.lines().count(), 1 + 4, "{films}");
    let innocent = measure(&["--films", "png", "--part", "innocent"]);
    assert!(innocent.starts_with(&films), "what is there is not measured again");
    let head: Vec<&str> = films.lines().next().expect("a head").split(',').collect();
    let column = |line: &str, name: &str| {
        let at = head.iter().position(|column| *column == name).expect("a column");
        line.split(',').nth(at).expect("a cell").to_owned()
    };
    for line in innocent.lines().skip(1) {
        let is_copy = column(line, "leak") == "copy";
        assert_eq!(column(line, "named"), if is_copy { "1" } else { "0" }, "{line}");
        assert_eq!(column(line, "wrong"), "0", "{line}");
    }
}

#[test]
fn a_lost_ledger_is_made_again_from_its_key() {
    if device().is_none() {
        return;
    }
    let show = Show::new();
    let (ledger, key, table) = (show.at("show.ledger"), show.at("show.key"), show.at("copies.csv"));
    guard4d(&[&"ledger", &"key", &ledger, &"--out", &key]).done();
    guard4d(&[&"ledger", &"key", &ledger, &"--out", &key]).refused(73, &["show.key", "it exists"]);
    guard4d(&[&"ledger", &"export", &ledger, &"--out", &table]).done();
    let list = |ledger: &Path| json(&guard4d(&[&"ledger", &"list", &ledger, &"--json"]));
    let known = list(&ledger);
    let lost = |name: &str| fs::remove_file(show.at(name)).expect("it was there");
    // A table that cannot be, and a key that is none, leave nothing behind.
    let text = fs::read_to_string(&table).expect("readable");
    let [twice, short] = [show.at("twice.csv"), show.at("short.key")];
    fs::write(&twice, text.replace("\n3,cleo", "\n2,cleo")).expect("writable");
    let secret = fs::read_to_string(&key).expect("readable");
    fs::write(&short, secret.replacen("\"secret\": \"", "\"secret\": \"zz", 1)).expect("writable");
    let again = show.at("again.ledger");
    let restore =
        |key: &Path, table: &Path| guard4d(&[&"ledger", &"restore", &key, &"--out", &again, &"--copies", &table]);
    restore(&key, &twice).refused(65, &["twice.csv: copy", "a number above 2"]);
    restore(&short, &table).refused(65, &["short.key: secret", "64 hexadecimal digits"]);
    assert!(!again.exists(), "none was made");
    restore(&key, &table).done();
    assert_eq!(list(&again), known, "numbers, names, hashes and dates");
    restore(&key, &table).refused(73, &["again.ledger"]);
    // From the key alone: copies are scored by their numbers.
    lost("show.ledger");
    guard4d(&[&"ledger", &"restore", &key, &"--out", &ledger]).done();
    let run = show.trace("copies/bo", &["--copies", "1000", "--json"]);
    run.done();
    let named = &json(&run)["copies"];
    assert_eq!((&named[0]["copy"], &named[0]["recipient"]), (&2.into(), &Value::Null), "{named}");
    assert_eq!(named.as_array().map(Vec::len), Some(1));
}

#[test]
fn any_copy_is_turned_back_to_the_byte() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("scene.ply"), ply::encode(&gaussians(300, 1, 5))).expect("writable");
    for name in ["scene.ply", "scene.spz", "scene.glb"] {
        let (ledger, undo) = (at(&format!("{name}.ledger")), at(&format!("{name}.undo")));
        if name != "scene.ply" {
            guard4d(&[&"convert", &at("scene.ply"), &at(name), &"--lossy"]).done();
        }
        let out = at(&format!("{name}.copies"));
        let stamp = |to: &str, more: &[&dyn AsRef<std::ffi::OsStr>]| {
            let mut args: Vec<&dyn AsRef<std::ffi::OsStr>> = Vec::new();
            let model = at(name);
            args.extend([&"stamp" as &dyn AsRef<_>, &model, &"--ledger", &ledger, &"--to", &to, &"--out", &out]);
            args.extend(more);
            guard4d(&args)
        };
        stamp("ana,bo", &[&"--undo", &undo]).done();
        // One file is for all copies, those that follow too.
        stamp("cleo", &[]).done();
        let original = fs::read(at(name)).expect("readable");
        for recipient in ["ana", "bo", "cleo"] {
            let copy = out.join(format!("{recipient}{}", name.trim_start_matches("scene")));
            assert!(fs::read(&copy).expect("a copy") != original, "{name}: it was stamped");
            let back = at("back");
            guard4d(&[&"undo", &copy, &"--undo", &undo, &"--out", &back, &"-w"]).done();
            let file = fs::read_dir(&back).expect("a folder").next().expect("a file").expect("readable").path();
            assert!(fs::read(file).expect("readable") == original, "{name} of {recipient}: byte for byte");
        }
    }
    // Somebody else's asset is not turned into anything.
    fs::write(at("other.ply"), ply::encode(&gaussians(300, 1, 6))).expect("writable");
    guard4d(&[&"undo", &at("other.ply"), &"--undo", &at("scene.ply.undo"), &"--out", &at("none")])
        .refused(65, &["scene.ply.undo: original", "a model whose original hashes to"]);
    assert!(!at("none").exists());
}
