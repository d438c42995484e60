//! Names of recipients: which are taken, and what a table of them looks like.

use std::fs;

use guard4d_engine::error::EngineError;
use guard4d_engine::release::recipients::{Recipient, parse_list, read_table};

use crate::support::names;

#[test]
fn names_are_those_that_files_can_have_anywhere() {
    let longest = "n".repeat(100);
    for name in ["studio-a", "Ana María", "ana@studio.example", "客户", "a.b", longest.as_str()] {
        assert_eq!(Recipient::new(name).expect("a name").as_str(), name);
    }
    let too_long = "n".repeat(101);
    let refused =
        ["", ".", "..", "a/b", "..\\b", "c:d", "-w", ".hidden", "end.", " a", "a\n", "a\0", "what?", too_long.as_str()];
    for name in refused {
        let error = Recipient::new(name).expect_err(name);
        assert!(matches!(error, EngineError::Usage { .. }) && error.to_string().contains("recipient"), "{error}");
    }
}

#[test]
fn a_name_twice_is_told_with_its_places() {
    let list = parse_list(["a", " b ", "c"]).expect("three names");
    assert_eq!(list.iter().map(Recipient::as_str).collect::<Vec<_>>(), ["a", "b", "c"], "without blanks around them");
    // Some file systems know no difference.
    let error = parse_list(["Studio-A", "b", "studio-a"]).expect_err("twice").to_string();
    assert!(error.contains("studio-a twice, as number 1 and 3"), "{error}");
}

#[test]
fn tables_have_a_column_of_recipients() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("list.csv");
    let table = |text: &str| {
        fs::write(&path, text).expect("writable");
        read_table(&path)
    };
    let list = table("date,recipient\n2026,\"a, b\"\n2026, c \n").expect("a table");
    assert_eq!(list.iter().map(Recipient::as_str).collect::<Vec<_>>(), ["a, b", "c"]);
    for (text, word) in [
        ("name\na\n", "a column recipient"),
        ("recipient\n", "no line"),
        ("recipient\na\na\n", "a twice"),
        ("recipient\na/b\n", "without a path"),
        ("recipient,x\na\n", "csv"),
    ] {
        let error = table(text).expect_err(text);
        let told = error.to_string();
        assert!(matches!(error, EngineError::BadData { .. }) && told.contains("list.csv"), "{told}");
        assert!(told.contains(word), "{word}: {told}");
    }
    assert!(matches!(read_table(&folder.path().join("none")), Err(EngineError::MissingInput { .. })));
    assert_eq!(names(folder.path()), ["list.csv"]);
}
