//! `guard4d lab study`: what it refuses, and reports that are made again without measuring.

use guard4d_engine::base::ledger::{Head, lines};
use guard4d_lab::study::Row;
use guard4d_lab::tracing::measure::Reading;

use super::{guard4d, names, put, scratch};

#[test]
fn reports_are_made_again_from_their_rows_without_a_device() {
    let folder = scratch();
    let row = |marked| Row { take: "plain".to_owned(), marked: Some(marked), cpu_s: Some(9.0), ..Row::default() };
    let rows = lines(&[row(0.875), row(1.0)], Head::With).expect("rows are flat");
    let csv: String = ["part,arm", "pareto,default", "pareto,fit <auto>"]
        .iter()
        .zip(rows.lines())
        .map(|(names, line)| format!("{names},{line}\n"))
        .collect();
    put(folder.path(), "rows/readings.csv", csv.as_bytes());
    let (from, out) = (folder.path().join("rows/readings.csv"), folder.path().join("again"));
    let redraw = |part: &str, more: &[&'static str]| {
        let mut args: Vec<&dyn AsRef<std::ffi::OsStr>> =
            vec![&"lab", &"study", &part, &"--redraw", &from, &"--out", &out, &"--device", &"99"];
        args.extend(more.iter().map(|arg| arg as &dyn AsRef<std::ffi::OsStr>));
        guard4d(&args)
    };
    let run = redraw("pareto", &[]);
    run.done();
    assert_eq!(run.stdout.trim(), out.join("pareto.html").display().to_string(), "where the page is");
    assert_eq!(names(&out), ["pareto.html", "pareto.json", "pareto.svg"], "rows stay where they are");
    let picture = std::fs::read_to_string(out.join("pareto.svg")).expect("a picture");
    assert!(picture.contains("fit &lt;auto&gt;") && picture.matches("default").count() == 1, "{picture}");

    redraw("fit", &[]).refused(65, &["readings.csv", "none of `fit`"]);
    redraw("pareto", &["--quick"]).refused(2, &["--redraw", "--quick"]);
    redraw("pareto5", &[]).refused(2, &["pareto5", "table1, table2", "all"]);
}

#[test]
fn pages_of_copies_are_made_again_from_their_readings() {
    let folder = scratch();
    let reading = |leak: &str, contributed, t| Reading {
        asset: "demo".to_owned(),
        key: 1,
        leak: leak.to_owned(),
        film: "h264 23".to_owned(),
        frames: 24,
        asked_db: 49.0,
        contributed,
        named: 1,
        t,
        ..Reading::default()
    };
    let rows = [reading("copy", 1, 48.25), reading("average 2", 2, 31.5)];
    put(folder.path(), "copies.csv", lines(&rows, Head::With).expect("rows are flat").as_bytes());
    let (from, out) = (folder.path().join("copies.csv"), folder.path().join("again"));
    let redraw = |parts: &[&'static str], from: &std::path::Path| {
        let mut args: Vec<&dyn AsRef<std::ffi::OsStr>> = vec![&"lab", &"study"];
        args.extend(parts.iter().map(|part| part as &dyn AsRef<std::ffi::OsStr>));
        args.extend([&"--redraw" as &dyn AsRef<std::ffi::OsStr>, &from, &"--out", &out, &"--device", &"99"]);
        guard4d(&args)
    };
    let run = redraw(&["tracing", "collusion"], &from);
    run.done();
    let pages: Vec<String> = ["tracing", "collusion"]
        .map(|name| out.join(format!("{name}.html")))
        .map(|page| page.display().to_string())
        .to_vec();
    assert_eq!(run.stdout.lines().collect::<Vec<_>>(), pages, "a page for each part");
    let page = |name: &str| std::fs::read_to_string(out.join(name)).expect("a page");
    assert!(page("tracing.html").contains("48.2") && page("collusion.html").contains("31.5"));
    let nothing = folder.path().join("nothing.csv");
    redraw(&["tracing"], &nothing).refused(66, &["nothing.csv"]);
    assert!(!nothing.exists(), "nothing is begun");
}
