//! The reference in docs is what the program says of itself.

use std::fs;
use std::path::Path;

use super::{all_commands, flags, guard4d};

/// Set to 1, it lets the test write the pages instead of comparing them.
const RENEW: &str = "GUARD4D_RENEW";

/// Longest line of a page, in columns.
const MAX_COLUMNS: usize = 120;

/// The page as the program prints it, which has to be the one in docs.
fn current(page: &str) -> String {
    let run = guard4d(&[&"reference", &page]);
    run.done();
    let file = format!("docs/reference/{page}.md");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(&file);
    if std::env::var_os(RENEW).is_some_and(|value| value == "1") {
        fs::create_dir_all(path.parent().expect("the page has a folder")).expect("writable");
        fs::write(&path, &run.stdout).expect("writable");
    }
    let kept = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{file}: {error}"));
    assert!(
        kept == run.stdout,
        "{file} is not what the program says; renew it: {RENEW}=1 cargo test --test tests -- cli::reference"
    );
    run.stdout
}

#[test]
fn the_page_of_commands_is_current_and_whole() {
    let page = current("cli");
    for command in all_commands() {
        let (_, section) = page.split_once(&format!("\n## guard4d {command}\n")).expect(&command);
        let section = section.split("\n## ").next().unwrap_or(section);
        for flag in flags(&command) {
            let is_told = |text: &str| text.contains(&format!("`--{flag}"));
            assert!(is_told(section) || flag == "help" || is_shared(&page, &flag), "{command} --{flag}:\n{section}");
        }
    }
    assert!(!page.contains("wrong-key") && !page.contains("guard4d reference\n"), "hidden things are left out");
    let wide: Vec<&str> = page.lines().filter(|line| line.chars().count() > MAX_COLUMNS).collect();
    assert!(wide.is_empty(), "{wide:#?}");
}

#[test]
fn the_page_of_settings_is_current_and_names_every_key_that_is_in_force() {
    let page = current("config");
    for extractor in ["none", "blind", "pretrained", "joint"] {
        let shown = guard4d(&[&"embed", &"--extractor", &extractor, &"--show-config"]);
        shown.done();
        let mut section = String::new();
        for line in shown.stdout.lines() {
            if let Some(name) = line.strip_prefix('[').and_then(|name| name.strip_suffix(']')) {
                section = format!("{name}.");
            } else if let Some((key, _)) = line.split_once(" = ") {
                assert!(page.contains(&format!("- `{section}{key}`, `--")), "{section}{key}");
            }
        }
    }
    let wide: Vec<&str> = page.lines().filter(|line| line.chars().count() > MAX_COLUMNS).collect();
    assert!(wide.is_empty(), "{wide:#?}");
}

/// Whether the flag is told of once for all commands.
fn is_shared(page: &str, flag: &str) -> bool {
    let (_, shared) = page.split_once("\n## Flags of every command\n").expect("a section");
    shared.contains(&format!("`--{flag}"))
}
