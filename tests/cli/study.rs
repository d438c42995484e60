//! `guard4d lab study`: what it refuses, and reports that are made again without measuring.

use guard4d_engine::base::ledger::{Head, lines};
use guard4d_lab::locating::measure::LocatedRow;
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

    std::fs::remove_dir_all(&out).expect("a folder");
    let all = redraw("all", &[]);
    all.done();
    assert_eq!(all.stdout, run.stdout, "all are those that the rows are of");

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
    let all = redraw(&["all"], &from);
    all.done();
    assert_eq!(all.stdout, run.stdout, "all are those that the readings are of");
    redraw(&["stamping"], &from).refused(65, &["copies.csv", "none of `stamping`"]);

    // A table that grew no further, from before there were figures of decoys: it is read, and left as it is.
    let older = std::fs::read_to_string(&from).expect("a table");
    let place = older.lines().next().expect("a head").split(',').position(|name| name == "over_2").expect("a column");
    let without = |line: &str| {
        let cells = line.split(',').enumerate().filter(|(index, _)| !(place..place + 6).contains(index));
        cells.map(|(_, cell)| cell).collect::<Vec<_>>().join(",")
    };
    let older = older.lines().map(without).collect::<Vec<_>>().join("\n");
    put(folder.path(), "older.csv", older.as_bytes());
    redraw(&["tracing"], &folder.path().join("older.csv")).done();
    assert_eq!(std::fs::read_to_string(folder.path().join("older.csv")).expect("a table"), older, "only read");

    put(folder.path(), "other.csv", b"name,size\nfox,3\n");
    redraw(&["all"], &folder.path().join("other.csv")).refused(65, &["other.csv", "asset"]);
    let nothing = folder.path().join("nothing.csv");
    redraw(&["tracing"], &nothing).refused(66, &["nothing.csv"]);
    assert!(!nothing.exists(), "nothing is begun");
}

#[test]
fn the_page_of_leaks_is_made_again_with_their_pictures() {
    let folder = scratch();
    let row = |film, attack: &str, found, t| LocatedRow {
        asset: "demo".to_owned(),
        film,
        attack: attack.to_owned(),
        found,
        t,
        t_true: 2.0 * t,
        named: usize::from(found),
        ..LocatedRow::default()
    };
    let rows = [row(0, "none", true, 40.5), row(1, "none", true, 20.25), row(0, "logo", false, 0.0)];
    put(folder.path(), "leaks.csv", lines(&rows, Head::With).expect("rows are flat").as_bytes());
    put(folder.path(), "leaks/demo-1-none.png", b"a picture");
    let (from, out) = (folder.path().join("leaks.csv"), folder.path().join("again"));
    for part in ["leaks", "all"] {
        let run = guard4d(&[&"lab", &"study", &part, &"--redraw", &from, &"--out", &out, &"--device", &"99"]);
        run.done();
        assert_eq!(run.stdout.trim(), out.join("leaks.html").display().to_string(), "{part}");
    }
    let page = std::fs::read_to_string(out.join("leaks.html")).expect("a page");
    for words in
        ["2 of 3 films were found", "2 named the right copy", "0 another", "<td>2 of 2</td>", "<td>0 of 1</td>"]
    {
        assert!(page.contains(words), "{words}: {page}");
    }
    assert!(page.contains("0.50 (0.50)") && page.matches("data:image/png").count() == 1, "{page}");
}
