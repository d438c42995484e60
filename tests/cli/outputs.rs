//! Outputs appear whole or not at all.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use guard4d_engine::media::{ReadOptions, read_clip};
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::scene::ply;

use super::{Run, command, guard4d, interrupted, is_begun, names, put, scratch};
use crate::support::fixture::{TinyModel, gaussians};
use crate::support::gpu::device;
use crate::support::owner::{delivered, key_file};
use crate::support::skipped_unless_required;

#[test]
fn what_exists_is_kept_unless_asked() {
    if device().is_none() {
        return;
    }
    let (folder, tiny) = (scratch(), TinyModel::new());
    let model = tiny.path();
    let out = put(folder.path(), "out.safetensors", b"precious");
    let dump = [&"lab" as &dyn AsRef<OsStr>, &"dump", &"deform", &model, &"--time", &"0", &"--out", &out];
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
    let copy = folder.path().join("copy");
    let attack: [&dyn AsRef<OsStr>; 6] = [&"attack", &frames, &"--apply", &"jpeg:50,rotation:-5", &"--out", &copy];
    guard4d(&attack).done();
    assert_eq!(names(&copy), ["00000.png", "00001.png"], "as many frames");
    let picture = |folder: &Path| fs::read(folder.join("00000.png")).expect("readable");
    assert!(picture(&copy) != picture(&frames), "and other ones");
    guard4d(&attack).refused(73, &["copy: cannot create", "it exists"]);
    guard4d(&[&"attack", &frames, &"--apply", &"jpeg:500", &"--out", &copy, &"-w"])
        .refused(2, &["jpeg", "from 1 to 100"]);
    assert_eq!(names(&copy), ["00000.png", "00001.png"], "untouched");
    fs::remove_dir_all(&copy).expect("removable");
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

#[test]
fn a_static_capture_is_filmed_where_it_lies() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let mut far = gaussians(8, 0, 1);
    for (mean, scale) in far.means.iter_mut().zip(&mut far.scales) {
        *mean = mean.map(|v| v.clamp(-0.1, 0.1) + 30.0);
        *scale = [-3.0; 3];
    }
    far.opacities.fill(3.0);
    let model = put(folder.path(), "far.ply", &ply::encode(&far));
    let filmed = |out: &str, flags: &[&str]| {
        let frames = folder.path().join(out);
        let mut args: Vec<&dyn AsRef<OsStr>> = vec![&"render", &model, &"--size", &"32x32", &"--frames", &"1"];
        args.extend(["--orbit", "1", "--out"].iter().map(|flag| flag as &dyn AsRef<OsStr>));
        args.push(&frames);
        args.extend(flags.iter().map(|flag| flag as &dyn AsRef<OsStr>));
        guard4d(&args).done();
        read_clip(&frames, &ReadOptions::default()).expect("a film").frames()[0].rgb().to_vec()
    };
    let background = filmed("origin", &["--target=0,0,0", "--radius", "4"]);
    assert!(background.iter().all(|v| *v == background[0]), "nothing is seen from around the origin");
    let found = filmed("found", &[]);
    let seen = |film: &[u8]| film.iter().zip(&background).filter(|(a, b)| a != b).count();
    // A sphere that touches the frame's sides covers 0.79 of it; these splats are few, with room between them.
    assert!(seen(&found) > found.len() / 10, "{} of {} values", seen(&found), found.len());
    let small = filmed("told", &["--radius", "9"]);
    assert!(seen(&small) > 0 && 4 * seen(&small) < seen(&found), "from far off: {} values", seen(&small));
    let out = folder.path().join("none");
    for point in ["1,2", "a,b,c"] {
        guard4d(&[&"render", &model, &"--out", &out, &"--target", &point]).refused(2, &["three numbers"]);
    }
    guard4d(&[&"render", &model, &"--out", &out, &"--radius", &"0"]).refused(2, &["radius: 0"]);
    assert!(!out.exists(), "no output, whole or partial");
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
    guard4d(&[&"lab", &"dump", &"deform", &model.path(), &"--time", &"0", &"--out", &out])
        .refused(73, &["out: cannot create"]);
    assert_eq!(names(folder.path()), ["file"], "nothing is written");
}

/// Mounts a small file system at a folder, runs the program, and lists what it left there.
const ON_DISK: &str = "disk=$1; shift
    mount -t tmpfs -o \"$0\" tmpfs \"$disk\" || exit 99
    trap 'umount \"$disk\"' EXIT
    \"$@\"; code=$?; ls -A \"$disk\"; exit $code";
/// Ways to the right to mount: in a namespace that goes with it, as root, or through sudo without a password.
const MAY_MOUNT: [&[&str]; 3] = [&["unshare", "--user", "--map-root-user", "--mount"], &[], &["sudo", "-n"]];

/// The words of a shell command that runs `program` with its settings; sudo keeps little of the environment.
fn words_of(program: &Command) -> Vec<OsString> {
    let (mut unset, mut set) = (vec![OsString::from("env")], Vec::new());
    for (name, value) in program.get_envs() {
        match value {
            Some(value) => set.push([name, value].join(OsStr::new("="))),
            None => unset.extend([OsString::from("-u"), name.to_owned()]),
        }
    }
    let rest = std::iter::once(program.get_program()).chain(program.get_args());
    unset.into_iter().chain(set).chain(rest.map(OsStr::to_owned)).collect()
}

/// Runs the program with a small file system of its own mounted at `disk`, and lists what it left there. `None`, with
/// the reason printed, where this user may not mount; where nothing may be skipped that is a failure.
fn on_disk(disk: &Path, options: &str, args: &[&dyn AsRef<OsStr>]) -> Option<Run> {
    let program = words_of(&command(args));
    let run = |way: &[&str]| {
        let mut words: Vec<&OsStr> = way.iter().map(OsStr::new).collect();
        words.extend(["sh", "-c", ON_DISK, options].map(OsStr::new));
        words.push(disk.as_os_str());
        words.extend(program.iter().map(OsString::as_os_str));
        Command::new(words[0]).args(&words[1..]).output().ok()
    };
    // 99 is the mount's failure, 1 that of `unshare` or `sudo` itself.
    let went = |o: &Output| o.status.code().is_some_and(|code| code != 99 && code != 1);
    let ran = MAY_MOUNT.into_iter().find_map(|way| run(way).filter(went));
    if ran.is_none() {
        skipped_unless_required("this user may mount nothing: neither in a namespace, nor as root, nor through sudo");
    }
    ran.map(Run::of)
}

/// Permission bits stop every user but root, so root becomes nobody; the program and its inputs are copied to where
/// nobody may read.
#[test]
fn a_place_without_permission_is_told() {
    let folder = scratch();
    let path = folder.path();
    let program = path.join("guard4d");
    // By another process: a file that this one has open for writing cannot be started by a fork of its other threads.
    let copied = Command::new("cp").arg(env!("CARGO_BIN_EXE_guard4d")).arg(&program).status();
    assert!(copied.is_ok_and(|status| status.success()), "there is room for a copy");
    let locked = path.join("locked");
    fs::create_dir(&locked).expect("writable");
    let model = put(path, "model.ply", &ply::encode(&gaussians(3, 1, 3)));
    let secret = put(path, "secret.ply", &ply::encode(&gaussians(3, 1, 3)));
    for (place, mode) in [(path, 0o755), (&program, 0o755), (&locked, 0o555), (&model, 0o644), (&secret, 0o000)] {
        fs::set_permissions(place, fs::Permissions::from_mode(mode)).expect("our own files");
    }
    let may_write_anywhere = fs::write(locked.join("probe"), b"").is_ok();
    if may_write_anywhere {
        fs::remove_file(locked.join("probe")).expect("written a moment ago");
    }
    let run = |args: &[&dyn AsRef<OsStr>]| {
        let mut words = words_of(&command(args));
        let at = words.iter().position(|word| word == env!("CARGO_BIN_EXE_guard4d")).expect("the program");
        words[at] = program.clone().into_os_string();
        let nobody = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"];
        let mut outer = Command::new(if may_write_anywhere { nobody[0] } else { "env" });
        if may_write_anywhere {
            outer.args(&nobody[1..]).arg("env");
        }
        outer.args(&words[1..]).output().ok().map(Run::of)
    };
    if run(&[&"--version"]).is_none_or(|run| run.code != 0) {
        skipped_unless_required("root cannot become nobody here");
        return;
    }
    let refused = |args: &[&dyn AsRef<OsStr>], code: i32, words: &[&str]| {
        run(args).expect("it ran a moment ago").refused(code, &[words, &["Permission denied"]].concat());
    };
    let out = locked.join("out");
    refused(&[&"keygen", &"--out", &out], 73, &["out: cannot create"]);
    refused(&[&"embed", &model, &"--key", &"none.key", &"--out", &out], 73, &["out: cannot create"]);
    refused(&[&"inspect", &secret], 74, &["secret.ply"]);
    assert_eq!(names(&locked), [""; 0], "nothing is written");
}

#[test]
fn a_read_only_place_is_told() {
    let Some(gpu) = device() else { return };
    let (folder, tiny) = (scratch(), TinyModel::new());
    let (disk, model) = (folder.path(), tiny.path());
    let out = disk.join("out");
    let words = ["out: cannot create", "Read-only file system"];
    let render: [&dyn AsRef<OsStr>; 4] = [&"render", &model, &"--out", &out];
    let Some(run) = on_disk(disk, "ro", &render) else { return };
    run.refused(73, &words);
    let owner = delivered(&gpu);
    let (marked, undo) = (owner.join("out/marked"), owner.join("out/private/undo.safetensors"));
    let commands: [&[&dyn AsRef<OsStr>]; 4] = [
        &[&"undo", &marked, &"--undo", &undo, &"--out", &out],
        &[&"lab", &"dump", &"deform", &model, &"--time", &"0", &"--out", &out],
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
    let scene = guard4d_engine::scene::demo::DemoScene::unpack().expect("the scene unpacks");
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let key = put(folder.path(), "owner.key", &key_file(&clip).to_bytes().expect("serialises"));
    let small = put(folder.path(), "small.ply", &ply::encode(&gaussians(60, 1, 3)));
    let disk = folder.path().join("disk");
    fs::create_dir(&disk).expect("writable");
    let (out, video) = (disk.join("out"), disk.join("out.mp4"));
    let dump: &[&dyn AsRef<OsStr>] = &[&"lab", &"dump", &"deform", &scene.path(), &"--time", &"0", &"--out", &out];
    let frames: &[&dyn AsRef<OsStr>] =
        &[&"render", &scene.path(), &"--orbit", &"1", &"--frames", &"2", &"--crf", &"0", &"--out"];
    let settings = "--extractor none --train-clips 2 --probes 8 --steps 1 --size 32x32 --orbit 1 --frames 1";
    let mut embed: Vec<&dyn AsRef<OsStr>> = vec![&"embed", &small, &"--key", &key, &"--quiet", &"--out", &out];
    let settings: Vec<&str> = settings.split(' ').collect();
    embed.extend(settings.iter().map(|word| word as &dyn AsRef<OsStr>));
    let owner = delivered(&gpu);
    let (marked, undo) = (owner.join("out/marked"), owner.join("out/private/undo.safetensors"));
    let restore: &[&dyn AsRef<OsStr>] = &[&"undo", &marked, &"--undo", &undo, &"--out", &out];
    // Without a file left to make, the key is refused before its half minute of work.
    let keygen: &[&dyn AsRef<OsStr>] = &[&"keygen", &"--out", &out];
    let mut commands = vec![
        (74, "size=16k", embed),
        (74, "size=64k", dump.to_vec()),
        (74, "size=64k", [frames, &[&out]].concat()),
        (74, "size=64k", restore.to_vec()),
        (73, "nr_inodes=1", keygen.to_vec()),
    ];
    if crate::support::has_ffmpeg() {
        commands.push((74, "size=4k", [frames, &[&video]].concat()));
    }
    for (code, options, args) in commands {
        let Some(run) = on_disk(&disk, options, &args) else { return };
        // A trained embedding's checkpoint may fit where its output does not, and is worth keeping.
        let left = run.stdout.replace("out.checkpoint.safetensors\n", "");
        assert_eq!(left, "", "nothing is left");
        Run { stdout: left, ..run }.refused(code, &["No space left on device"]);
    }
}

#[test]
fn an_interrupted_render_leaves_nothing() {
    if device().is_none() {
        return;
    }
    let (folder, tiny) = (scratch(), TinyModel::new());
    let model = tiny.path();
    let outputs = if crate::support::has_ffmpeg() { &["frames", "film.mp4"][..] } else { &["frames"] };
    for name in outputs {
        let out = folder.path().join(name);
        // Far more frames than are filmed before the signal arrives.
        let many: [&dyn AsRef<OsStr>; 6] = [&"--orbit", &"1000", &"--frames", &"8", &"--size", &"64x64"];
        let render = command(&[&[&"render" as &dyn AsRef<OsStr>, &model, &"--out", &out], &many[..]].concat());
        let run = interrupted(render, "INT", || is_begun(folder.path(), name));
        run.refused(75, &["interrupted; nothing was written"]);
        assert_eq!(names(folder.path()), [""; 0], "{name}: no output, whole or partial");
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

#[test]
fn a_film_is_drawn_as_a_viewer_draws_it() {
    let Some(_gpu) = device() else { return };
    let folder = scratch();
    let model = put(folder.path(), "scene.ply", &ply::encode(&gaussians(40, 1, 1)));
    let filmed = |name: &str, flags: &[&str]| {
        let out = folder.path().join(name);
        let render: [&dyn AsRef<OsStr>; 8] = [&"render", &model, &"--size", &"48x48", &"--orbit", &"1", &"--out", &out];
        let flags: Vec<&dyn AsRef<OsStr>> = flags.iter().map(|flag| flag as &dyn AsRef<OsStr>).collect();
        guard4d(&[&render[..], &flags].concat()).done();
        read_clip(&out, &ReadOptions::default()).expect("a film").frames()[0].rgb().to_vec()
    };
    let plain = filmed("plain", &[]);
    assert!(plain == filmed("reference", &["--as", "reference"]), "the reference is what is drawn anyway");
    assert!(plain != filmed("playcanvas", &["--as", "playcanvas"]), "others draw otherwise");
    assert!(plain == filmed("set-alike", &["--dilation", "0.3", "--sh-degree", "3"]), "the reference's own settings");
    for (name, flags) in [("thin", ["--dilation", "0"]), ("flat", ["--sh-degree", "0"])] {
        assert!(plain != filmed(name, &flags), "{name} splats look otherwise");
    }
    let out = folder.path().join("none");
    let refused: [(&str, &str, &[&str]); 4] = [
        ("--as", "polycam", &["reference, gsplat"]),
        ("--dilation", "-0.1", &["--dilation", "from 0 to 100"]),
        ("--dilation", "NaN", &["--dilation", "from 0 to 100"]),
        ("--sh-degree", "4", &["--sh-degree", "0..=3"]),
    ];
    for (flag, value, words) in refused {
        let given = format!("{flag}={value}");
        guard4d(&[&"render", &model, &"--out", &out, &given]).refused(2, words);
    }
}
