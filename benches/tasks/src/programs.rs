//! Programs that cargo built.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::{Error, Result};
use crate::process::{output, run};
use crate::workspace::Workspace;

/// Builds guard4d as it is shipped; its path.
pub(crate) fn guard4d(workspace: &Workspace) -> Result<PathBuf> {
    workspace.need(&["compiler"])?;
    let options = ["--release", "--locked", "--bin", "guard4d", "--message-format", "json-render-diagnostics"];
    executable(&output(workspace.cargo("build").args(options))?, "guard4d")
}

/// The path of the program `name` in what cargo prints for machines.
pub(crate) fn executable(messages: &str, name: &str) -> Result<PathBuf> {
    let artifacts = messages.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    let path = artifacts
        .filter(|message| message["reason"] == "compiler-artifact" && message["target"]["name"] == name)
        .filter_map(|message| Some(PathBuf::from(message["executable"].as_str()?)))
        .next_back();
    path.ok_or_else(|| Error::Missing(format!("cargo names no program {name}")))
}

/// A program without the names of its functions.
pub(crate) fn strip(from: &Path, to: &Path) -> Result<()> {
    run(Command::new("strip").arg("-o").arg(to).arg(from))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cargo_names_the_program() {
        let messages = r#"{"reason":"compiler-artifact","target":{"name":"tests"},"executable":null}
{"reason":"compiler-artifact","target":{"name":"guard4d"},"executable":"/a/guard4d"}
{"reason":"compiler-artifact","target":{"name":"tests"},"executable":"/a/with \"marks\""}
{"reason":"build-finished","success":true}
"#;
        assert_eq!(executable(messages, "tests").expect("a program"), Path::new("/a/with \"marks\""));
        assert_eq!(executable(messages, "benches").expect_err("none").exit_code(), 69);
    }
}
