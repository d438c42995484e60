//! `guard4d man`: a page for every command that `--help` shows, with every flag of it.

use std::fs;

use super::{all_commands, commands, flags, guard4d, names, put, scratch};

#[test]
fn every_command_has_a_page_that_names_its_flags() {
    let folder = scratch();
    let pages = folder.path().join("pages");
    guard4d(&[&"man", &pages]).done();
    let page = |name: &str| fs::read_to_string(pages.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    for command in all_commands() {
        let page = page(&format!("guard4d-{}.1", command.replace(' ', "-")));
        for flag in flags(&command) {
            // Hyphens that are part of a name are escaped, so that they can be searched for.
            let escaped = format!("--{flag}").replace('-', "\\-");
            assert!(page.contains(&escaped), "{command} --{flag}:\n{page}");
        }
    }
    let first = page("guard4d.1");
    assert!(first.contains("Exit codes") && commands().iter().all(|command| first.contains(command)), "{first}");
    assert_eq!(names(&pages).len(), all_commands().len() + 1, "no page of a hidden command");
}

#[test]
fn pages_appear_whole_and_replace_nothing_unless_asked() {
    let folder = scratch();
    let pages = folder.path().join("pages");
    put(&pages, "mine.txt", b"precious");
    guard4d(&[&"man", &pages]).refused(73, &["pages: cannot create", "it exists"]);
    assert_eq!(names(&pages), ["mine.txt"], "untouched");
    guard4d(&[&"man", &pages, &"-w"]).done();
    assert!(!names(&pages).contains(&"mine.txt".to_owned()), "replaced as a whole");
    assert_eq!(names(folder.path()), ["pages"], "nothing beside it");
}
