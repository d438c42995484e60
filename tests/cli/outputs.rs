//! Outputs appear whole or not at all.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_engine::scene::ply;

use super::{Run, command, guard4d, names, put, scratch};
use crate::scene::fixture::{TinyModel, gaussians};
use crate::support::gpu::device;
use crate::support::owner::key_file;

#[test]
fn what_exists_is_kept_unless_asked() {
    if device().is_none() {
        return;
    }
    let (folder, tiny) = (scratch(), TinyModel::new());
    let model = tiny.path();
    let out = put(folder.path(), "out.safetensors", b"precious");
    let dump = [&"dump" as &dyn AsRef<OsStr>, &"deform", &model, &"--time", &"0", &"--out", &out];
    guard4d(&dump).refused(73, &["out.safetensors: cannot create", "it exists; --overwrite replaces it"]);
    assert_eq!(fs::read(&out).expect("readable"), b"precious", "untouched");
    guard4d(&[&dump[..], &[&"--overwrite"]].concat()).done();
    assert!(fs::read(&out).expect("readable") != b"precious", "replaced");
    let frames = folder.path().join("frames");
    put(&frames, "mine.txt", b"precious");
    let small: [&dyn AsRef<OsStr>; 6] = [&"--orbit", &"1", &"--frames", &"2", &"--size", &"32x32"];
    let render = [&[&"render" as &dyn AsRef<OsStr>, &model, &"--out", &frames], &small[..]].concat();
    guard4d(&render).refused(73, &["frames: cannot create", "it exists"]);
    assert_eq!(names(&frames), ["mine.txt"], "untouched");
    guard4d(&[&render[..], &[&"-w"]].concat()).done();
    assert_eq!(names(&frames), ["00000.png", "00001.png"], "replaced as a whole");
    let video = put(folder.path(), "clip.mp4", b"precious");
    guard4d(&[&[&"render" as &dyn AsRef<OsStr>, &model, &"--out", &video], &small[..]].concat())
        .refused(73, &["clip.mp4: cannot create", "it exists"]);
    let marked = folder.path().join("marked");
    put(&marked, "mine.txt", b"precious");
    guard4d(&[&"embed", &model, &"--key", &"none.key", &"--out", &marked]).refused(73, &["marked: cannot create"]);
    let key = put(folder.path(), "owner.key", b"precious");
    guard4d(&[&"keygen", &"--out", &key]).refused(73, &["owner.key: cannot create", "it exists"]);
    guard4d(&[&"demo", &"--out", &marked]).refused(73, &["marked: cannot create", "it exists"]);
    assert_eq!(
        (fs::read(&key).expect("readable"), names(&marked)),
        (b"precious".to_vec(), vec!["mine.txt".to_owned()])
    );
    let left = ["clip.mp4", "frames", "marked", "out.safetensors", "owner.key"];
    assert_eq!(names(folder.path()), left, "no partial output is left");
    if crate::support::has_ffmpeg() {
        let over: [&dyn AsRef<OsStr>; 5] = [&"render", &model, &"-w", &"--out", &video];
        guard4d(&[&over[..], &small[..]].concat()).done();
        assert!(fs::read(&video).expect("readable").len() > 100, "the video is replaced");
        assert_eq!(names(folder.path()), left, "nothing beside it");
    }
}

/// Permission bits do not stop root, so a file stands where a folder is needed.
#[test]
fn a_place_that_cannot_be_written_is_told() {
    if device().is_none() {
        return;
    }
    let (folder, model) = (scratch(), TinyModel::new());
    let file = put(folder.path(), "file", b"");
    let out = file.join("out");
    guard4d(&[&"render", &model.path(), &"--out", &out]).refused(73, &["out: cannot create"]);
    guard4d(&[&"keygen", &"--bits", &"8", &"--out", &out.join("owner.key")]).refused(73, &["owner.key: cannot create"]);
    guard4d(&[&"dump", &"deform", &model.path(), &"--time", &"0", &"--out", &out]).refused(73, &["out: cannot create"]);
    assert_eq!(names(folder.path()), ["file"], "nothing is written");
}

/// Runs the program with a small file system of its own mounted at `disk`, and lists what it left there. The mount lives
/// in a namespace and goes with it. `None`, with the reason printed, where this user may not mount.
fn on_disk(disk: &Path, options: &str, args: &[&dyn AsRef<OsStr>]) -> Option<Run> {
    let script = "mount -t tmpfs -o \"$0\" tmpfs \"$1\" || exit 99
        disk=$1; shift; \"$@\"; code=$?; ls -A \"$disk\"; exit $code";
    let program = command(args);
    let mut outer = Command::new("unshare");
    outer.args(["--user", "--map-root-user", "--mount", "sh", "-c", script, options]).arg(disk);
    outer.arg(program.get_program()).args(program.get_args());
    for (name, value) in program.get_envs() {
        match value {
            Some(value) => outer.env(name, value),
            None => outer.env_remove(name),
        };
    }
    // 99 is the mount's failure, 1 that of `unshare` itself.
    let ran = outer.output().ok().filter(|o| o.status.code().is_some_and(|code| code != 99 && code != 1));
    if ran.is_none() {
        crate::support::skipped("this user may not mount a small file system");
    }
    ran.map(Run::of)
}

#[test]
fn a_read_only_place_is_told() {
    if device().is_none() {
        return;
    }
    let (folder, tiny) = (scratch(), TinyModel::new());
    let (disk, model) = (folder.path(), tiny.path());
    let out = disk.join("out");
    let words = ["out: cannot create", "Read-only file system"];
    let render: [&dyn AsRef<OsStr>; 4] = [&"render", &model, &"--out", &out];
    let Some(run) = on_disk(disk, "ro", &render) else { return };
    run.refused(73, &words);
    let commands: [&[&dyn AsRef<OsStr>]; 3] = [
        &[&"dump", &"deform", &model, &"--time", &"0", &"--out", &out],
        &[&"embed", &model, &"--key", &"none.key", &"--out", &out],
        &[&"keygen", &"--out", &out],
    ];
    for args in commands {
        on_disk(disk, "ro", args).expect("it was mounted a moment ago").refused(73, &words);
    }
    let video = disk.join("out.mp4");
    let args: [&dyn AsRef<OsStr>; 4] = [&"render", &model, &"--out", &video];
    on_disk(disk, "ro", &args).expect("it was mounted a moment ago").refused(73, &["out.mp4: cannot create"]);
}

#[test]
fn a_full_disk_leaves_nothing_behind() {
    let Some(gpu) = device() else { return };
    let folder = scratch();
    let scene = guard4d_engine::demo::Scene::unpack().expect("the scene unpacks");
    let clip = Clip::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let key = put(folder.path(), "owner.key", &key_file(&clip).to_bytes().expect("serialises"));
    let small = put(folder.path(), "small.ply", &ply::encode(&gaussians(60, 1, 3)));
    let disk = folder.path().join("disk");
    fs::create_dir(&disk).expect("writable");
    let (out, video) = (disk.join("out"), disk.join("out.mp4"));
    let dump: &[&dyn AsRef<OsStr>] = &[&"dump", &"deform", &scene.path(), &"--time", &"0", &"--out", &out];
    let frames: &[&dyn AsRef<OsStr>] =
        &[&"render", &scene.path(), &"--orbit", &"1", &"--frames", &"2", &"--crf", &"0", &"--out"];
    let settings = "--extractor none --train-clips 2 --responses 8 --steps 1 --size 32x32 --orbit 1 --frames 1";
    let mut embed: Vec<&dyn AsRef<OsStr>> = vec![&"embed", &small, &"--key", &key, &"--quiet", &"--out", &out];
    let settings: Vec<&str> = settings.split(' ').collect();
    embed.extend(settings.iter().map(|word| word as &dyn AsRef<OsStr>));
    let mut commands = vec![("16k", embed), ("64k", dump.to_vec()), ("64k", [frames, &[&out]].concat())];
    if crate::support::has_ffmpeg() {
        commands.push(("4k", [frames, &[&video]].concat()));
    }
    for (size, args) in commands {
        let Some(run) = on_disk(&disk, &format!("size={size}"), &args) else { return };
        // A trained embedding's checkpoint may fit where its output does not, and is worth keeping.
        let left = run.stdout.replace("out.checkpoint.safetensors\n", "");
        assert_eq!(left, "", "nothing is left");
        Run { stdout: left, ..run }.refused(74, &["No space left on device"]);
    }
}

#[test]
fn results_that_cannot_be_printed_are_an_error() {
    let Ok(full) = fs::File::options().write(true).open("/dev/full") else {
        crate::support::skipped("there is no /dev/full");
        return;
    };
    let model = TinyModel::new();
    let mut command = command(&[&"inspect", &model.path()]);
    let run =
        Run::of(command.stdout(full).stderr(Stdio::piped()).spawn().and_then(Child::wait_with_output).expect("runs"));
    run.refused(74, &["stdout", "No space left on device"]);
}
