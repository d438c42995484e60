//! `guard4d verify` on the outputs of a small embedding.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::media::Frame;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::png::{write_png, write_png_folder};

use super::{Run, guard4d, put, scratch};
use crate::support::authority::{Authority, P256, has_openssl, receipt};
use crate::support::gpu::device;
use crate::support::owner::delivered;

/// Reads `clip` with the delivered key and receipt.
fn verify(owner: &Path, clip: &Path, more: &[&dyn AsRef<OsStr>]) -> Run {
    let (key, receipt) = (owner.join("owner.key"), owner.join("out/private/receipt.json"));
    let args: [&dyn AsRef<OsStr>; 6] = [&"verify", &clip, &"--key", &key, &"--receipt", &receipt];
    guard4d(&[&args[..], more].concat())
}

#[test]
fn a_clip_is_judged_in_words_and_in_json() {
    let Some(gpu) = device() else { return };
    let owner = delivered(&gpu);
    let preview = owner.join("out/preview");
    let run = verify(owner, &preview, &[&"--json"]);
    // Two frames and eight bits prove nothing either way.
    assert_eq!(run.code, 4, "inconclusive, which is no error: {}", run.stderr);
    let report: serde_json::Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
    assert_eq!(report["frames"], 2, "frames: {report}");
    let p_value = &report["evidence"]["p_value"];
    assert!(p_value["kind"] == "exact" && p_value["matches"].is_number(), "an exact p-value: {report}");
    let text = verify(owner, &preview, &[]);
    assert_eq!(text.code, run.code, "the same verdict");
    assert!(text.stdout.contains("verdict") && text.stdout.contains("of 8 match (2 frames)"), "{}", text.stdout);
    assert_eq!(text.stderr, "", "nothing to say");
}

/// What `verify` says of a suspect, seen from one side.
fn from_one_side(owner: &Path, suspects: &[&dyn AsRef<OsStr>], more: &[&dyn AsRef<OsStr>]) -> serde_json::Value {
    let (key, receipt) = (owner.join("owner.key"), owner.join("out/private/receipt.json"));
    let args: [&dyn AsRef<OsStr>; 6] = [&"verify", &"--key", &key, &"--receipt", &receipt, &"--json"];
    let run = guard4d(&[&args[..], suspects, &ONE_VIEW, more].concat());
    assert!([1, 4].contains(&run.code), "a verdict, though not of presence: {}", run.stderr);
    serde_json::from_str(&run.stdout).expect("JSON on stdout")
}

/// A single frame of a single view.
const ONE_VIEW: [&dyn AsRef<OsStr>; 6] = [&"--orbit", &"1", &"--frames", &"1", &"--size", &"32x32"];

#[test]
fn a_model_is_read_as_a_film_of_it() {
    let Some(gpu) = device() else { return };
    let (owner, folder) = (delivered(&gpu), scratch());
    let (marked, film) = (owner.join("out/marked"), folder.path().join("film"));
    guard4d(&[&[&"render" as &dyn AsRef<OsStr>, &marked, &"--out", &film], &ONE_VIEW[..]].concat()).done();
    let (of_model, of_film) = (from_one_side(owner, &[&marked], &[]), from_one_side(owner, &[&film], &[]));
    assert_eq!(of_model["evidence"], of_film["evidence"], "the same frames, rounded alike");
    assert_eq!(of_model["clips"][0]["name"], format!("{}, view 0", marked.display()), "{of_model}");
    let both = from_one_side(owner, &[&film, &marked], &["--start", "0"].each_ref().map(|flag| flag as _));
    assert_eq!(both["frames"], 2, "{both}");
    let names: Vec<_> = both["clips"].as_array().expect("a list").iter().map(|clip| &clip["name"]).collect();
    assert_eq!(*names[0], film.display().to_string(), "films keep their place and their name");
    assert_eq!(names[1], &of_model["clips"][0]["name"]);
    let broken = put(folder.path(), "broken.ply", b"ply\nformat");
    verify(owner, &broken, &[]).refused(65, &["broken.ply", "header"]);
}

/// One moment as a file of its own stands still, and things that stand still are usually filmed from elsewhere.
#[test]
fn a_moment_is_filmed_as_the_original_is() {
    let Some(gpu) = device() else { return };
    let (owner, folder) = (delivered(&gpu), scratch());
    let (marked, moment) = (owner.join("out/marked"), folder.path().join("0.ply"));
    guard4d(&[&"convert", &marked, &moment]).done();
    let scene = guard4d_engine::scene::demo::DemoScene::unpack().expect("the scene unpacks");
    let whole = from_one_side(owner, &[&marked], &[]);
    let alone = from_one_side(owner, &[&moment], &[]);
    let beside = from_one_side(owner, &[&moment], &[&"--original", &scene.path()]);
    let p = |report: &serde_json::Value| report["evidence"]["p_value"].clone();
    assert_eq!(p(&beside), p(&whole), "a PLY keeps every coefficient");
    assert!(p(&alone) != p(&whole), "from elsewhere, over another background: {alone}");
    for wrong in [[&"--message" as &dyn AsRef<OsStr>, &"hex:zz"], [&"--pretrained", &owner.join("owner.key")]] {
        let run = verify(owner, &moment, &wrong);
        assert!([2, 65].contains(&run.code), "{}", run.stderr);
    }
}

#[test]
fn a_page_is_written_whole_or_not_at_all() {
    let Some(gpu) = device() else { return };
    let (owner, folder) = (delivered(&gpu), scratch());
    let (preview, page) = (owner.join("out/preview"), folder.path().join("verdict.html"));
    let run = verify(owner, &preview, &[&"--report", &page, &"--json"]);
    assert_eq!(run.code, 4, "the verdict is what it is without: {}", run.stderr);
    let report: serde_json::Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
    let text = fs::read_to_string(&page).expect("a page");
    let hash = |value: &serde_json::Value| value.as_str().expect("a hash").to_owned();
    let files = [hash(&report["commitment"]), hash(&report["clips"][0]["blake3"])];
    for needed in ["INCONCLUSIVE", "preview", "guard4d verify", "data:image/png;base64,", "</html>"] {
        assert!(text.contains(needed), "`{needed}` is missing");
    }
    assert!(files.iter().all(|hash| text.contains(hash)), "{files:?}");
    let bits = report["bits"].as_array().expect("a list");
    let agree = |bit: &&serde_json::Value| bit["claimed"] == (bit["logit"].as_f64().expect("a number") > 0.0);
    assert_eq!(bits.len(), 8, "{report}");
    assert_eq!(report["evidence"]["matches"], bits.iter().filter(agree).count(), "{report}");
    // What is there stays, unless whoever asks says otherwise; what cannot be read leaves nothing.
    verify(owner, &preview, &[&"--report", &page]).refused(73, &["verdict.html", "it exists", "--overwrite"]);
    let again = verify(owner, &preview, &[&"--report", &page, &"--overwrite"]);
    assert_eq!(again.code, 4, "{}", again.stderr);
    assert_eq!(fs::read_to_string(&page).expect("a page"), text, "the same verdict gives the same page");
    let other = folder.path().join("other.html");
    verify(owner, &folder.path().join("nowhere"), &[&"--report", &other]).refused(66, &["nowhere: not found"]);
    assert_eq!(super::names(folder.path()), ["verdict.html"], "nothing else is left");
}

#[test]
fn clips_that_are_no_clips_are_refused() {
    let Some(gpu) = device() else { return };
    let owner = delivered(&gpu);
    let folder = scratch();
    verify(owner, &folder.path().join("nowhere"), &[]).refused(66, &["nowhere: not found"]);
    let empty = folder.path().join("empty");
    put(&empty, "notes.txt", b"no frames");
    let words = ["empty: frames: no .png, .jpg or .exr file", "at least one"];
    verify(owner, &empty, &[]).refused(65, &words);
    verify(owner, &owner.join("out/preview"), &[&"--unrelated", &empty]).refused(65, &words);
    let mixed = folder.path().join("mixed");
    fs::create_dir(&mixed).expect("writable");
    for (name, side) in [("0.png", 32), ("1.png", 48)] {
        write_png(&mixed.join(name), &grey(side, side, 0)).expect("writable");
    }
    verify(owner, &mixed, &[]).refused(65, &["1.png: size of frame 1: 48 x 48 px", "32 x 32 px, the size of frame 0"]);
    let torn = folder.path().join("torn");
    let png = fs::read(owner.join("out/preview/00000.png")).expect("a frame");
    put(&torn, "0.png", &png[..png.len() / 2]);
    verify(owner, &torn, &[]).refused(65, &["0.png: picture"]);
}

/// Where films may have been taken is one word: one of several would be left unheard.
#[test]
fn places_near_cameras_go_with_nothing_else_about_cameras() {
    let film: [&dyn AsRef<OsStr>; 6] = [&"verify", &"film.mp4", &"--key", &"k", &"--receipt", &"r"];
    let near: [&dyn AsRef<OsStr>; 4] = [&"--original", &"m", &"--near", &"places"];
    let others: [&[&dyn AsRef<OsStr>]; 3] = [&[&"--cameras", &"c.json"], &[&"--known-cameras"], &[&"--no-locate"]];
    for other in others {
        guard4d(&[&film[..], &near, other].concat()).refused(2, &["cannot be used with", "--near"]);
    }
}

#[test]
fn videos_without_frames_are_refused() {
    let Some(gpu) = device() else { return };
    if !crate::support::has_ffmpeg() {
        return;
    }
    let owner = delivered(&gpu);
    let folder = scratch();
    let noise = put(folder.path(), "noise.mp4", &[0x5a; 4096]);
    verify(owner, &noise, &[]).refused(65, &["noise.mp4: container", "a video that ffmpeg can decode"]);
    let empty = put(folder.path(), "empty.mp4", b"");
    verify(owner, &empty, &[]).refused(65, &["empty.mp4: container"]);
    let none = folder.path().join("none.mp4");
    ffmpeg(&["-f", "lavfi", "-i", "color=s=64x64", "-frames:v", "0"], &none);
    verify(owner, &none, &[]).refused(65, &["none.mp4: streams: no video stream"]);
    let sound = folder.path().join("sound.mp4");
    ffmpeg(&["-f", "lavfi", "-i", "anullsrc=d=0.1"], &sound);
    verify(owner, &sound, &[]).refused(65, &["sound.mp4: streams: no video stream"]);
    let whole = folder.path().join("whole.mp4");
    ffmpeg(&["-f", "lavfi", "-i", "testsrc=s=64x64", "-frames:v", "30", "-movflags", "+faststart"], &whole);
    let whole = fs::read(whole).expect("a video");
    // The index comes first, so the file still says how many frames there were.
    let cut = put(folder.path(), "cut.mp4", &whole[..whole.len() - whole.len() / 8]);
    let run = verify(owner, &cut, &[]);
    assert!([1, 4].contains(&run.code), "no verdict of presence: {}, {}", run.code, run.stderr);
    assert!(run.stdout.contains("damaged") && run.stdout.contains("cut.mp4"), "{}", run.stdout);
    let head = put(folder.path(), "head.mp4", &whole[..200]);
    verify(owner, &head, &[]).refused(65, &["head.mp4: streams: no video stream"]);
}

#[test]
fn unmarked_clips_are_absent_and_clips_that_prove_nothing_inconclusive() {
    let Some(gpu) = device() else { return };
    let owner = delivered(&gpu);
    let folder = scratch();
    let inconclusive = |clip: &Path, reason: &str| {
        let run = verify(owner, clip, &[]);
        assert_eq!(run.code, 4, "{}: {}", clip.display(), run.stderr);
        assert!(run.stdout.contains("INCONCLUSIVE") && run.stdout.contains(reason), "{}", run.stdout);
    };
    // Of these pictures the bits are right by chance: enough frames to say so.
    let plain = folder.path().join("plain");
    let pixel = |at: u32| [(at % 64 * 4) as u8, (at / 64 * 4) as u8, 40];
    let card = Frame::new(64, 64, (0..64 * 64).flat_map(pixel).collect()).expect("the length fits");
    write_png_folder(&plain, &[(); 8].map(|()| card.clone())).expect("writable");
    let absent = verify(owner, &plain, &[]);
    assert_eq!(absent.code, 1, "absent: {}{}", absent.stdout, absent.stderr);
    assert!(absent.stdout.contains("ABSENT"), "{}", absent.stdout);
    let single = folder.path().join("single");
    put(&single, "0.png", &fs::read(owner.join("out/preview/00000.png")).expect("a frame"));
    inconclusive(&single, "1 of at least 8 frames");
    let small = folder.path().join("small");
    write_png_folder(&small, &[(); 8].map(|()| grey(32, 48, 0))).expect("writable");
    inconclusive(&small, "frames of 32 px, 64 px needed");
    if crate::support::has_ffmpeg() {
        inconclusive(&video(folder.path(), "single.mp4", (64, 64), 1), "1 of at least 8 frames");
        inconclusive(&video(folder.path(), "small.mp4", (48, 32), 8), "frames of 32 px, 64 px needed");
    }
}

fn grey(width: u32, height: u32, level: u8) -> Frame {
    Frame::new(width, height, vec![90 + level; (3 * width * height) as usize]).expect("the length fits")
}

/// A video of grey frames.
fn video(folder: &Path, name: &str, (width, height): (u32, u32), frames: u8) -> PathBuf {
    let path = folder.join(name);
    let frames: Vec<Frame> = (0..frames).map(|level| grey(width, height, level)).collect();
    write_video(&path, &frames, &EncodeOptions::default()).expect("encodes");
    path
}

fn ffmpeg(args: &[&str], out: &Path) {
    let mut command = Command::new("ffmpeg");
    let done = command.args(["-hide_banner", "-loglevel", "error"]).args(args).arg(out).status();
    assert!(done.is_ok_and(|status| status.success()), "ffmpeg {args:?}");
}

#[test]
fn receipts_and_keys_must_belong_together() {
    let Some(gpu) = device() else { return };
    let owner = delivered(&gpu);
    let folder = scratch();
    let (clip, key) = (owner.join("out/preview"), owner.join("owner.key"));
    verify(owner, &clip, &[&"--message", &"bits:00000000"]).refused(65, &["receipt.json: message_mac"]);
    verify(owner, &clip, &[&"--message", &"bits:0"]).refused(2, &["message: 1 digits"]);
    let text = fs::read_to_string(owner.join("out/private/receipt.json")).expect("a receipt");
    let forged = put(folder.path(), "receipt.json", text.replacen("\"num_bits\": 8", "\"num_bits\": 9", 1).as_bytes());
    guard4d(&[&"verify", &clip, &"--key", &key, &"--receipt", &forged]).refused(65, &["receipt.json", "commitment"]);
    guard4d(&[&"inspect", &forged]).refused(65, &["receipt.json", "commitment"]);
    let alone = put(folder.path(), "alone.json", text.as_bytes());
    guard4d(&[&"verify", &clip, &"--key", &key, &"--receipt", &alone])
        .refused(66, &["extractor.safetensors: not found"]);
}

#[test]
fn keys_are_shown_without_their_secret() {
    let Some(gpu) = device() else { return };
    let path = delivered(&gpu).join("owner.key");
    let secret = TensorFile::read(&path).expect("a key").text("secret").expect("its secret").to_owned();
    for run in [guard4d(&[&"inspect", &path]), guard4d(&[&"inspect", &path, &"--json"])] {
        run.done();
        assert!(run.stdout.contains("guard4d.key/2") && !run.stdout.contains(&secret), "{}", run.stdout);
    }
}

/// The delivered embedding's private files in a folder of their own, beside which dates can lie.
fn private_copy(owner: &Path, folder: &Path) -> PathBuf {
    for name in ["receipt.json", "extractor.safetensors"] {
        fs::copy(owner.join("out/private").join(name), folder.join(name)).expect("writable");
    }
    folder.join("receipt.json")
}

#[test]
fn a_date_stands_beside_the_verdict_and_a_root_is_paid_for() {
    let Some(gpu) = device() else { return };
    if !has_openssl() {
        return;
    }
    let (owner, folder, authority) = (delivered(&gpu), scratch(), Authority::new(P256, "sha256"));
    let own = private_copy(owner, folder.path());
    let (key, preview, ca) = (owner.join("owner.key"), owner.join("out/preview"), authority.path("ca.pem"));
    let verify = |more: &[&dyn AsRef<OsStr>]| {
        let args: [&dyn AsRef<OsStr>; 6] = [&"verify", &preview, &"--key", &key, &"--receipt", &own];
        guard4d(&[&args[..], more].concat())
    };
    let json = |more: &[&dyn AsRef<OsStr>]| -> serde_json::Value {
        let run = verify(&[more, &[&"--json"]].concat());
        assert_eq!(run.code, 4, "inconclusive, as without a date: {}", run.stderr);
        serde_json::from_str(&run.stdout).expect("JSON on stdout")
    };
    let bare = json(&[]);
    assert!(bare["dated"].is_null() && bare["root"].is_null(), "no date: {bare}");
    verify(&[&"--ca", &ca]).refused(66, &["receipt.tst: not found"]);

    let request = folder.path().join("request.tsq");
    guard4d(&[&"timestamp", &"request", &own, &"--out", &request]).done();
    let response = authority.reply(&request, &[]);
    guard4d(&[&"timestamp", &"attach", &own, &"--response", &response]).done();
    let dated = json(&[&"--ca", &ca]);
    assert_eq!(dated["dated"]["trust"], "checked", "{dated}");
    assert_eq!(dated["evidence"], bare["evidence"], "a date of its own costs nothing");
    let text = verify(&[]).stdout;
    assert!(text.contains("claimed, authority not checked: ") && text.contains("--ca says whom you trust"), "{text}");

    let others: Vec<_> = (0..3).map(|seed| receipt(folder.path(), &format!("r{seed}"), seed)).collect();
    let root = folder.path().join("root.json");
    guard4d(&[&"commit", &own, &others[0], &others[1], &others[2], &"--out", &root]).done();
    guard4d(&[&"timestamp", &"request", &root, &"--out", &request, &"-w"]).done();
    let response = authority.reply(&request, &[]);
    guard4d(&[&"timestamp", &"attach", &root, &"--response", &response, &"--request", &request]).done();
    let under = json(&[&"--root", &root, &"--timestamp", &folder.path().join("root.tst"), &"--ca", &ca]);
    assert_eq!((&under["root"]["receipts"], &under["dated"]["receipts"]), (&4.into(), &4.into()), "{under}");
    let p = |report: &serde_json::Value| report["evidence"]["p_value"]["matches"].as_f64().expect("a number");
    assert!((p(&under) - (4.0 * p(&bare)).min(1.0)).abs() < 1e-12, "paid for: {} and {}", p(&under), p(&bare));
    assert_eq!(under["evidence"]["p_value"]["searched"], 4, "{under}");
    let text = verify(&[&"--root", &root, &"--ca", &ca]).stdout;
    assert!(text.contains("4 receipts are under it") && text.contains("of the best of 4 claims"), "{text}");

    verify(&[&"--timestamp", &response]).refused(65, &["response.tsr: token"]);
    let alone = folder.path().join("alone.json");
    guard4d(&[&"commit", &others[0], &"--out", &alone, &"-w"]).done();
    verify(&[&"--root", &alone]).refused(65, &["alone.json: commitments", "the receipt's, among them"]);
}
