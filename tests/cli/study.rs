//! `guard4d lab study`: what it refuses, and reports that are made again without measuring.

use guard4d_engine::base::ledger::{Head, lines};
use guard4d_lab::study::Row;

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
