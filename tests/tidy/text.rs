//! Files keep to a length, and lines to a width.

use std::path::{Path, PathBuf};

use super::sources::{assert_none, files, name, root, rust_files, shaders, text};

/// Widest line of code and prose, in characters.
const MAX_COLUMNS: usize = 120;

/// Longest files below a folder, in lines; the first folder that fits counts. About 500 is the aim everywhere.
const MAX_LINES: [(&str, usize); 4] = [("engine/", 500), ("cli/", 300), ("README.md", 200), ("", 700)];

/// Prose that keeps to the width: guides for readers, not the log of research.
const PROSE: [&str; 3] = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"];
const LOG: &str = "docs/log/";

fn limit(file: &str) -> usize {
    MAX_LINES.iter().find(|(folder, _)| file.starts_with(folder)).map_or(usize::MAX, |(_, lines)| *lines)
}

fn length_gap(file: &str, lines: usize) -> Option<String> {
    (lines > limit(file)).then(|| format!("{file}: {lines} lines, at most {}", limit(file)))
}

#[test]
fn files_stay_short() {
    for (file, lines) in [("engine/src/a.rs", 500), ("cli/a.rs", 300), ("README.md", 200), ("kernels/src/a.rs", 700)] {
        assert!(length_gap(file, lines).is_none(), "{file} may have {lines} lines");
        assert!(length_gap(file, lines + 1).is_some(), "{file} may not have {} lines", lines + 1);
    }
    let mut all = rust_files();
    all.extend(shaders());
    all.extend(files("tests", &["py"]));
    all.push(root().join("README.md"));
    let long: Vec<_> = all.iter().filter_map(|p| length_gap(&name(p), text(p).lines().count())).collect();
    assert_none("files stay short", &long);
}

/// Numbers and widths of the lines that are too wide.
fn wide(text: &str) -> Vec<(usize, usize)> {
    let widths = text.lines().enumerate().map(|(i, line)| (i + 1, line.chars().count()));
    widths.filter(|(_, columns)| *columns > MAX_COLUMNS).collect()
}

/// The same text with lines that cannot be broken taken out: those of tables, of code, and of a link alone.
fn breakable(markdown: &str) -> String {
    let mut fenced = false;
    let mut kept = String::new();
    for line in markdown.lines() {
        let bare = line.trim_start();
        let fence = bare.starts_with("```");
        fenced ^= fence;
        if !fenced && !fence && !bare.starts_with('|') && !is_link(bare) {
            kept.push_str(line);
        }
        kept.push('\n');
    }
    kept
}

/// Whether nothing but one link or picture stands in a line, perhaps as an item of a list, or what a link refers to.
fn is_link(line: &str) -> bool {
    let item = line.trim_start_matches(['-', '*', ' ']);
    let link = item.trim_start_matches('!').starts_with('[') && item.trim_end_matches('.').ends_with(')');
    let bare = item.starts_with("http") || item.starts_with('<');
    (link && item.matches("](").count() == 1) || (bare && !item.contains(' ')) || item.contains("]: ")
}

#[test]
fn lines_keep_to_the_width() {
    let long = "x".repeat(MAX_COLUMNS + 1);
    assert_eq!(wide(&format!("a\n{long}\n{}", "ü".repeat(MAX_COLUMNS))), [(2, MAX_COLUMNS + 1)], "characters count");
    let text_of_lines = |lines: &[&str]| breakable(&lines.join("\n"));
    for fine in [
        format!("```\n{long}\n```"),
        format!("| a | {long} |"),
        format!("- [a b]({long})"),
        format!("![a b]({long})."),
        format!("[a]: {long}"),
        format!("<https://{long}>"),
    ] {
        assert!(wide(&text_of_lines(&[&fine, "end"])).is_empty(), "{fine}");
    }
    for broken in [long.clone(), format!("- {long}"), format!("[a](b) and [c]({long})"), format!("```\na\n```\n{long}")]
    {
        assert_eq!(wide(&text_of_lines(&[&broken, "end"])).len(), 1, "{broken}");
    }
    let mut found = Vec::new();
    let mut take = |path: &Path, text: &str| {
        let lines = wide(text);
        found.extend(lines.iter().map(|(line, columns)| format!("{}:{line}: {columns} columns", name(path))));
    };
    let code = [rust_files(), shaders()].concat();
    code.iter().for_each(|path| take(path, &text(path)));
    let prose = PROSE.iter().map(|file| root().join(file)).filter(|path| path.exists());
    for path in prose.chain(files("docs", &["md"])).collect::<Vec<PathBuf>>() {
        let (shown, text) = (name(&path), text(&path));
        match shown.as_str() {
            "README.md" => take(&path, &text),
            log if log.starts_with(LOG) => {}
            _ => take(&path, &breakable(&text)),
        }
    }
    assert_none(&format!("lines have at most {MAX_COLUMNS} columns"), &found);
}
