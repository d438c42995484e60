//! Manifests: both forms say the same, mistakes are named by line and column, and rows know what they need.

use std::collections::BTreeMap;

use super::Farm;

#[test]
fn both_forms_give_the_same_rows() {
    let csv = Farm::new(&[
        "# for the night of the 26th",
        "id,job,input,output,cost,size,note",
        "a,render,\"x, y.ply\",a.mp4,2.5,64x64,",
        "b,render,z.ply,b.mp4,,,shot 7",
    ]);
    let json = Farm::new(&[
        r#"{"id":"a","job":"render","input":"x, y.ply","output":"a.mp4","cost":2.5,"size":"64x64","note":null}"#,
        "",
        r#"{"id":"b","job":"render","input":"z.ply","output":"b.mp4","note":"shot 7"}"#,
    ]);
    let (one, other) = (csv.manifest(), json.manifest());
    for (a, b) in one.rows().iter().zip(other.rows()) {
        assert_eq!((&a.id, &a.job, &a.input, &a.output, &a.columns), (&b.id, &b.job, &b.input, &b.output, &b.columns));
        assert_eq!((a.cost, a.settings_hash()), (b.cost, b.settings_hash()));
    }
    let [a, b] = one.rows() else { panic!("two rows: {:?}", one.rows()) };
    assert_eq!((a.line, b.line, a.cost, b.cost), (3, 4, 2.5, 1.0));
    assert_eq!(a.columns, BTreeMap::from([("size".to_owned(), "64x64".to_owned())]), "empty cells are none");
    assert_eq!(one.state(), csv.at("jobs.farm"));
}

#[test]
fn settings_are_job_paths_and_columns() {
    let head = "id,job,input,output,cost,size";
    let hash = |row: &str| Farm::new(&[head, row]).manifest().rows()[0].settings_hash();
    let one = hash("a,render,in,out,1,8x8");
    assert_eq!(one, hash("b,render,in,out,7,8x8"), "neither id nor cost");
    let others = ["a,attack,in,out,1,8x8", "a,render,on,out,1,8x8", "a,render,in,put,1,8x8", "a,render,in,out,1,9x8"];
    others.iter().for_each(|other| assert_ne!(one, hash(other), "{other}"));
}

#[test]
fn mistakes_are_named_by_line_and_column() {
    let head = "id,job,input,output,cost";
    let wrong: [(&[&str], &[&str]); 12] = [
        (&[head, ",render,x,y,"], &["line 2: id", "1 to 100"]),
        (&[head, "a/b,render,x,y,"], &["line 2: id", "`a/b`"]),
        (&[head, ".a,render,x,y,"], &["line 2: id", "`.a`"]),
        (&[head, "a,,x,y,"], &["line 2: job", "nothing"]),
        (&[head, "a,render,x,,"], &["line 2: output", "nothing"]),
        (&[head, "a,render,x,y,NaN"], &["line 2: cost", "`NaN`"]),
        (&[head, "a,render,x,y,-1"], &["line 2: cost", "`-1`"]),
        (&[head, "a,render,x,y,", "a,render,x,z,"], &["line 3: id", "as in line 2"]),
        (&[head, "a,render,x,y,", "b,render,x,./q/../y,"], &["line 3: output", "as in line 2"]),
        (&[head, "a,render,x"], &["line 2", "as many cells"]),
        (&["id,job,id", "a,b,c"], &["columns", "`id` twice"]),
        (&[head, "a,render,y/part,y,"], &["line 2: output", "reads itself"]),
    ];
    for (lines, words) in wrong {
        let error = Farm::new(lines).error();
        assert!(words.iter().all(|word| error.contains(word)), "{words:?} in {error}");
        assert!(error.contains("jobs.csv"), "the file is named: {error}");
    }
    let list = Farm::new(&[r#"{"id":"a","job":"render","output":["x"]}"#]).error();
    assert!(list.contains("line 1") && list.contains("`output`"), "{list}");
    let cut = Farm::new(&[r#"{"id":"a","job":"#]).error();
    assert!(cut.contains("jobs.jsonl: line 1"), "{cut}");
}

#[test]
fn rows_need_what_others_make() {
    let farm = Farm::new(&[
        "id,job,input,output,key",
        "film,render,marked/a/model,films/a.mp4,",
        "mark,embed,a.ply,marked/a,./owner.key",
        "key,keygen,,owner.key,",
        "read,verify,films/a.mp4,a.json,owner.key",
        "other,render,marked/ab,b.mp4,",
    ]);
    let manifest = farm.manifest();
    let of = |id: &str| manifest.rows().iter().find(|row| row.id == id).expect("a row");
    assert_eq!((&of("film").needs, of("film").source, of("film").stage), (&vec![1], Some(1), 2));
    assert_eq!((&of("mark").needs, of("mark").source, of("mark").stage), (&vec![2], None, 1));
    assert_eq!((&of("read").needs, of("read").source, of("read").stage), (&vec![0, 2], Some(0), 3));
    assert_eq!(
        (of("key").stage, of("other").stage, of("other").needs.len()),
        (0, 0, 0),
        "`marked/ab` is not `marked/a`"
    );
    let circle = Farm::new(&["id,job,input,output", "a,render,y,x", "b,render,x,y"]).error();
    assert!(circle.contains("waits for itself"), "{circle}");
}
