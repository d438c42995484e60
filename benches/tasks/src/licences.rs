//! Licences of the crates that are compiled into guard4d, whose texts have to go along with it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::error::{Error, Naming, Result};
use crate::process::output;
use crate::workspace::Workspace;

/// What is packed runs there alone, and crates for other systems are no part of it.
const TARGET: &str = "x86_64-unknown-linux-gnu";

/// How files with licences and notices begin, in capitals.
const NAMES: [&str; 6] = ["LICENSE", "LICENCE", "COPYING", "COPYRIGHT", "NOTICE", "UNLICENSE"];

/// Licences that may be told by name where a crate brings no text: the packages hold both of them.
const OURS: [&str; 2] = ["MIT", "Apache-2.0"];

const HEAD: &str = "\
guard4d contains the crates below, which others wrote. Behind each stands its licence, as the crate's
authors declare it, and their names. The texts that the crates bring follow. Texts of MIT and
Apache-2.0 that a crate does not bring itself are in LICENSE-MIT and LICENSE-APACHE beside this file.
";

/// A crate of others.
#[derive(Debug)]
struct Crate {
    /// Name and version.
    name: String,
    licence: String,
    authors: Vec<String>,
    folder: PathBuf,
}

/// All crates that the program `guard4d` contains, their licences and the texts of these.
pub(crate) fn third_party(workspace: &Workspace) -> Result<String> {
    let options = ["--locked", "--format-version", "1", "--filter-platform", TARGET];
    let told = output(workspace.cargo("metadata").args(options))?;
    let crates = contained(&told).ok_or_else(|| Error::Missing("cargo does not name guard4d's crates".to_owned()))?;
    let mut texts = BTreeMap::<String, Vec<String>>::new();
    for one in &crates {
        let found = texts_of(one)?;
        if found.is_empty() && !OURS.iter().any(|name| one.licence.contains(name)) {
            return Err(Error::Missing(format!("{} is under {} and brings no text of it", one.name, one.licence)));
        }
        for text in found {
            texts.entry(text).or_default().push(one.name.clone());
        }
    }
    Ok(page(&crates, texts))
}

/// The crates of others that guard4d is linked with, sorted. What runs at build time alone, macros among it, is not in
/// the program.
fn contained(metadata: &str) -> Option<Vec<Crate>> {
    let all: Value = serde_json::from_str(metadata).ok()?;
    let packages: BTreeMap<_, _> = all["packages"].as_array()?.iter().map(|p| (p["id"].as_str(), p)).collect();
    let nodes: BTreeMap<_, _> = all["resolve"]["nodes"].as_array()?.iter().map(|n| (n["id"].as_str(), n)).collect();
    let is_guard4d = |package: &&&Value| package["name"] == "guard4d" && package["source"].is_null();
    let mut waiting = vec![packages.values().find(is_guard4d)?["id"].as_str()];
    let (mut seen, mut found) = (BTreeSet::new(), Vec::new());
    while let Some(id) = waiting.pop() {
        let package = packages.get(&id)?;
        if !seen.insert(id) || is_macro(package) {
            continue;
        }
        let links = |dependency: &&Value| {
            let kinds = dependency["dep_kinds"].as_array();
            kinds.is_some_and(|kinds| kinds.iter().any(|kind| kind["kind"].is_null()))
        };
        waiting.extend(nodes.get(&id)?["deps"].as_array()?.iter().filter(links).map(|d| d["pkg"].as_str()));
        if !package["source"].is_null() {
            found.push(described(package)?);
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Some(found)
}

fn is_macro(package: &Value) -> bool {
    let of_kind = |target: &Value| target["kind"].as_array().is_some_and(|kinds| kinds.contains(&"proc-macro".into()));
    package["targets"].as_array().is_some_and(|targets| targets.iter().any(of_kind))
}

fn described(package: &Value) -> Option<Crate> {
    let authors = package["authors"].as_array()?.iter().filter_map(Value::as_str);
    // Addresses are nobody's business here.
    let bare = authors.map(|author| author.split(" <").next().unwrap_or(author).to_owned());
    Some(Crate {
        name: format!("{} {}", package["name"].as_str()?, package["version"].as_str()?),
        licence: package["license"].as_str().unwrap_or("the text below").to_owned(),
        authors: bare.collect(),
        folder: Path::new(package["manifest_path"].as_str()?).parent()?.to_owned(),
    })
}

/// What the files of a crate say about its licence.
fn texts_of(one: &Crate) -> Result<BTreeSet<String>> {
    let mut found = BTreeSet::new();
    for entry in fs::read_dir(&one.folder).of_file(&one.folder)? {
        let path = entry.of_file(&one.folder)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
        if path.is_file() && NAMES.iter().any(|start| name.starts_with(start)) && !name.ends_with(".RS") {
            let text = String::from_utf8_lossy(&fs::read(&path).of_file(&path)?).replace('\r', "");
            let lines: Vec<_> = text.trim_matches('\n').lines().map(str::trim_end).collect();
            found.insert(lines.join("\n"));
        }
    }
    Ok(found)
}

/// The crates, then each text once, under the names of the crates that bring it.
fn page(crates: &[Crate], texts: BTreeMap<String, Vec<String>>) -> String {
    let mut page = HEAD.to_owned() + "\n";
    for one in crates {
        page += &format!("{}: {}", one.name, one.licence);
        if !one.authors.is_empty() {
            page += &format!("; {}", one.authors.join(", "));
        }
        page.push('\n');
    }
    let mut texts: Vec<_> = texts.into_iter().map(|(text, names)| (names, text)).collect();
    texts.sort();
    for (names, text) in texts {
        page += &format!("\n{}\n{}\n\n{text}\n", "=".repeat(80), names.join(", "));
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What cargo tells of guard4d, which is linked with `a`, takes `m` for a macro and `b` for its build.
    fn metadata(folder: &Path, licence: &str) -> String {
        let package = |name: &str, source: Value, kind: &str| {
            serde_json::json!({
                "id": name, "name": name, "version": "1.0.0", "license": licence, "source": source,
                "authors": ["An Author <address>"], "manifest_path": folder.join(name).join("Cargo.toml"),
                "targets": [{ "kind": [kind] }],
            })
        };
        let needs = |name: &str, kind: Value| serde_json::json!({ "pkg": name, "dep_kinds": [{ "kind": kind }] });
        let none = Vec::<Value>::new();
        let own = [needs("a", Value::Null), needs("b", "build".into()), needs("m", Value::Null)];
        serde_json::json!({
            "packages": [
                package("guard4d", Value::Null, "bin"), package("a", "registry".into(), "lib"),
                package("b", "registry".into(), "lib"), package("m", "registry".into(), "proc-macro"),
            ],
            "resolve": { "nodes": [
                { "id": "guard4d", "deps": own }, { "id": "a", "deps": none },
                { "id": "b", "deps": none }, { "id": "m", "deps": none },
            ] },
        })
        .to_string()
    }

    #[test]
    fn what_is_linked_is_told() {
        let crates = contained(&metadata(Path::new("/c"), "MIT")).expect("crates");
        let [one] = &crates[..] else { panic!("{crates:?}") };
        assert_eq!((one.name.as_str(), one.folder.as_path()), ("a 1.0.0", Path::new("/c/a")));
        assert_eq!(one.authors, ["An Author"], "and no address");
        assert!(contained("{}").is_none(), "cargo says nothing");
    }

    #[test]
    fn each_text_stands_once() {
        let parent = tempfile::tempdir().expect("a folder");
        let mut texts = BTreeMap::<String, Vec<String>>::new();
        let mut crates = contained(&metadata(parent.path(), "BSD-3-Clause")).expect("crates");
        let one = crates.pop().expect("a crate");
        fs::create_dir(&one.folder).expect("a folder");
        for (name, text) in [("LICENSE-BSD", "terms \r\n"), ("licence.txt", "terms\n"), ("license.rs", "fn f() {}")] {
            fs::write(one.folder.join(name), text).expect("a file");
        }
        for text in texts_of(&one).expect("a folder") {
            texts.entry(text).or_default().push(one.name.clone());
        }
        let page = page(&[one], texts);
        assert!(page.contains("\na 1.0.0: BSD-3-Clause; An Author\n"), "{page}");
        assert!(page.ends_with("\na 1.0.0\n\nterms\n"), "{page}");
        assert_eq!(page.matches("terms").count(), 1, "{page}");
    }
}
