//! The book's source: every page of the repository and what pages link to, in the repository's folders. So a link leads
//! to the same place in both.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Component, Path, PathBuf};

use pulldown_cmark::{Event, Options, Parser, Tag};

use crate::error::{Error, Naming, Result};
use crate::workspace::empty_folder;

/// Folders in which no page is.
const APART: [&str; 2] = ["target", "guard4d-demo"];

/// The book's table of contents.
const SUMMARY: &str = "docs/SUMMARY.md";

/// Its heading, which mdBook does not show.
const CONTENTS_TITLE: &str = "# Summary";

/// Puts the source of the book about the repository at `root` into the folder `into`, which it empties.
pub(crate) fn assemble(root: &Path, into: &Path) -> Result<()> {
    empty_folder(into)?;
    let all = files(root, Path::new(""))?;
    let mut pages = Vec::new();
    for path in all.iter().filter(|path| path.extension().is_some_and(|e| e == "md")) {
        let full = root.join(path);
        pages.push(Page { path: path.clone(), text: fs::read_to_string(&full).of_file(&full)? });
    }
    let Some(contents) = pages.iter().position(|page| page.path == Path::new(SUMMARY)) else {
        return Err(Error::Missing(format!("{SUMMARY} is missing")));
    };
    let contents = pages.remove(contents);
    let linked: BTreeSet<_> = pages.iter().flat_map(Page::links).collect();
    let is_page = |path: &PathBuf| pages.iter().any(|page| page.path == *path);
    for path in all.iter().filter(|path| is_page(path) || linked.contains(*path)) {
        copy(&root.join(path), &into.join(path))?;
    }
    let summary = into.join("SUMMARY.md");
    fs::write(&summary, table_of_contents(&contents, &pages)).of_file(&summary)
}

/// All files below `root/folder`, relative to `root`, sorted; hidden ones and those apart are left out.
fn files(root: &Path, folder: &Path) -> Result<Vec<PathBuf>> {
    let (mut found, full) = (Vec::new(), root.join(folder));
    for entry in fs::read_dir(&full).of_file(&full)? {
        let name = entry.of_file(&full)?.file_name();
        let (path, shown) = (folder.join(&name), name.to_string_lossy());
        if shown.starts_with('.') || APART.contains(&shown.as_ref()) {
            continue;
        }
        match root.join(&path).is_dir() {
            true => found.extend(files(root, &path)?),
            false => found.push(path),
        }
    }
    found.sort();
    Ok(found)
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder).of_file(folder)?;
    }
    fs::copy(from, to).map(|_| ()).of_file(from)
}

/// A page of Markdown.
struct Page {
    /// Relative to the repository.
    path: PathBuf,
    text: String,
}

impl Page {
    /// The files of the repository that it links to or shows, relative to the repository.
    fn links(&self) -> Vec<PathBuf> {
        let targets = Parser::new_ext(&self.text, Options::all()).filter_map(|event| match event {
            Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => Some(dest_url),
            _ => None,
        });
        let folder = self.path.parent().unwrap_or(Path::new(""));
        targets.filter_map(|target| inside(folder, target.split('#').next()?)).collect()
    }

    /// Its first heading; its path where it has none.
    fn title(&self) -> String {
        let heading = self.text.lines().find_map(|line| line.strip_prefix("# "));
        heading.map_or_else(|| self.path.display().to_string(), |heading| heading.trim().to_owned())
    }
}

/// Where a link on a page in `folder` leads. `None` for addresses elsewhere.
fn inside(folder: &Path, link: &str) -> Option<PathBuf> {
    if link.is_empty() || link.contains(':') {
        return None;
    }
    let mut path = PathBuf::new();
    for part in folder.join(link).components() {
        match part {
            Component::Normal(name) => path.push(name),
            Component::CurDir => {}
            Component::ParentDir if path.pop() => {}
            _ => return None,
        }
    }
    Some(path)
}

/// The contents as written, seen from the top folder, and around them the pages that they do not list. The README comes
/// first, because the first page is also the book's index, which lies in the top folder as it does.
fn table_of_contents(contents: &Page, pages: &[Page]) -> String {
    let text = contents.text.replace("](../", "](/").replace("](", "](docs/");
    let text = text.replace("](docs//", "](").replace("](docs/)", "]()");
    let listed = contents.links();
    let rest = pages.iter().filter(|page| !listed.contains(&page.path));
    let (first, last): (Vec<_>, Vec<_>) = rest.partition(|page| page.path == Path::new("README.md"));
    let mut parts: Vec<_> = first.iter().map(|page| format!("[README]({})", page.path.display())).collect();
    parts.push(text.trim_start_matches(CONTENTS_TITLE).trim().to_owned());
    parts.extend((!last.is_empty()).then(|| "---".to_owned()));
    let entry = |page: &&Page| format!("[{}]({})", page.title().replace(['[', ']'], ""), page.path.display());
    parts.extend(last.iter().map(entry));
    parts.join("\n\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(path: &str, text: &str) -> Page {
        Page { path: path.into(), text: text.to_owned() }
    }

    #[test]
    fn links_are_seen_from_the_top_folder() {
        let text = "[a](../a.md#b) ![c](c.png) [d](https://d/) [e](#e) [f] `[g](g.md)`\n\n[f]: ./f.md\n";
        let want = ["a.md", "docs/c.png", "docs/f.md"].map(PathBuf::from);
        assert_eq!(page("docs/page.md", text).links(), want);
        assert_eq!(page("page.md", "[out](../out.md)").links(), Vec::<PathBuf>::new(), "not of the repository");
    }

    #[test]
    fn contents_list_every_page_once() {
        let contents = page(SUMMARY, "# Summary\n\n[Start](README.md)\n\n- [A](guide/a.md)\n- [Later]()\n");
        let pages =
            ["README.md", "ARCHITECTURE.md", "docs/README.md", "docs/guide/a.md"].map(|path| page(path, "# A [b]"));
        let want = "[README](README.md)\n\n[Start](docs/README.md)\n\n- [A](docs/guide/a.md)\n- [Later]()\n\n---\n\n\
                    [A b](ARCHITECTURE.md)\n";
        assert_eq!(table_of_contents(&contents, &pages), want);
        let contents = page(SUMMARY, "# Summary\n\n[Start](../README.md)\n");
        assert_eq!(table_of_contents(&contents, &pages[..1]), "[Start](README.md)\n");
    }

    #[test]
    fn the_source_holds_pages_and_what_they_link_to() {
        let (root, into) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
        for (path, text) in [
            ("README.md", "# One\n\n![two](docs/images/two.png)"),
            (SUMMARY, "[One](../README.md)\n"),
            ("docs/images/two.png", "two"),
            ("docs/images/three.png", "nobody shows it"),
            ("LICENSE", "nobody links to it"),
            ("target/doc/four.md", "not of the repository"),
            (".git/five.md", "nor this"),
        ] {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
            fs::write(path, text).expect("a file");
        }
        assemble(root.path(), into.path()).expect("a source");
        let made = files(into.path(), Path::new("")).expect("files");
        assert_eq!(made, ["README.md", "SUMMARY.md", "docs/images/two.png"].map(PathBuf::from));
        fs::remove_file(root.path().join(SUMMARY)).expect("a file");
        assert_eq!(assemble(root.path(), into.path()).expect_err("no contents").exit_code(), 69);
    }
}
