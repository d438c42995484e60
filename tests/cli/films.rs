//! Films on the command line: which frames are read, framed pictures, codecs, and what is said where ffmpeg is missing.

use std::path::{Path, PathBuf};

use guard4d_engine::media::{ReadOptions, read_clip};

use super::controls::{Film, Rigged};
use super::{Run, command, guard4d, names, put, scratch};
use crate::media::ffmpeg;
use crate::support::gpu::device;

/// How far a film's logits are from zero, so that what resampling and codecs do to its features is less.
const CLEAR_MARGIN: f32 = 12.0;

/// The marked film of 64 px put into a larger frame, without loss.
fn framed(rigged: &Rigged, folder: &Path, name: &str, filter: &str) -> PathBuf {
    let film = folder.join(name);
    let frames = rigged.file("suspect");
    ffmpeg(&format!("-i {}/%05d.png -vf {filter} -c:v ffv1 -pix_fmt bgr0", frames.display()), &film);
    film
}

#[test]
fn a_marked_film_is_found_between_bars_and_in_a_known_part() {
    let Some(gpu) = device() else { return };
    if !crate::support::has_ffmpeg() {
        return;
    }
    let (rigged, folder) = (Rigged::get(&gpu), scratch());
    let plain = rigged.verify(0, &[]);
    assert_eq!(plain["clips"][0]["cut"], serde_json::Value::Null, "nothing is cut unless asked for");
    // Green bars: the scene itself is rendered over black, which is no bar.
    let letterbox = framed(rigged, folder.path(), "letterbox.mkv", "pad=64:96:0:16:color=0x206040");
    let pillarbox = framed(rigged, folder.path(), "pillarbox.mkv", "pad=120:64:28:0:color=0x206040");
    let corner = framed(rigged, folder.path(), "corner.mkv", "pad=100:90:30:5");
    for (film, crop, cut) in [
        (&letterbox, "auto", [0, 16, 64, 64]),
        (&letterbox, "0,16,64,64", [0, 16, 64, 64]),
        (&pillarbox, "auto", [28, 0, 64, 64]),
        (&corner, "30,5,64,64", [30, 5, 64, 64]),
    ] {
        let report = rigged.judge(film, 0, &[&"--crop", &crop]);
        let [x, y, width, height] = cut;
        let want = serde_json::json!({ "x": x, "y": y, "width": width, "height": height });
        assert_eq!(report["clips"][0]["cut"], want, "{}", film.display());
        // The same pixels, hence the same evidence to the last digit: a crop is no search.
        assert_eq!(report["evidence"]["p_value"], plain["evidence"]["p_value"], "{}", film.display());
    }
    // Uncut, the picture that CLIP sees is another: this extractor, whose margins are tiny, reads nothing.
    for film in [&letterbox, &pillarbox, &corner] {
        let run = rigged.verify_film(film, &rigged.file("owner.key"), &[]);
        assert!([1, 4].contains(&run.code), "{}: {}{}", film.display(), run.stdout, run.stderr);
    }
    let told = rigged.verify_film(&letterbox, &rigged.file("owner.key"), &[&"--crop", &"auto"]);
    assert!(
        told.stdout.contains("64 x 64 px at (0, 16): ") && told.stderr.is_empty(),
        "{}{}",
        told.stdout,
        told.stderr
    );
    let none = rigged.verify_with(&rigged.file("owner.key"), &[&"--crop", &"auto"]);
    assert!(none.code == 0 && none.stderr.contains("no bars found"), "{}{}", none.stdout, none.stderr);
    rigged
        .verify_film(&letterbox, &rigged.file("owner.key"), &[&"--crop", &"0,40,64,64"])
        .refused(2, &["part of a frame: 64 x 64 px at (0, 40)", "a part of 64 x 96 px"]);
}

/// What happens to films on their way: enlarged, stretched, put between bars and coded with loss.
#[test]
fn a_marked_film_is_found_after_resizing_bars_and_lossy_codecs() {
    let Some(gpu) = device() else { return };
    if !crate::support::has_ffmpeg() {
        return;
    }
    let (rigged, folder) =
        (Rigged::filmed(&gpu, "random", 16, Film { margin: CLEAR_MARGIN, size: "64x64" }), scratch());
    let frames = rigged.file("suspect");
    let copy = |name: &str, filter: &str, codec: &str| {
        let film = folder.path().join(name);
        let tags = "-colorspace bt709 -color_primaries bt709 -color_trc bt709 -color_range tv";
        let matrix = "scale=out_color_matrix=bt709:out_range=tv";
        ffmpeg(&format!("-i {}/%05d.png -vf {filter},{matrix} {codec} {tags}", frames.display()), &film);
        film
    };
    let h264 = "-c:v libx264 -crf 18 -pix_fmt yuv420p";
    let vp9 = "-c:v libvpx-vp9 -crf 24 -b:v 0 -pix_fmt yuv420p";
    let enlarged = copy("enlarged.mp4", "scale=200:200:flags=bicubic", h264);
    let stretched = copy("stretched.webm", "scale=320:180:flags=bicubic", vp9);
    let letterbox = copy("letterbox.mp4", "scale=160:160:flags=bicubic,pad=160:240:0:40:color=0x206040", h264);
    // Exact, for a verdict alone would be weak: an extractor of such margins calls other films of this scene present,
    // too.
    let exact = |film: &Path, more: &[&dyn AsRef<std::ffi::OsStr>]| {
        let report = rigged.judge(film, 0, more);
        assert_eq!(report["clips"][0]["matches"], 16, "{}", film.display());
        report["clips"][0]["cut"].clone()
    };
    exact(&enlarged, &[]);
    exact(&stretched, &[]);
    exact(&stretched, &[&"--picture-size", &"180x180"]);
    let cut = exact(&letterbox, &[&"--crop", &"auto"]);
    let want = serde_json::json!({ "x": 0, "y": 40, "width": 160, "height": 160 });
    assert_eq!(cut, want, "bars are found to the line");
    let uncut = rigged.verify_film(&letterbox, &rigged.file("owner.key"), &[&"--json"]);
    let report: serde_json::Value = serde_json::from_str(&uncut.stdout).expect("JSON on stdout");
    assert!(report["clips"][0]["matches"].as_u64() < Some(16), "bars hide some of the mark: {report}");
}

#[test]
fn enlarging_a_film_does_not_make_it_large_enough() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::get(&gpu);
    let small: [&dyn AsRef<std::ffi::OsStr>; 4] = [&"--crop", &"0,0,40,40", &"--picture-size", &"64x64"];
    let run = rigged.verify_with(&rigged.file("owner.key"), &small);
    assert!(run.code == 4 && run.stdout.contains("frames of 40 px, 64 px needed"), "{}{}", run.stdout, run.stderr);
    let same = rigged.verify(0, &[&"--picture-size", &"64x64"]);
    assert_eq!(same["evidence"]["p_value"], rigged.verify(0, &[])["evidence"]["p_value"], "its own size");
}

#[test]
fn verify_reads_the_frames_that_are_asked_for() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::get(&gpu);
    let frames = |more: &[&dyn AsRef<std::ffi::OsStr>]| {
        let run = rigged.verify_with(&rigged.file("owner.key"), &[more, &[&"--json"]].concat());
        let report: serde_json::Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
        report["frames"].as_u64()
    };
    assert_eq!(frames(&[]), Some(8), "all");
    assert_eq!(frames(&[&"--every", &"3"]), Some(3), "0, 3 and 6");
    assert_eq!(frames(&[&"--start", &"5"]), Some(3), "5, 6 and 7");
    assert_eq!(frames(&[&"--start", &"1", &"--every", &"2", &"--max-frames", &"2"]), Some(2), "1 and 3");
    let beyond = rigged.verify_with(&rigged.file("owner.key"), &[&"--start", &"8"]);
    beyond.refused(65, &["suspect: frames: none from number 8 on"]);
}

#[test]
fn attack_passes_chosen_frames_into_lossless_video() {
    let Some(gpu) = device() else { return };
    if !crate::support::has_ffmpeg() {
        return;
    }
    let (rigged, folder) = (Rigged::get(&gpu), scratch());
    let (film, out) = (rigged.file("suspect"), folder.path().join("copy.mkv"));
    let frames = ["--start", "2", "--every", "3", "--max-frames", "2", "--codec", "ffv1"];
    let frames: Vec<&dyn AsRef<std::ffi::OsStr>> = frames.iter().map(|word| word as _).collect();
    let attack: [&dyn AsRef<std::ffi::OsStr>; 6] = [&"attack", &film, &"--apply", &"identity", &"--out", &out];
    guard4d(&[&attack[..], &frames[..]].concat()).done();
    let read = |path: &Path| read_clip(path, &ReadOptions::default()).expect("a film").frames().to_vec();
    let all = read(&film);
    assert_eq!(read(&out), [all[2].clone(), all[5].clone()], "frames 2 and 5, sample by sample");
    let pngs = folder.path().join("pngs");
    let args: [&dyn AsRef<std::ffi::OsStr>; 8] =
        [&"attack", &film, &"--apply", &"identity", &"--codec", &"ffv1", &"--out", &pngs];
    guard4d(&args).refused(2, &["--codec: ffv1 for a folder", ".mp4, .mov, .mkv or .webm"]);
    assert_eq!(names(folder.path()), ["copy.mkv"], "nothing else is written");
}

#[test]
fn flags_of_films_are_checked_before_any_work() {
    let folder = scratch();
    let film = folder.path().join("film");
    let attack = |out: &str, more: &[&dyn AsRef<std::ffi::OsStr>]| -> Run {
        let out = folder.path().join(out);
        let args: [&dyn AsRef<std::ffi::OsStr>; 6] = [&"attack", &film, &"--apply", &"identity", &"--out", &out];
        guard4d(&[&args[..], more].concat())
    };
    for (flag, value, word) in [
        ("--every", "0", "--every"),
        ("--max-frames", "0", "--max-frames"),
        ("--start", "-1", "--start"),
        ("--codec", "divx", "h264, h265, av1, vp9, ffv1"),
    ] {
        let run = attack("out", &[&format!("{flag}={value}")]);
        assert!(run.code == 2 && run.stderr.contains(word), "{flag} {value}: {}", run.stderr);
    }
    let verify: [&dyn AsRef<std::ffi::OsStr>; 6] = [&"verify", &film, &"--key", &film, &"--receipt", &film];
    for (flag, value) in
        [("--crop", "1,2,3"), ("--crop", "1,2,0,3"), ("--picture-size", "0x9"), ("--picture-size", "9")]
    {
        let run = guard4d(&[&verify[..], &[&flag, &value]].concat());
        assert!(run.code == 2 && run.stderr.contains(flag), "{flag} {value}: {}", run.stderr);
    }
    assert_eq!(names(folder.path()), [""; 0], "nothing is written");
}

#[test]
fn without_ffmpeg_pictures_are_read_and_videos_are_refused_with_a_way_out() {
    let Some(gpu) = device() else { return };
    let (rigged, folder) = (Rigged::get(&gpu), scratch());
    let video = put(folder.path(), "film.mp4", b"any");
    let run = |args: &[&dyn AsRef<std::ffi::OsStr>]| {
        let mut command = command(args);
        command.env("GUARD4D_FFMPEG", "/nowhere/ffmpeg").env("GUARD4D_FFPROBE", "/nowhere/ffprobe");
        Run::of(command.output().expect("the program was built with the tests"))
    };
    let (suspect, key) = (rigged.file("suspect"), rigged.file("owner.key"));
    let receipt = rigged.file("private").join("receipt.json");
    let way_out = "not found; install ffmpeg, set GUARD4D_FFMPEG and GUARD4D_FFPROBE, or use a folder of PNG frames";
    run(&[&"verify", &suspect, &"--key", &key, &"--receipt", &receipt]).done();
    run(&[&"verify", &video, &"--key", &key, &"--receipt", &receipt]).refused(69, &["/nowhere/ffprobe", way_out]);
    let out = folder.path().join("out.webm");
    run(&[&"attack", &suspect, &"--apply", &"identity", &"--out", &out]).refused(69, &["/nowhere/ffmpeg", way_out]);
    assert_eq!(names(folder.path()), ["film.mp4"], "no unfinished film is left");
}
