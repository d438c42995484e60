//! No NaN passes a check.

use super::sources::{assert_none, code, files, name, text};

/// What drops a NaN: both `max` and `min` of a float and a NaN are the float.
const DROPS: [&str; 6] = ["f32::max", "f64::max", "f32::min", "f64::min", ".max(", ".min("];

/// Calls that take values one after the other.
const FOLDS: [&str; 2] = [concat!(".f", "old("), concat!(".r", "educe(")];

/// The text from the bracket at its start to the one that closes it; all of it where none does.
fn bracketed(text: &str) -> &str {
    let mut depth = 0_usize;
    for (at, character) in text.char_indices() {
        match character {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth == 0 {
            return &text[..at];
        }
    }
    text
}

/// Numbers of the lines in which a fold or a reduction loses what is not a number.
fn losses(rust: &str) -> Vec<usize> {
    let bare: String = rust.lines().map(|line| format!("{}\n", code(line))).collect();
    let calls = FOLDS.into_iter().flat_map(|call| {
        let arguments = move |at: usize| at + call.len() - 1;
        bare.match_indices(call).map(move |(at, _)| arguments(at)).collect::<Vec<_>>()
    });
    let lost = calls.filter(|at| DROPS.iter().any(|word| bracketed(&bare[*at..]).contains(word)));
    let mut lines: Vec<_> = lost.map(|at| bare[..at].lines().count()).collect();
    lines.sort_unstable();
    lines
}

#[test]
fn tests_look_for_the_largest_number_in_a_way_that_finds_a_nan() {
    let [fold, reduce] = FOLDS;
    for broken in [
        format!("let worst = off{fold}0.0, f32::max);"),
        format!("assert!(off{fold}0.0, f64::max) < 1.0);"),
        format!("let least = p{fold}f64::INFINITY, f64::min);"),
        format!("v.iter(){fold}0.0, |m: f32, v| m.max(v.abs()));"),
        format!("v.iter(){fold}\n    (0.0),\n    |m: f32, v| {{\n        m.min(*v)\n    }},\n);"),
        format!("off{reduce}f64::max)"),
    ] {
        assert_eq!(losses(&format!("fn f() {{\n{broken}\n}}")), [2], "{broken}");
    }
    for fine in [
        format!("v.iter(){fold}0.0, |sum, v| sum + v).max(1.0)"),
        "largest(v.iter().map(|v| v.abs()))".to_owned(),
        format!("// v{fold}0.0, f32::max)"),
        "counts.iter().max()".to_owned(),
    ] {
        assert!(losses(&fine).is_empty(), "{fine}");
    }
    let mut found = Vec::new();
    for path in files("tests", &["rs"]) {
        found.extend(losses(&text(&path)).iter().map(|line| format!("{}:{line}", name(&path))));
    }
    assert_none("tests take `support::close::largest`, which no NaN passes", &found);
}
