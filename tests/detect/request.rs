//! Every input of a reading stands in the table of docs/method/evidence.md, with where it is committed to or why its
//! choice gains nothing.

use std::collections::BTreeSet;
use std::fs;

use crate::tidy::sources::root;

/// What a reading is made of: the structs whose fields, and the constants whose values, decide what is read and how it
/// is judged.
const STRUCTS: [(&str, &str); 17] = [
    ("engine/src/watermark/key/owner_key.rs", "Key"),
    ("engine/src/watermark/extractor/weights.rs", "ExtractorWeights"),
    ("engine/src/watermark/extractor/calibration.rs", "Calibration"),
    ("engine/src/watermark/extractor/content.rs", "ContentModel"),
    ("engine/src/watermark/extractor/tmsd.rs", "TmsdWeights"),
    ("engine/src/watermark/extractor/rotation.rs", "KeyRotation"),
    ("engine/src/picture/known_views.rs", "KnownViews"),
    ("engine/src/picture/known_cameras.rs", "KnownCameras"),
    ("engine/src/watermark/extractor/pretrained.rs", "PretrainedExtractor"),
    ("engine/src/release/receipt.rs", "Promise"),
    ("engine/src/release/receipt.rs", "Anchor"),
    ("engine/src/evidence/thresholds.rs", "Thresholds"),
    ("engine/src/detect/request.rs", "VerifyRequest"),
    ("engine/src/detect/request.rs", "VerifyInputs"),
    ("engine/src/media/options.rs", "ReadOptions"),
    ("engine/src/media/framing.rs", "Framing"),
    ("engine/src/evidence/claim.rs", "Claim"),
];
const CONSTANTS: [&str; 4] = ["PREPROCESS", "CLIP_FRAMES", "NORMALIZATION", "NUM_OTHER_KEYS"];
const TABLE: &str = "docs/method/evidence.md";

/// Names `Struct.field` of the fields of a struct.
fn fields(file: &str, name: &str) -> Vec<String> {
    let text = fs::read_to_string(root().join(file)).expect("a source of the engine");
    let parsed = syn::parse_file(&text).expect("Rust");
    let found = parsed.items.iter().find_map(|item| match item {
        syn::Item::Struct(item) if item.ident == name => Some(item.fields.clone()),
        _ => None,
    });
    let fields = found.unwrap_or_else(|| panic!("{file} has no struct {name}"));
    fields.iter().filter_map(|field| Some(format!("{name}.{}", field.ident.as_ref()?))).collect()
}

/// Rows of the table by the inputs that they name: whether each says where it is committed, or why it need not be.
fn told(text: &str) -> BTreeSet<String> {
    let rows = text.lines().filter(|line| line.starts_with("| `"));
    let cells = rows.map(|row| row.trim_matches('|').split('|').map(str::trim).collect::<Vec<_>>());
    let is_answered = |cells: &Vec<&str>| cells.len() == 3 && cells[1..].iter().any(|cell| cell.len() > 2);
    let names = cells
        .filter(is_answered)
        .flat_map(|cells| cells[0].split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>());
    names.collect()
}

#[test]
fn every_input_of_a_reading_is_committed_or_its_choice_gains_nothing() {
    let told = told(&fs::read_to_string(root().join(TABLE)).expect("a page"));
    let inputs: BTreeSet<String> =
        STRUCTS.iter().flat_map(|(file, name)| fields(file, name)).chain(CONSTANTS.map(str::to_owned)).collect();
    assert!(inputs.len() > 60, "{} inputs were found", inputs.len());
    let missing: Vec<_> = inputs.difference(&told).collect();
    assert!(missing.is_empty(), "{TABLE} tells nothing of {missing:?}");
    let gone: Vec<_> = told.difference(&inputs).filter(|name| name.contains('.')).collect();
    assert!(gone.is_empty(), "{TABLE} tells of {gone:?}, which are no inputs any more");
}

#[test]
fn inputs_without_an_answer_are_told() {
    let table = "| `A.b`, `A.c` | in the key's hash | |\n| `A.d` | | the program's |\n| `A.e` | | |\n| `A.f` | x |\n";
    let names: Vec<String> = told(table).into_iter().collect();
    assert_eq!(names, ["A.b", "A.c", "A.d"]);
}
