//! Words that are at home in one place only, or nowhere.

use super::sources::{assert_none, code, files, has_word, name, offences, root, rust_files, shaders};

#[test]
fn only_kernels_names_the_vulkan_crate() {
    let word = concat!("a", "sh");
    let outside: Vec<_> = rust_files().into_iter().filter(|p| !name(p).starts_with("kernels/")).collect();
    let breaks = |line: &str| has_word(code(line), word);
    assert!(breaks(&format!("use {word}::vk;")), "a use is seen");
    assert!(!breaks("let hash = 1;"), "part of a word is not");
    let mut found = offences(&outside, breaks);
    let depends = |line: &str| line.trim_start().starts_with(word);
    found.extend(offences(&[root().join("engine/Cargo.toml")], depends));
    assert_none("only kernels names the Vulkan crate", &found);
}

#[test]
fn unsafe_code_stays_in_the_device_layer() {
    let word = concat!("un", "safe");
    let outside: Vec<_> = rust_files().into_iter().filter(|p| !name(p).starts_with("kernels/src/vk/")).collect();
    let breaks = |line: &str| has_word(code(line), word);
    assert!(breaks(&format!("{word} {{ f() }}")), "a block is seen");
    assert!(!breaks(&format!("#![forbid({word}_code)]")), "the lint's name is not");
    let found = offences(&outside, breaks);
    assert_none("such code only in kernels/src/vk", &found);
}

#[test]
fn nothing_is_left_for_later() {
    let marks = [
        concat!("TO", "DO"),
        concat!("FIX", "ME"),
        concat!("X", "XX"),
        concat!("to", "do!"),
        concat!("un", "implemented!"),
        concat!("#", "[ignore"),
    ];
    let breaks = |line: &str| marks.iter().any(|m| line.contains(m));
    assert!(breaks(&format!("// {}: later", marks[0])), "a note is seen");
    let mut all = rust_files();
    all.extend(shaders());
    all.extend(files("tests", &["py"]));
    all.extend(["x", ".ci/run"].map(|f| root().join(f)));
    assert_none("nothing is left for later", &offences(&all, breaks));
}
