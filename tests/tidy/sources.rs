//! The repository's files as the rules read them.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::support::files_below;

/// Folders of handwritten Rust.
const RUST_TREES: [&str; 6] = ["cli", "engine/src", "kernels/build", "kernels/src", "tests", "benches"];

pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All files under `tree` (relative to the repository) whose extension is in `extensions`, sorted.
pub(super) fn files(tree: &str, extensions: &[&str]) -> Vec<PathBuf> {
    let folder = root().join(tree);
    let wanted = |path: &PathBuf| path.extension().is_some_and(|e| extensions.iter().any(|x| e == *x));
    files_below(&folder).into_iter().filter(wanted).map(|path| folder.join(path)).collect()
}

pub(super) fn rust_files() -> Vec<PathBuf> {
    let mut all: Vec<_> = RUST_TREES.iter().flat_map(|t| files(t, &["rs"])).collect();
    all.push(root().join("kernels/build.rs"));
    all
}

/// Rust that is shipped or measured with: all but tests and build scripts.
pub(super) fn product_files() -> Vec<PathBuf> {
    let kept = |path: &PathBuf| !["tests/", "kernels/build"].iter().any(|folder| name(path).starts_with(folder));
    rust_files().into_iter().filter(kept).collect()
}

pub(super) fn shaders() -> Vec<PathBuf> {
    files("glsl", &["comp", "glsl"])
}

pub(super) fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The path from the repository on.
pub(super) fn name(path: &Path) -> String {
    let inside = path.strip_prefix(root()).unwrap_or(path);
    inside.display().to_string()
}

/// The line without its `//` comment. A `//` inside a string is cut too, which only hides text.
pub(super) fn code(line: &str) -> &str {
    line.split("//").next().unwrap_or(line)
}

/// Whether `word` stands in `line` as a whole identifier.
pub(super) fn has_word(line: &str, word: &str) -> bool {
    line.match_indices(word).any(|(at, _)| {
        let inside = |c: char| c.is_alphanumeric() || c == '_';
        !line[..at].ends_with(inside) && !line[at + word.len()..].starts_with(inside)
    })
}

/// `file:line` of every code line of `paths` that `breaks` the rule.
pub(super) fn offences(paths: &[PathBuf], breaks: impl Fn(&str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for path in paths {
        for (i, line) in text(path).lines().enumerate() {
            if breaks(line) {
                found.push(format!("{}:{}: {}", name(path), i + 1, line.trim()));
            }
        }
    }
    found
}

#[track_caller]
pub(super) fn assert_none(rule: &str, found: &[String]) {
    assert!(found.is_empty(), "{rule}:\n  {}", found.join("\n  "));
}

/// The syntax tree of a file. What `cargo` compiles can be parsed.
pub(super) fn parsed(path: &Path) -> syn::File {
    syn::parse_file(&text(path)).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Whether an item is there for unit tests alone: `#[cfg(test)]`.
pub(super) fn is_for_tests(attributes: &[syn::Attribute]) -> bool {
    let test = |list: &syn::MetaList| list.parse_args::<syn::Path>().is_ok_and(|path| path.is_ident("test"));
    attributes.iter().any(|a| a.path().is_ident("cfg") && a.meta.require_list().is_ok_and(test))
}

/// Folders with a `lib.rs` or a `main.rs` among `files`: where crates begin. Paths are relative to the repository.
pub(super) fn crate_folders(files: &[String]) -> BTreeSet<String> {
    let ends = ["/lib.rs", "/main.rs"];
    files.iter().filter_map(|file| ends.iter().find_map(|end| file.strip_suffix(end))).map(str::to_owned).collect()
}

/// The innermost of `folders` that `file` lies in.
pub(super) fn crate_of<'a>(file: &str, folders: &'a BTreeSet<String>) -> Option<&'a str> {
    let inside = |folder: &&String| file.strip_prefix(folder.as_str()).is_some_and(|rest| rest.starts_with('/'));
    folders.iter().filter(inside).max_by_key(|folder| folder.len()).map(String::as_str)
}
