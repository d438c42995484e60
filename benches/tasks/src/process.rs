//! Other programs, run to their end.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};

use crate::error::{Error, Naming, Result};

/// The exit code as shells tell it: 128 and the signal's number where a signal ended the program.
pub(crate) fn code(status: ExitStatus) -> u8 {
    let code = status.code().or_else(|| status.signal().map(|signal| 128 + signal));
    code.and_then(|code| u8::try_from(code).ok()).unwrap_or(1)
}

fn name(command: &Command) -> String {
    command.get_program().to_string_lossy().into_owned()
}

/// An error where an exit code says so.
pub(crate) fn succeeded(code: u8) -> Result<()> {
    if code == 0 { Ok(()) } else { Err(Error::Failed(code)) }
}

/// Runs a program and returns its exit code.
pub(crate) fn exit_code(command: &mut Command) -> Result<u8> {
    Ok(code(command.status().of_program(&name(command))?))
}

/// Runs a program, which must succeed.
pub(crate) fn run(command: &mut Command) -> Result<()> {
    succeeded(exit_code(command)?)
}

/// The same with its standard output on standard error: progress, not a result.
pub(crate) fn run_aside(command: &mut Command) -> Result<()> {
    run(command.stdout(io::stderr()))
}

/// What a program, which must succeed, prints.
pub(crate) fn output(command: &mut Command) -> Result<String> {
    let out = command.stderr(Stdio::inherit()).output().of_program(&name(command))?;
    succeeded(code(out.status))?;
    Ok(String::from_utf8_lossy(&out.stdout).into_owned())
}

/// Gives a program a text to read.
pub(crate) fn feed(command: &mut Command, text: &str) -> Result<()> {
    let program = name(command);
    let mut child = command.stdin(Stdio::piped()).spawn().of_program(&program)?;
    if let Some(mut stdin) = child.stdin.take() {
        stdin.write_all(text.as_bytes()).of_program(&program)?;
    }
    succeeded(code(child.wait().of_program(&program)?))
}

/// Lets one program read what another writes; both must succeed.
pub(crate) fn pipe(from: &mut Command, into: &mut Command) -> Result<()> {
    let mut source = from.stdout(Stdio::piped()).spawn().of_program(&name(from))?;
    let read = match source.stdout.take() {
        Some(stdout) => exit_code(into.stdin(stdout)),
        None => exit_code(into),
    };
    let wrote = code(source.wait().of_program(&name(from))?);
    succeeded(read?)?;
    succeeded(wrote)
}

/// Runs a program, with all that it prints on standard output and in the file `log`; returns its exit code.
pub(crate) fn tee(command: &mut Command, log: &Path) -> Result<u8> {
    tee_into(&mut io::stdout(), command, log)
}

fn tee_into(shown: &mut impl Write, command: &mut Command, log: &Path) -> Result<u8> {
    let program = name(command);
    let (mut reader, writer) = io::pipe().of_program(&program)?;
    let mut file = File::create(log).of_file(log)?;
    command.stdout(writer.try_clone().of_program(&program)?).stderr(writer);
    let mut child = command.spawn().of_program(&program)?;
    // The command holds the pipe's other end, and while anybody does, the reading below does not end.
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let mut buffer = [0; 8192];
    loop {
        let read = reader.read(&mut buffer).of_program(&program)?;
        if read == 0 {
            break;
        }
        file.write_all(&buffer[..read]).of_file(log)?;
        shown.write_all(&buffer[..read]).and_then(|()| shown.flush()).of_file(Path::new("standard output"))?;
    }
    Ok(code(child.wait().of_program(&program)?))
}

/// Runs a program, with all that it prints in the file `log` alone; returns its exit code.
pub(crate) fn log(command: &mut Command, log: &Path) -> Result<u8> {
    let file = File::create(log).of_file(log)?;
    let again = file.try_clone().of_file(log)?;
    exit_code(command.stdout(file).stderr(again))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        command
    }

    #[test]
    fn exit_codes_are_those_of_shells() {
        for (script, code) in [("exit 0", 0), ("exit 3", 3), ("kill -TERM $$", 143)] {
            assert_eq!(exit_code(&mut shell(script)).expect("sh runs"), code, "{script}");
        }
        let missing = run(&mut Command::new("guard4d-no-such-program")).expect_err("there is none");
        assert_eq!(missing.exit_code(), 69, "{missing}");
        assert!(missing.to_string().contains("guard4d-no-such-program"), "{missing}");
    }

    #[test]
    fn both_programs_of_a_pipe_must_succeed() {
        let piped = |from, into| pipe(&mut shell(from), &mut shell(into)).map_err(|e| e.exit_code());
        assert_eq!(piped("echo a", "grep -q a"), Ok(()));
        assert_eq!(piped("echo a; exit 4", "grep -q a"), Err(4), "the first one failed");
        assert_eq!(piped("echo a", "cat >/dev/null; exit 5"), Err(5), "the second one failed");
    }

    #[test]
    fn a_log_holds_both_outputs() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("log");
        let read = || std::fs::read_to_string(&path).expect("a log");
        let mut shown = Vec::new();
        let code = tee_into(&mut shown, &mut shell("echo out; echo err >&2; exit 6"), &path).expect("sh runs");
        assert_eq!((code, read()), (6, "out\nerr\n".to_owned()));
        assert_eq!(shown, read().as_bytes(), "both were shown");
        let code = log(&mut shell("echo out again; echo err >&2; exit 7"), &path).expect("sh runs");
        assert_eq!((code, read()), (7, "out again\nerr\n".to_owned()));
    }

    #[test]
    fn texts_are_given_and_taken() {
        let folder = tempfile::tempdir().expect("a folder");
        feed(shell("cat >text").current_dir(folder.path()), "a b\n").expect("cat reads");
        let text = output(shell("cat text").current_dir(folder.path())).expect("cat writes");
        assert_eq!(text, "a b\n");
    }
}
