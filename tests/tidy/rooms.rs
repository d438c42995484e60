//! The engine's rooms stand in one order, and what lies above or below them is reached through them.

use std::collections::BTreeMap;

use syn::Item;

use super::imports::{Arrows, arrows_of_crates};
use super::sources::{assert_none, code, files, name, offences, parsed, product_files, root, text};

/// Pairs of rooms of which the first never imports the second, whatever the order says.
const APART: [(&str, &str); 1] = [("fingerprint", "watermark")];

/// The rooms, lowest first: what the documentation of the engine's `lib.rs` names in backticks after its sentence on
/// them, up to the next full stop.
fn order(lib: &str) -> Vec<String> {
    let docs = lib.lines().filter_map(|line| line.strip_prefix("//!")).map(str::trim).collect::<Vec<_>>().join(" ");
    let (_, after) = docs.split_once("rooms stand in one order").expect("lib.rs names the rooms in their order");
    let listed = after.split('.').next().unwrap_or(after);
    listed.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// The room of a file of the engine, `None` for `lib.rs`.
fn room(file: &str) -> Option<&str> {
    let first = file.split('/').next().unwrap_or(file);
    Some(first.strip_suffix(".rs").unwrap_or(first)).filter(|room| *room != "lib")
}

/// Rooms without a place, places without a room, and arrows that run upwards, to `lib.rs`, or between rooms that keep
/// apart.
fn wrong_ways(order: &[String], arrows: &Arrows) -> Vec<String> {
    let place: BTreeMap<&str, usize> = order.iter().enumerate().map(|(i, room)| (room.as_str(), i)).collect();
    let mut found = Vec::new();
    for file in arrows.keys() {
        if room(file).is_some_and(|room| !place.contains_key(room)) {
            found.push(format!("{file}: its room has no place in the order of lib.rs"));
        }
    }
    let lived_in = |room: &&String| arrows.keys().any(|file| self::room(file) == Some(room.as_str()));
    found.extend(order.iter().filter(|room| !lived_in(room)).map(|room| format!("lib.rs: there is no room `{room}`")));
    for (from, out) in arrows {
        for (to, path) in out {
            let Some(above) = room(from).filter(|room| place.contains_key(room)) else { continue };
            let Some(below) = room(to) else {
                found.push(format!("{from} → lib.rs ({path}): name it where it is defined"));
                continue;
            };
            if place.get(above) < place.get(below) || APART.contains(&(above, below)) {
                found.push(format!("{from} → {to} ({path})"));
            }
        }
    }
    found
}

#[test]
fn rooms_import_only_those_below() {
    let lib = text(&root().join("engine/src/lib.rs"));
    let crates = arrows_of_crates();
    assert_none("rooms import only those before them", &wrong_ways(&order(&lib), &crates["engine/src"]));
}

#[test]
fn wrong_ways_are_told() {
    let lib = "//! A crate.\n//!\n//! The rooms stand in one order: `base`,\n//! `fine`, `fingerprint`. And `other`.\n";
    let mut order = order(lib);
    assert_eq!(order, ["base", "fine", "fingerprint"], "up to the full stop");
    order.insert(2, "watermark".to_owned());
    let arrows = |from: &str, to: &str| {
        let all = ["lib.rs", "base/a.rs", "fine.rs", "watermark/mod.rs", "fingerprint/mod.rs", from];
        let mut arrows: Arrows = all.iter().map(|file| ((*file).to_owned(), BTreeMap::new())).collect();
        arrows.entry(from.to_owned()).or_default().insert(to.to_owned(), "path".to_owned());
        wrong_ways(&order, &arrows)
    };
    for (from, to) in [("fine.rs", "base/a.rs"), ("lib.rs", "fine.rs"), ("watermark/key.rs", "watermark/mod.rs")] {
        assert!(arrows(from, to).is_empty(), "{from} → {to}");
    }
    for (from, to) in [
        ("base/a.rs", "fine.rs"),
        ("base/a.rs", "lib.rs"),
        ("fingerprint/mod.rs", "watermark/mod.rs"),
        ("attic/mod.rs", "base/a.rs"),
    ] {
        assert_eq!(arrows(from, to).len(), 1, "{from} → {to}: {:?}", arrows(from, to));
    }
    let empty = wrong_ways(&["base".to_owned()], &Arrows::new());
    assert_eq!(empty, ["lib.rs: there is no room `base`"]);
}

/// Names of our own crates in the code of `line`, as Rust writes them.
fn own_crates(line: &str) -> impl Iterator<Item = &str> {
    let words = code(line).split(|c: char| !c.is_alphanumeric() && c != '_');
    words.filter(|word| word.starts_with("guard4d_"))
}

#[test]
fn the_program_names_only_the_crates_next_to_it() {
    let breaks = |line: &str| own_crates(line).any(|name| !["guard4d_engine", "guard4d_lab"].contains(&name));
    assert!(breaks("use guard4d_kernels::Device;"), "the kernels are seen");
    assert!(!breaks("use guard4d_engine::render; // not guard4d_kernels"), "the engine is next");
    assert_none("cli names engine and lab alone", &offences(&files("cli", &["rs"]), breaks));
}

#[test]
fn evidence_needs_no_device() {
    let breaks = |line: &str| own_crates(line).next().is_some();
    assert!(breaks("    rec: &mut guard4d_kernels::Recorder,"), "a path is seen");
    assert!(!breaks("use crate::base::prf::Prf;"), "rooms below are fine");
    assert_none("evidence is arithmetic", &offences(&files("engine/src/evidence", &["rs"]), breaks));
}

/// What a face (`mod.rs`, `lib.rs`) holds beside documentation, attributes, `mod` and `use`.
fn beside_the_face(tree: &syn::File) -> usize {
    let belongs = |item: &&Item| match item {
        Item::Use(_) => true,
        Item::Mod(module) => module.content.is_none(),
        _ => false,
    };
    tree.items.iter().filter(|item| !belongs(item)).count()
}

#[test]
fn faces_hold_nothing_of_their_own() {
    let count = |text: &str| beside_the_face(&syn::parse_file(text).expect("Rust"));
    assert_eq!(count("//! Docs.\n#![forbid(unsafe_code)]\n#[cfg(x)]\npub mod a;\nmod b;\npub use a::{B, C};"), 0);
    for text in ["fn f() {}", "const A: u8 = 1;", "mod a { }", "macro_rules! m { () => {} }", "include!(\"x.rs\");"] {
        assert_eq!(count(text), 1, "{text}");
    }
    let ends = ["/mod.rs", "/lib.rs"];
    let faces: Vec<_> =
        product_files().into_iter().filter(|path| ends.iter().any(|end| name(path).ends_with(end))).collect();
    assert!(faces.len() > 20, "faces are found");
    let counted = faces.iter().map(|path| (name(path), beside_the_face(&parsed(path))));
    let found: Vec<_> = counted.filter(|(_, n)| *n > 0).map(|(face, n)| format!("{face}: {n} items")).collect();
    assert_none("faces hold documentation, `mod` and `use`", &found);
}

/// Rooms that a map of the code does not show as `room/`, or as `room.rs` where the room is one file.
fn unnamed(order: Vec<String>, map: &str) -> Vec<String> {
    let shown = |room: &str| ["/", ".rs"].iter().any(|end| map.contains(&format!("`{room}{end}`")));
    order.into_iter().filter(|room| !shown(room)).collect()
}

#[test]
fn the_map_of_the_code_names_every_room() {
    let rooms = ["error", "base", "scene"].map(str::to_owned).to_vec();
    assert_eq!(unnamed(rooms, "| `error.rs` | `base/` | the scene |"), ["scene"], "a word is no room");
    let (lib, map) = (text(&root().join("engine/src/lib.rs")), text(&root().join("ARCHITECTURE.md")));
    assert_none("ARCHITECTURE.md names every room", &unnamed(order(&lib), &map));
}
