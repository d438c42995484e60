//! No circle of imports between files, those of `mod.rs`, `lib.rs` and `main.rs` included.

use std::collections::{BTreeMap, BTreeSet};

use syn::buffer::{Cursor, TokenBuffer};
use syn::visit::{self, Visit};

use super::sources::{assert_none, crate_folders, crate_of, is_for_tests, name, product_files, text};

/// Where a file stands in its crate: `["media", "clip"]` for `media/clip.rs`, `["media"]` for `media/mod.rs`.
type Module = Vec<String>;

/// The files of one crate.
#[derive(Default)]
struct Crate {
    files: BTreeMap<Module, File>,
}

struct File {
    /// From the crate's folder on.
    name: String,
    text: String,
}

/// Imports of each file: which other file, and by what path.
pub(super) type Arrows = BTreeMap<String, BTreeMap<String, String>>;

impl Crate {
    /// Takes in a file by its path from the crate's folder on.
    fn add(&mut self, name: &str, text: String) {
        let stem = name.strip_suffix(".rs").unwrap_or(name);
        let mut module: Module = stem.split('/').map(str::to_owned).collect();
        let face = match module.as_slice() {
            [root] => root == "lib" || root == "main",
            [.., last] => last == "mod",
            [] => false,
        };
        if face {
            module.pop();
        }
        let file = File { name: name.to_owned(), text };
        assert!(self.files.insert(module, file).is_none(), "{name} has the place of another file");
    }

    /// The file that an absolute path leads into: that of the longest beginning that is a module with a file. A name
    /// that a face hands on is so an import of the face.
    fn file_of(&self, path: &[String]) -> &File {
        let mut beginnings = (0..=path.len()).rev().map(|n| &path[..n]);
        beginnings.find_map(|module| self.files.get(module)).expect("a crate has a lib.rs or a main.rs")
    }

    fn arrows(&self) -> Arrows {
        let mut all = Arrows::new();
        for (module, file) in &self.files {
            let tree = syn::parse_file(&file.text).unwrap_or_else(|e| panic!("{}: {e}", file.name));
            let mut found = Paths { files: &self.files, module: module.clone(), absolute: Vec::new() };
            found.visit_file(&tree);
            let out = all.entry(file.name.clone()).or_default();
            for path in found.absolute {
                let target = self.file_of(&path);
                if target.name != file.name {
                    out.entry(target.name.clone()).or_insert_with(|| path.join("::"));
                }
            }
        }
        all
    }
}

/// All paths of a file that lead into its own crate, from the crate's root on.
struct Paths<'a> {
    files: &'a BTreeMap<Module, File>,
    /// The module that the visitor is in; inline ones count.
    module: Module,
    absolute: Vec<Vec<String>>,
}

impl Paths<'_> {
    fn take(&mut self, path: &[String]) {
        let [first, rest @ ..] = path else { return };
        let mut from = self.module.clone();
        match first.as_str() {
            "crate" => from.clear(),
            "self" => {}
            "super" => {
                from.pop();
                let mut rest = rest;
                while let Some(further) = rest.strip_prefix(&["super".to_owned()]) {
                    from.pop();
                    rest = further;
                }
                return self.absolute.push([&from, rest].concat());
            }
            child => {
                from.push(child.to_owned());
                if !self.files.contains_key(&from) {
                    return;
                }
            }
        }
        self.absolute.push([&from, rest].concat());
    }

    fn take_tree(&mut self, before: &[String], tree: &syn::UseTree) {
        let with = |ident: &syn::Ident| [before, &[ident.to_string()]].concat();
        match tree {
            syn::UseTree::Path(path) => self.take_tree(&with(&path.ident), &path.tree),
            syn::UseTree::Name(name) => self.take(&with(&name.ident)),
            syn::UseTree::Rename(rename) => self.take(&with(&rename.ident)),
            syn::UseTree::Glob(_) => self.take(before),
            syn::UseTree::Group(group) => group.items.iter().for_each(|item| self.take_tree(before, item)),
        }
    }

    /// Paths among the words of a macro, which stand there before anything is parsed.
    fn take_tokens(&mut self, mut at: Cursor<'_>) {
        let mut path = Vec::new();
        while !at.eof() {
            if let Some((ident, next)) = at.ident() {
                path.push(ident.to_string());
                match colons(next) {
                    Some(behind) if behind.ident().is_some() => at = behind,
                    _ => {
                        self.take_long(&std::mem::take(&mut path));
                        at = next;
                    }
                }
            } else if let Some((inside, _, _, next)) = at.any_group() {
                self.take_long(&std::mem::take(&mut path));
                self.take_tokens(inside);
                at = next;
            } else {
                at = at.token_tree().expect("not the end").1;
            }
        }
    }

    /// A path in code: one name alone is a variable, a keyword or what an import has brought.
    fn take_long(&mut self, path: &[String]) {
        if path.len() > 1 {
            self.take(path);
        }
    }
}

/// What follows `::`.
fn colons(at: Cursor<'_>) -> Option<Cursor<'_>> {
    let (first, next) = at.punct()?;
    let (second, behind) = next.punct()?;
    (first.as_char() == ':' && second.as_char() == ':').then_some(behind)
}

impl<'ast> Visit<'ast> for Paths<'_> {
    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        if item.leading_colon.is_none() {
            self.take_tree(&[], &item.tree);
        }
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if is_for_tests(&item.attrs) {
            return;
        }
        self.module.push(item.ident.to_string());
        visit::visit_item_mod(self, item);
        self.module.pop();
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.leading_colon.is_none() {
            self.take_long(&path.segments.iter().map(|s| s.ident.to_string()).collect::<Vec<_>>());
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &'ast syn::Macro) {
        self.take_tokens(TokenBuffer::new2(item.tokens.clone()).begin());
        visit::visit_macro(self, item);
    }

    /// `pub(in crate::x)` says who may look, and looks at nothing itself.
    fn visit_vis_restricted(&mut self, _: &'ast syn::VisRestricted) {}
}

/// Everything that can be reached from `from` over one arrow or more.
fn reached<'a>(arrows: &'a Arrows, from: &str) -> BTreeSet<&'a str> {
    let mut found = BTreeSet::new();
    let next = |file: &str| arrows.get(file).into_iter().flat_map(|out| out.keys().map(String::as_str));
    let mut waiting: Vec<&str> = next(from).collect();
    while let Some(file) = waiting.pop() {
        if found.insert(file) {
            waiting.extend(next(file));
        }
    }
    found
}

/// Each set of files that all reach one another, with the arrows among them.
fn circles(arrows: &Arrows) -> Vec<String> {
    let reach: BTreeMap<&str, BTreeSet<&str>> = arrows.keys().map(|f| (f.as_str(), reached(arrows, f))).collect();
    let mut found = Vec::new();
    let mut told = BTreeSet::new();
    for (file, out) in &reach {
        if !out.contains(file) || told.contains(file) {
            continue;
        }
        let members: BTreeSet<&str> = out.iter().copied().filter(|other| reach[other].contains(file)).collect();
        let mut lines = vec![format!("a circle of {} files", members.len())];
        for member in &members {
            let inside = arrows[*member].iter().filter(|(target, _)| members.contains(target.as_str()));
            lines.extend(inside.map(|(target, path)| format!("    {member} → {target} ({path})")));
        }
        told.extend(members);
        found.push(lines.join("\n"));
    }
    found
}

/// The imports within each crate of the product, by the crate's folder.
pub(super) fn arrows_of_crates() -> BTreeMap<String, Arrows> {
    let paths = product_files();
    let folders = crate_folders(&paths.iter().map(|path| name(path)).collect::<Vec<_>>());
    let mut crates = BTreeMap::<&str, Crate>::new();
    for path in &paths {
        let shown = name(path);
        let folder = crate_of(&shown, &folders).unwrap_or_else(|| panic!("{shown} belongs to no crate"));
        crates.entry(folder).or_default().add(&shown[folder.len() + 1..], text(path));
    }
    crates.into_iter().map(|(folder, files)| (folder.to_owned(), files.arrows())).collect()
}

#[test]
fn files_import_in_no_circle() {
    let crates = arrows_of_crates();
    let expected = ["benches", "benches/full_size", "benches/lab/src", "cli", "engine/src", "kernels/src"];
    assert!(expected.iter().all(|folder| crates.contains_key(*folder)), "crates are found: {:?}", crates.keys());
    assert!(crates["engine/src"].values().map(BTreeMap::len).sum::<usize>() > 500, "imports are found");
    let mut found = Vec::new();
    for (folder, arrows) in &crates {
        found.extend(circles(arrows).into_iter().map(|circle| format!("{folder}: {circle}")));
    }
    assert_none("imports between files run one way", &found);
}

/// A crate of these files.
fn of(files: &[(&str, &str)]) -> Arrows {
    let mut all = Crate::default();
    files.iter().for_each(|(name, text)| all.add(name, (*text).to_owned()));
    all.arrows()
}

#[test]
fn every_way_to_name_a_file_is_an_import() {
    for text in [
        "use crate::a::b::Thing;",
        "use super::b::{Other as Thing, *};",
        "use {super::super::a::b, std::fs};",
        "fn f() -> super::b::Thing { body() }",
        "fn f() { let x = crate::a::b::Thing { y: 1 }; }",
        "fn f() { println!(\"{}\", super::b::thing(1)); }",
        "impl<T: super::b::Trait> Local<T> {}",
        "mod inner { use super::super::b; }",
        "pub use super::b::Thing;",
    ] {
        let arrows = of(&[("lib.rs", ""), ("a/mod.rs", ""), ("a/b.rs", ""), ("a/c.rs", text)]);
        assert_eq!(arrows["a/c.rs"].keys().collect::<Vec<_>>(), ["a/b.rs"], "{text}");
    }
    for text in [
        "use ::a::b::Thing;",
        "use other::b;",
        "// use super::b;",
        "pub(in crate::a) struct Local;",
        "#[cfg(test)] mod tests { use crate::a::b; }",
        "fn f() { let b = 1; println!(\"super::b {b}\", b); }",
        "use self::inner::X; mod inner { pub struct X; }",
    ] {
        let arrows = of(&[("lib.rs", ""), ("a/mod.rs", ""), ("a/b.rs", ""), ("a/c.rs", text)]);
        assert!(arrows["a/c.rs"].is_empty(), "{text}: {arrows:?}");
    }
}

#[test]
fn faces_are_files_too() {
    let face = "mod b; mod c; pub use b::Thing; pub use self::c::Other;";
    let arrows = of(&[("lib.rs", "mod a; pub use a::Thing;"), ("a/mod.rs", face), ("a/b.rs", ""), ("a/c.rs", "")]);
    assert_eq!(arrows["a/mod.rs"].keys().collect::<Vec<_>>(), ["a/b.rs", "a/c.rs"], "what it hands on");
    assert_eq!(arrows["lib.rs"].keys().collect::<Vec<_>>(), ["a/mod.rs"], "through the face");
    assert!(circles(&arrows).is_empty(), "{arrows:?}");
    for text in ["use super::Thing;", "use crate::Thing;", "fn f() { super::Thing::new(); }"] {
        let files = [("lib.rs", "mod a; pub use a::Thing;"), ("a/mod.rs", face), ("a/b.rs", ""), ("a/c.rs", text)];
        let found = circles(&of(&files));
        assert_eq!(found.len(), 1, "{text}: {found:?}");
        assert!(found[0].contains("a/mod.rs → a/c.rs (a::c::Other)"), "{found:?}");
    }
}

#[test]
fn every_circle_is_told_with_its_arrows() {
    let arrows = of(&[
        ("main.rs", "mod a; mod b; mod c; mod d; mod e; fn main() { a::run(); }"),
        ("a.rs", "use crate::b::X;"),
        ("b.rs", "use crate::c::X; use crate::d::Y;"),
        ("c.rs", "use crate::a::X;"),
        ("d.rs", "use crate::e::X;"),
        ("e.rs", "use super::d::X;"),
    ]);
    let found = circles(&arrows);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].starts_with("a circle of 3 files") && found[0].contains("c.rs → a.rs (a::X)"), "{found:?}");
    assert!(!found[0].contains("d.rs"), "a way out is no part of it: {found:?}");
    assert!(found[1].contains("d.rs → e.rs") && found[1].contains("e.rs → d.rs"), "{found:?}");
}
