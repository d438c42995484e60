//! Programs and packages of others in pinned versions, installed once.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::error::{Naming, Result};
use crate::process::{run, run_aside};
use crate::workspace::empty_folder;

/// Lets `install` fill `folder` with what `list` names, unless it has been done. The stamp is a copy of the list that
/// was installed.
pub(crate) fn install_once(folder: &Path, list: &str, install: impl FnOnce() -> Result<()>) -> Result<()> {
    let stamp = folder.join("installed.txt");
    if fs::read_to_string(&stamp).is_ok_and(|installed| installed == list) {
        return Ok(());
    }
    empty_folder(folder)?;
    install()?;
    fs::write(&stamp, list).of_file(&stamp)
}

/// Makes a Python environment in `folder`. With `system`, a package that the system has in the pinned version is not
/// fetched again.
pub(crate) fn python_environment(folder: &Path, system: bool) -> Result<()> {
    let options: &[&str] = if system { &["--system-site-packages"] } else { &[] };
    run(Command::new("python3").args(["-m", "venv"]).args(options).arg(folder))
}

/// Installs the packages of a list into the Python environment in `folder`.
pub(crate) fn pip_install(folder: &Path, list: &Path) -> Result<()> {
    let options = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"];
    run_aside(Command::new(folder.join("bin/python")).args(options).arg(list))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_installed_once() {
        let parent = tempfile::tempdir().expect("a folder");
        let folder = parent.path().join("tools");
        let mut installs = 0;
        for (list, count) in [("a==1\n", 1), ("a==1\n", 1), ("a==2\n", 2), ("a==1\n", 3)] {
            install_once(&folder, list, || {
                installs += 1;
                assert_eq!(fs::read_dir(&folder).expect("a folder").count(), 0, "nothing is left of another list");
                fs::write(folder.join("a"), list).of_file(&folder)
            })
            .expect("installs");
            assert_eq!(installs, count, "{list}");
        }
    }

    #[test]
    fn what_was_not_installed_is_tried_again() {
        let parent = tempfile::tempdir().expect("a folder");
        let folder = parent.path().join("tools");
        let failed = install_once(&folder, "a", || Err(crate::error::Error::Failed(7)));
        assert_eq!(failed.expect_err("it failed").exit_code(), 7);
        let mut tried = false;
        let again = install_once(&folder, "a", || {
            tried = true;
            Ok(())
        });
        assert!(again.is_ok() && tried, "a failure leaves no stamp");
    }
}
