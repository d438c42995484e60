//! `guard4d completions`: every command and flag that `--help` shows, and no other.

use std::process::Command;

use super::{commands, flags, guard4d, put, scratch};

/// The script for a shell.
fn script(shell: &str) -> String {
    let run = guard4d(&[&"completions", &shell]);
    run.done();
    assert_eq!(run.stderr, "", "the script alone");
    run.stdout
}

/// What stands between `start` and the next `end`, of all places where that begins.
fn parts<'a>(script: &'a str, start: &str, end: &str) -> Vec<&'a str> {
    script.split(start).skip(1).map(|rest| rest.split(end).next().unwrap_or(rest)).collect()
}

#[test]
fn bash_completes_every_command_and_flag() {
    let script = script("bash");
    for command in commands() {
        let listed = parts(&script, &format!("guard4d__subcmd__{command})"), ";;").concat();
        for flag in flags(&command) {
            assert!(listed.contains(&format!("--{flag}")), "{command} --{flag}:\n{listed}");
        }
    }
    let folder = scratch();
    let file = put(folder.path(), "guard4d.bash", script.as_bytes());
    match Command::new("bash").arg("-n").arg(&file).output() {
        Ok(checked) => assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr)),
        Err(error) => crate::support::skipped(&format!("bash: {error}")),
    }
}

#[test]
fn zsh_completes_every_command_and_flag() {
    let script = script("zsh");
    for command in commands() {
        let listed = parts(&script, &format!("({command})\n"), "\n;;").concat();
        for flag in flags(&command) {
            let is_listed = [format!("--{flag}["), format!("--{flag}=[")].iter().any(|entry| listed.contains(entry));
            assert!(is_listed, "{command} --{flag}:\n{listed}");
        }
    }
}

#[test]
fn fish_completes_every_command_and_flag() {
    let script = script("fish");
    for command in commands() {
        // Of a command with commands of its own, as long as none of these has been named.
        let starts = ["\"", "; and not "].map(|end| format!("__fish_guard4d_using_subcommand {command}{end}"));
        let listed = starts.map(|start| parts(&script, &start, "\n").join("\n")).join("\n");
        for flag in flags(&command) {
            assert!(listed.lines().any(|line| line.contains(&format!("-l {flag}"))), "{command} --{flag}:\n{listed}");
        }
    }
}

#[test]
fn what_help_hides_is_not_completed() {
    for shell in ["bash", "zsh", "fish"] {
        let script = script(shell);
        // `render --as reference` is a value, and completed.
        let hidden = ["wrong-key", "guard4d__reference", "page of the reference"];
        assert!(hidden.iter().all(|hidden| !script.contains(hidden)), "{shell}:\n{script}");
    }
    guard4d(&[&"completions", &"cmd.exe"]).refused(2, &["bash", "fish", "zsh"]);
}
