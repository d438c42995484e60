//! The program itself: exit codes, messages, what goes to stdout, and what is left on disk.

mod cameras;
mod commit;
mod completions;
mod controls;
mod convert;
mod demo;
mod devices;
mod disclose;
mod dump;
mod edits;
mod embed;
mod farm;
mod films;
mod forgery;
mod ids;
mod inputs;
mod interop;
mod isa;
mod keygen;
mod liar;
mod locate;
mod man;
mod models;
mod outputs;
mod owner_chips;
mod pretrain;
mod reference;
mod stamp;
mod study;
mod timestamp;
mod undo;
mod usage;
mod verify;

use std::ffi::OsStr;
use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use guard4d_kernels::vk::Assignment;
use tempfile::TempDir;

use crate::support::names;

/// A hang must fail the test; no start takes this long, not even where other work has the processor.
const PATIENCE: Duration = Duration::from_secs(600);

/// What a run of the program left.
struct Run {
    code: i32,
    stdout: String,
    stderr: String,
}

impl Run {
    /// Fails when the validation layers had something to say; they watch the program as they watch the other tests.
    #[track_caller]
    fn of(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).expect("the program writes UTF-8");
        let run = Self {
            code: output.status.code().expect("the program was not killed"),
            stdout: text(output.stdout),
            stderr: text(output.stderr),
        };
        assert!(!has_validation_error(&run.stderr), "validation errors:\n{}", run.stderr);
        run
    }

    /// Fails unless the program ended with `code`, said all of `words` on stderr, and nothing on stdout.
    #[track_caller]
    fn refused(&self, code: i32, words: &[&str]) {
        assert_eq!(self.code, code, "exit code; stderr:\n{}", self.stderr);
        // Messages are folded to the terminal's width.
        let said: String =
            self.stderr.split_whitespace().filter(|w| !"│×╰─▶├".contains(w)).collect::<Vec<_>>().join(" ");
        for word in words {
            assert!(said.contains(word), "`{word}` is not in:\n{said}");
        }
        assert_eq!(self.stdout, "", "nothing on stdout");
    }

    /// Fails unless the program ended well.
    #[track_caller]
    fn done(&self) {
        assert_eq!(self.code, 0, "stderr:\n{}", self.stderr);
    }
}

/// Whether the log holds an error of the validation layers, in the words of old or new ones.
fn has_validation_error(stderr: &str) -> bool {
    ["Validation Error", "VUID-", "SYNC-HAZARD"].iter().any(|mark| stderr.contains(mark))
}

#[test]
fn validation_errors_of_the_program_fail_a_test() {
    let layers = [
        "2026-01-01T00:00:00Z ERROR Validation Error: [ UNASSIGNED-x ] Object 0: handle = 0x1; | a message",
        "2026-01-01T00:00:00Z ERROR vkCmdDispatch(): a message (https://docs.vulkan.org/#VUID-vkCmdDispatch-None-1)",
        "2026-01-01T00:00:00Z ERROR vkCmdCopyBuffer(): [ SYNC-HAZARD-READ-AFTER-WRITE ] a message",
    ];
    assert!(layers.iter().all(|line| has_validation_error(line)), "what layers write is seen");
    assert!(!has_validation_error("2026-01-01T00:00:00Z ERROR out: cannot create"), "the program's own is not");
    let loud = Command::new("sh").args(["-c", "echo 'ERROR Validation Error: [ VUID-x ]' >&2"]).output();
    let loud = loud.expect("a shell is on every machine that these tests run on");
    assert!(std::panic::catch_unwind(|| Run::of(loud)).is_err(), "a run with such an error is no run");
}

/// The layers watch the program too, or no message of theirs would mean nothing.
#[test]
fn the_layers_watch_the_program_under_test() {
    if crate::support::gpu::watched_device().is_none() {
        return;
    }
    let (folder, model) = (scratch(), crate::support::fixture::TinyModel::new());
    let run = guard4d(&[
        &"lab",
        &"dump",
        &"deform",
        &model.path(),
        &"--time",
        &"0",
        &"--out",
        &folder.path().join("out"),
        &"-v",
    ]);
    run.done();
    assert!(run.stderr.contains("validated=true"), "{}", run.stderr);
}

/// Runs the program.
#[track_caller]
fn guard4d(args: &[&dyn AsRef<OsStr>]) -> Run {
    Run::of(command(args).output().expect("the program was built with the tests"))
}

/// Runs the program without validation layers, for what takes minutes: they watch other tests do the same.
#[track_caller]
fn unwatched(args: &[&dyn AsRef<OsStr>]) -> Run {
    let mut command = command(args);
    Run::of(
        command.env("VK_LOADER_LAYERS_DISABLE", "*validation*").output().expect("the program was built with the tests"),
    )
}

/// Commands that `--help` shows, in its order, but for `help` itself.
fn commands() -> Vec<String> {
    commands_of("")
}

/// Every command that `--help` shows, each followed by its own commands, such as `timestamp check`.
fn all_commands() -> Vec<String> {
    let mut all = Vec::new();
    for command in commands() {
        let below: Vec<_> = commands_of(&command).iter().map(|below| format!("{command} {below}")).collect();
        all.push(command);
        all.extend(below);
    }
    all
}

/// Runs `command`, whose words stand in one string, with one more.
fn ask(command: &str, flag: &str) -> String {
    let words: Vec<&str> = command.split_whitespace().chain([flag]).collect();
    guard4d(&words.iter().map(|word| word as _).collect::<Vec<&dyn AsRef<OsStr>>>()).stdout
}

/// Commands below `command`, or below none.
fn commands_of(command: &str) -> Vec<String> {
    let help = ask(command, "-h");
    let Some((_, list)) = help.split_once("Commands:\n") else { return Vec::new() };
    let lines = list.lines().take_while(|line| !line.is_empty());
    // The text of a command goes on further to the right.
    let names = lines.filter(|line| !line.starts_with("   ")).filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

/// Long names of the flags that `--help` of a command shows, without hyphens before them.
fn flags(command: &str) -> Vec<String> {
    let help = ask(command, "--help");
    // Texts, which can begin with the name of another flag, stand further to the right.
    let entries = help.lines().filter(|line| !line.starts_with("       ") && line.trim_start().starts_with('-'));
    let names = entries.filter_map(|line| line.split("--").nth(1)).map(|name| {
        let is_name = |c: &char| c.is_ascii_alphanumeric() || *c == '-';
        name.chars().take_while(is_name).collect::<String>()
    });
    names.collect()
}

/// The program, to be started.
fn command(args: &[&dyn AsRef<OsStr>]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_guard4d"));
    command.args(args.iter().map(|a| a.as_ref())).env_remove("RUST_LOG").env("NO_COLOR", "1");
    // What a scheduler says to the tests is not meant for the program under test.
    for name in Assignment::variables() {
        command.env_remove(name);
    }
    command
}

/// Starts the program and sends `signal` as soon as `ready`: to it and its children, as a terminal does.
fn interrupted(mut command: Command, signal: &str, ready: impl Fn() -> bool) -> Run {
    command.process_group(0).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("the program was built with the tests");
    let started = Instant::now();
    while !ready() {
        assert!(started.elapsed() < PATIENCE, "the moment to interrupt never came");
        assert_eq!(child.try_wait().expect("a child"), None, "the program ended by itself");
        std::thread::sleep(Duration::from_millis(5));
    }
    // The shell's own `kill`; the program of that name is not on every machine.
    let sent = Command::new("sh").args(["-c", &format!("kill -s {signal} -- -{}", child.id())]).status();
    assert!(sent.is_ok_and(|s| s.success()), "the signal was sent");
    Run::of(child.wait_with_output().expect("a child"))
}

/// Whether an output `name` of `folder` has been begun.
fn is_begun(folder: &Path, name: &str) -> bool {
    names(folder).iter().any(|found| found.starts_with(&format!(".{name}.partial")))
}

/// A folder for one test's outputs.
fn scratch() -> TempDir {
    tempfile::tempdir().expect("a temporary folder can be made")
}

/// Writes `bytes` to a file of `folder`.
fn put(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().expect("the path has a folder")).expect("a temporary folder is writable");
    fs::write(&path, bytes).expect("a temporary folder is writable");
    path
}
