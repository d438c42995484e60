//! Pages of the repository: every link leads somewhere, and the book has every page of `docs/`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Component, Path, PathBuf};

use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

use crate::support::{files_below, names, repo};

/// Folders that have pages.
const TREES: [&str; 4] = ["benches", "docs", "engine", "tests"];

/// The book's table of contents.
const SUMMARY: &str = "docs/SUMMARY.md";

fn is_page(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "md")
}

/// All pages with their texts, by their paths in the repository.
fn pages() -> BTreeMap<PathBuf, String> {
    let mut paths: Vec<_> = names(&repo("")).into_iter().map(PathBuf::from).collect();
    for tree in TREES {
        paths.extend(files_below(&repo(tree)).into_iter().map(|path| Path::new(tree).join(path)));
    }
    paths.retain(|path| is_page(path));
    let text = |path: &PathBuf| fs::read_to_string(repo("").join(path)).expect("a page is text");
    paths.into_iter().map(|path| (path.clone(), text(&path))).collect()
}

/// What a page links to, and where links may lead in it.
#[derive(Default)]
struct Links {
    targets: Vec<String>,
    anchors: BTreeSet<String>,
}

impl Links {
    fn of(text: &str) -> Self {
        let (mut links, mut heading, mut seen) = (Self::default(), None, BTreeMap::new());
        let options = Options::ENABLE_GFM | Options::ENABLE_TABLES | Options::ENABLE_FOOTNOTES;
        for event in Parser::new_ext(text, options) {
            match event {
                Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                    links.targets.push(dest_url.into_string());
                }
                Event::Html(html) | Event::InlineHtml(html) => links.add_html(&html),
                Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
                Event::Text(text) | Event::Code(text) => heading.iter_mut().for_each(|heading| *heading += &text),
                Event::End(TagEnd::Heading(_)) => {
                    let slug = slug(&heading.take().unwrap_or_default());
                    let before: &mut usize = seen.entry(slug.clone()).or_default();
                    links.anchors.insert(if *before == 0 { slug } else { format!("{slug}-{before}") });
                    *before += 1;
                }
                _ => {}
            }
        }
        links
    }

    fn add_html(&mut self, html: &str) {
        let values = |name: &str| {
            let attribute = format!(" {name}=\"");
            let parts = html.split(&attribute).skip(1).filter_map(|rest| rest.split('"').next());
            parts.map(str::to_owned).collect::<Vec<_>>()
        };
        self.targets.extend(["href", "src", "srcset"].into_iter().flat_map(values));
        self.anchors.extend(["id", "name"].into_iter().flat_map(values));
    }
}

/// The anchor that GitHub makes of a heading: lower case, spaces as dashes, no other punctuation but `-` and `_`.
fn slug(heading: &str) -> String {
    let kept = |c: &char| c.is_alphabetic() || c.is_ascii_digit() || matches!(c, ' ' | '-' | '_');
    heading.to_lowercase().chars().filter(kept).map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Where a link on the page `from` leads. `None` for places outside of the repository.
fn destination(from: &Path, link: &str) -> Option<PathBuf> {
    let mut path = PathBuf::new();
    for part in from.parent()?.join(link).components() {
        match part {
            Component::Normal(name) => path.push(name),
            Component::CurDir => {}
            Component::ParentDir if path.pop() => {}
            _ => return None,
        }
    }
    Some(path)
}

/// What is wrong with the links of `pages`; `is_file` knows the repository's other files.
fn broken_links(pages: &BTreeMap<PathBuf, String>, is_file: impl Fn(&Path) -> bool) -> Vec<String> {
    let links: BTreeMap<_, _> = pages.iter().map(|(path, text)| (path.clone(), Links::of(text))).collect();
    let wrong = |from: &PathBuf, target: &str| {
        let (file, anchor) = target.split_once('#').map_or((target, None), |(file, anchor)| (file, Some(anchor)));
        let to = if file.is_empty() { Some(from.clone()) } else { destination(from, file) };
        let Some(to) = to else { return Some("leads out of the repository") };
        match (links.get(&to), anchor) {
            (Some(page), Some(anchor)) if !page.anchors.contains(anchor) => Some("no heading has this anchor"),
            (None, Some(_)) => Some("anchors lead to headings of pages"),
            (None, None) if !is_file(&to) => Some("there is no such file"),
            _ => None,
        }
    };
    let mut found = Vec::new();
    for (path, links) in &links {
        for target in links.targets.iter().filter(|target| !target.contains(':')) {
            found.extend(wrong(path, target).map(|why| format!("{}: {target}: {why}", path.display())));
        }
    }
    found
}

/// Pages of `docs/` that the book's contents do not list, or list twice.
fn unlisted(contents: &str, pages: &BTreeMap<PathBuf, String>) -> Vec<String> {
    let targets = Links::of(contents).targets;
    let listed: Vec<_> = targets.iter().filter_map(|link| destination(Path::new(SUMMARY), link)).collect();
    let times = |path: &PathBuf| listed.iter().filter(|page| *page == path).count();
    let docs = pages.keys().filter(|path| path.starts_with("docs") && *path != Path::new(SUMMARY));
    docs.filter(|path| times(path) != 1)
        .map(|path| format!("{}: listed {} times", path.display(), times(path)))
        .collect()
}

fn texts<const N: usize>(pages: [(&str, &str); N]) -> BTreeMap<PathBuf, String> {
    pages.into_iter().map(|(path, text)| (path.into(), text.to_owned())).collect()
}

#[test]
fn every_link_leads_somewhere() {
    let pages = pages();
    for known in ["README.md", "ARCHITECTURE.md", SUMMARY, "engine/assets/README.md", "benches/results/README.md"] {
        assert!(pages.contains_key(Path::new(known)), "{known} is looked at");
    }
    let broken = broken_links(&pages, |path| repo("").join(path).is_file());
    assert!(broken.is_empty(), "links:\n  {}", broken.join("\n  "));
}

#[test]
fn links_that_lead_nowhere_are_seen() {
    let is_file = |path: &Path| path == Path::new("docs/a.png");
    let target = "# The `a` flag: *what*?\n\n## Twice\n\n## Twice\n\n<a id=\"by-hand\"></a>\n";
    let broken = |link: &str| broken_links(&texts([("docs/b/page.md", link), ("docs/to.md", target)]), is_file);
    for link in [
        "[a](../gone.md)",
        "[a](../../../out.md)",
        "[a](/docs/to.md)",
        "[a](..)",
        "![a](a.png)",
        "[a](../to.md#the-b-flag)",
        "[a](../to.md#twice-2)",
        "[a](#here)",
        "[a](../a.png#L1)",
        "[a][1]\n\n[1]: ../gone.md",
        "<img width=\"9\" src=\"gone.png\">",
        "| a |\n| --- |\n| [a](gone.md) |",
    ] {
        assert_eq!(broken(link).len(), 1, "{link}: {:?}", broken(link));
    }
    for link in [
        "[a](../to.md)",
        "[a](../to.md#the-a-flag-what)",
        "[a](../to.md#twice) [a](../to.md#twice-1) [a](../to.md#by-hand)",
        "[a](../a.png) ![a](../a.png)",
        "[a](https://a.example/b.md#c) <mailto:a@a.example>",
        "# Café 2 km\n\n[a](#café-2-km)",
        "`[a](gone.md)`\n\n    [a](gone.md)\n\n[a] [b][c]",
    ] {
        assert!(broken(link).is_empty(), "{link}: {:?}", broken(link));
    }
}

#[test]
fn the_book_lists_every_page() {
    let pages = pages();
    let unlisted = unlisted(&pages[Path::new(SUMMARY)], &pages);
    assert!(unlisted.is_empty(), "{SUMMARY}:\n  {}", unlisted.join("\n  "));
}

#[test]
fn pages_that_the_book_lacks_are_seen() {
    let pages = texts([(SUMMARY, ""), ("docs/a.md", ""), ("docs/b/c.md", ""), ("README.md", "")]);
    let found = |contents: &str| unlisted(contents, &pages).len();
    assert_eq!(found("[a](a.md)\n\n- [c](b/c.md)\n"), 0, "complete");
    assert_eq!(found("- [a](a.md)\n"), 1, "one is not listed");
    assert_eq!(found("- [a](a.md)\n- [c](b/c.md)\n- [a again](./a.md)\n"), 1, "one is listed twice");
}
