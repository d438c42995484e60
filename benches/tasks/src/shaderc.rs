//! `./x shaderc`: every shader through the other compiler, and what the host sees of both.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Args;

use crate::error::{Error, Naming, Result};
use crate::process::{feed, output, run as run_program};
use crate::workspace::{Workspace, say};

/// Compile every shader with shaderc too, and compare what the host sees of it
#[derive(Args)]
pub(crate) struct ShadercArgs {}

/// The archive that holds shaderc alone.
const COMBINED: &str = "libshaderc_combined.a";

/// With it, its neighbours make a library that links. Newer releases of glslang have fewer of them.
const ARCHIVES: [&str; 9] = [
    "shaderc_combined",
    "glslang",
    "MachineIndependent",
    "GenericCodeGen",
    "OSDependent",
    "OGLCompiler",
    "SPIRV",
    "SPIRV-Tools-opt",
    "SPIRV-Tools",
];

/// Runs clippy with shaderc, and compares the registries that both compilers lead to.
pub(crate) fn run(workspace: &Workspace, _: &ShadercArgs) -> Result<()> {
    let library = system_library(workspace)?;
    let clippy = || {
        let mut command = workspace.cargo("clippy");
        // The one crate whose shaders are compiled; what stands on it is the same with either compiler.
        command.args(["--package", "guard4d-kernels", "--locked"]);
        if let Some(folder) = &library {
            command.env("SHADERC_LIB_DIR", folder);
        }
        command
    };
    say("clippy, with shaders compiled by shaderc");
    run_program(clippy().args(["--features", "shaderc", "--", "-D", "warnings"]))?;
    say("one registry from both compilers");
    let messages = ["--quiet", "--message-format", "json"];
    let by_glslang = registry(&output(clippy().args(messages))?)?;
    let by_shaderc = registry(&output(clippy().args(messages).args(["--features", "shaderc"]))?)?;
    compare(&by_glslang, &by_shaderc)
}

/// Debian's shaderc, made whole. Debian 12's shared library lacks glslang and does not load, and its "combined" archive
/// holds shaderc alone. `None` where another choice, a folder or the Vulkan SDK, has been made.
fn system_library(workspace: &Workspace) -> Result<Option<PathBuf>> {
    let chosen = |name| env::var_os(name).is_some_and(|value| !value.is_empty());
    if chosen("SHADERC_LIB_DIR") || chosen("VULKAN_SDK") {
        return Ok(None);
    }
    workspace.need(&["compiler", "shaderc"])?;
    let folder = workspace.path("target/shaderc");
    fs::create_dir_all(&folder).of_file(&folder)?;
    let installed = installed(Path::new("/usr/lib"))?;
    feed(Command::new("ar").arg("-M").current_dir(&folder), &script(&installed))?;
    Ok(Some(folder))
}

/// The folder below `libraries` that has the archives.
fn installed(libraries: &Path) -> Result<PathBuf> {
    let entries = fs::read_dir(libraries).of_file(libraries)?;
    let mut folders: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    folders.retain(|folder| folder.join(COMBINED).exists());
    folders.sort();
    folders.into_iter().next().ok_or_else(|| Error::Missing(format!("{COMBINED} is missing")))
}

/// What `ar` is told: put all archives into one.
fn script(archives: &Path) -> String {
    let paths = ARCHIVES.map(|name| archives.join(format!("lib{name}.a")));
    let added = paths.iter().filter(|path| path.exists()).map(|path| format!("addlib {}\n", path.display()));
    format!("create {COMBINED}\n{}save\n", added.collect::<String>())
}

/// The path of the registry that the build script of the kernels wrote, from what cargo prints for machines.
fn registry(messages: &str) -> Result<PathBuf> {
    let messages = messages.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    let folder = messages
        .filter(|message| message["reason"] == "build-script-executed")
        .filter(|message| message["package_id"].as_str().is_some_and(|id| id.contains("#guard4d-kernels@")))
        .filter_map(|message| Some(PathBuf::from(message["out_dir"].as_str()?)))
        .next_back();
    let path = folder.map(|folder| folder.join("registry.rs")).filter(|path| path.is_file());
    path.ok_or_else(|| Error::Missing("cargo names no registry of guard4d-kernels".to_owned()))
}

fn compare(one: &Path, other: &Path) -> Result<()> {
    if one == other {
        return Err(Error::Missing("both registries are the same file".to_owned()));
    }
    let [first, second] = [one, other].map(|path| fs::read(path).of_file(path));
    if first? == second? {
        return Ok(());
    }
    Err(Error::Differs(format!("{} and {} differ", one.display(), other.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn archives_that_are_there_are_put_together() {
        let libraries = tempfile::tempdir().expect("a folder");
        assert!(installed(libraries.path()).is_err(), "nothing is installed");
        let folder = libraries.path().join("x86_64-linux-gnu");
        fs::create_dir(&folder).expect("a folder");
        for name in ["shaderc_combined", "SPIRV"] {
            fs::write(folder.join(format!("lib{name}.a")), "").expect("a file");
        }
        assert_eq!(installed(libraries.path()).expect("a folder"), folder);
        let here = folder.display();
        let want = format!("create {COMBINED}\naddlib {here}/{COMBINED}\naddlib {here}/libSPIRV.a\nsave\n");
        assert_eq!(script(&folder), want);
    }

    #[test]
    fn registries_are_found_and_compared() {
        let folder = tempfile::tempdir().expect("a folder");
        let message = |package: &str| {
            let about = serde_json::json!({
                "reason": "build-script-executed", "package_id": package, "out_dir": folder.path(),
            });
            about.to_string()
        };
        let ours = message("path+file:///a/kernels#guard4d-kernels@0.1.0");
        assert!(registry(&ours).is_err(), "no registry was written");
        let path = folder.path().join("registry.rs");
        fs::write(&path, "a").expect("a file");
        assert_eq!(registry(&ours).expect("a registry"), path);
        assert!(registry(&message("registry+https://index#blake3@1.8.0")).is_err(), "another package");
        let other = folder.path().join("other.rs");
        fs::write(&other, "a").expect("a file");
        assert!(compare(&path, &other).is_ok(), "equal");
        fs::write(&other, "b").expect("a file");
        assert_eq!(compare(&path, &other).expect_err("they differ").exit_code(), 1);
        assert!(compare(&path, &path).is_err(), "one file proves nothing");
    }
}
