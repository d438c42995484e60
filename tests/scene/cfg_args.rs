//! `cfg_args`: literals are read, code and unknown flags are refused.

use std::path::Path;

use guard4d_engine::error::EngineError;
use guard4d_engine::scene::DeformConfig;
use proptest::prelude::*;

use super::assert_refused;
use crate::support::fixture;
use crate::support::{golden, shared};

fn parse(text: &str) -> Result<DeformConfig, EngineError> {
    DeformConfig::parse(Path::new("cfg_args"), text.as_bytes())
}

/// Parses the fixture's text with `from` replaced.
fn edit(from: &str, to: &str) -> Result<DeformConfig, EngineError> {
    let text = fixture::cfg_args();
    assert!(text.contains(from), "`{from}` is in the fixture");
    parse(&text.replacen(from, to, 1))
}

/// Parses the fixture's text with one more flag.
fn with(flag: &str) -> Result<DeformConfig, EngineError> {
    edit("Namespace(", &format!("Namespace({flag}, "))
}

#[test]
fn the_hyperparameters_are_read() {
    let config = parse(&fixture::cfg_args()).expect("the fixture is good");
    let expected = DeformConfig {
        net_width: fixture::WIDTH,
        defor_depth: 2,
        multires: fixture::MULTIRES.to_vec(),
        output_coordinate_dim: fixture::CHANNELS,
        resolution: fixture::RESOLUTION,
        no_dx: false,
        no_ds: false,
        no_dr: false,
        no_do: true,
        no_dshs: true,
        apply_rotation: false,
        bounds: 1.6,
        white_background: true,
        sh_degree: 3,
    };
    assert_eq!(config, expected);
    let config = edit("white_background=True", "white_background=False").expect("a black background");
    assert!(!config.white_background, "the flag is read");
}

#[test]
fn flags_that_older_versions_lack_take_the_default_and_others_are_required() {
    let absent = |flag: &str| {
        let text = fixture::cfg_args();
        let start = text.find(&format!("{flag}=")).expect(flag);
        let end = start + text[start..].find(", ").map_or(text.len() - start - 1, |length| length + 2);
        parse(&format!("{}{}", &text[..start], &text[end..]))
    };
    let full = parse(&fixture::cfg_args()).expect("the fixture is good");
    for flag in ["apply_rotation", "bounds", "empty_voxel", "grid_pe", "no_grid", "sh_degree", "static_mlp"] {
        assert_eq!(absent(flag).expect(flag), full, "{flag}");
    }
    for flag in ["defor_depth", "net_width", "no_do", "no_dr", "no_ds", "no_dshs", "no_dx"] {
        assert_refused(absent(flag), &[flag, "missing"]);
    }
}

#[test]
fn literals_of_all_kinds_are_accepted_where_they_have_no_effect() {
    for literal in [
        "None",
        "True",
        "-1",
        "+3",
        "1e-05",
        ".5",
        "1.",
        "1.6E-06",
        "'text'",
        "\"it's\"",
        "'it\\'s'",
        "'\\\\ \\n \\x41 \\u00e9'",
        "[]",
        "[1, 2.5, 'a', None]",
        "[1, ]",
        "{}",
        "{'a': 1, 'b': [True]}",
        "{1: {2: 3}}",
        "'(not, code)'",
        "''",
    ] {
        with(&format!("custom_sampler={literal}")).expect(literal);
    }
    let spaced = fixture::cfg_args().replace(", ", " ,\n  ").replace('=', " = ");
    parse(&spaced).expect("space does not matter");
    edit("white_background=True)", "white_background=True,)\n").expect("a last comma and line end are Python");
}

#[test]
fn anything_but_literals_is_refused_with_its_place() {
    for code in [
        "__import__('os').system('true')",
        "eval('1')",
        "os.environ",
        "torch.device('cuda')",
        "1 + 1",
        "(1, 2)",
        "lambda: 0",
        "f'{1}'",
        "b'x'",
        "'open",
        "'\\N{DASH}'",
        "'\\ud800'",
        "[1",
        "[1 2]",
        "{1}",
        "{1: }",
        "nan",
        "inf",
        "1e999",
        "0x10",
        "1-1",
        "",
    ] {
        assert_refused(with(&format!("custom_sampler={code}")), &["byte "]);
    }
    for text in
        ["", "Namespace", "Namespace(", "dict()", "Namespace()x", "Namespace(=1)", "Namespace(1=1)", "Namespace(a)"]
    {
        assert_refused(parse(text), &["byte "]);
    }
    let deep = format!("custom_sampler={}{}", "[".repeat(10_000), "]".repeat(10_000));
    assert_refused(with(&deep), &["shallower nesting"]);
    assert_refused(with(&format!("custom_sampler='{}'", "x".repeat(300_000))), &["length", "at most 262144"]);
    assert_refused(DeformConfig::parse(Path::new("cfg_args"), b"\xff"), &["no text", "UTF-8"]);
}

#[test]
fn unknown_and_repeated_flags_are_refused_by_name() {
    assert_refused(with("use_neural_colour=True"), &["use_neural_colour", "unknown flag"]);
    assert_refused(with("is_blender=False"), &["is_blender", "unknown flag"]);
    assert_refused(with("net_width=4"), &["net_width", "set twice"]);
}

#[test]
fn unsupported_variants_are_refused_by_name() {
    for flag in ["static_mlp", "empty_voxel", "no_grid"] {
        assert_refused(edit(&format!("{flag}=False"), &format!("{flag}=True")), &[flag, "True", "not supported"]);
    }
    edit("grid_pe=0", "grid_pe=1").expect("one means no encoding");
    assert_refused(edit("grid_pe=0", "grid_pe=2"), &["grid_pe", "2", "not supported"]);
    assert_refused(edit("'grid_dimensions': 2", "'grid_dimensions': 3"), &["grid_dimensions", "3", "HexPlane"]);
    assert_refused(edit("'input_coordinate_dim': 4", "'input_coordinate_dim': 3"), &["input_coordinate_dim"]);
}

#[test]
fn values_of_the_wrong_kind_or_size_are_refused_by_name() {
    for (from, to, name) in [
        ("net_width=4", "net_width=0", "net_width"),
        ("net_width=4", "net_width='4'", "net_width"),
        ("net_width=4", "net_width=99999999999", "net_width"),
        ("net_width=4", "net_width=-4", "net_width"),
        ("defor_depth=2", "defor_depth=2.0", "defor_depth"),
        ("multires=[1, 2]", "multires=[]", "multires"),
        ("multires=[1, 2]", "multires=2", "multires"),
        ("multires=[1, 2]", "multires=[1, 0]", "multires"),
        ("[3, 4, 5, 2]", "[3, 4, 5]", "resolution"),
        ("'resolution'", "'resolutions'", "resolution"),
        ("'output_coordinate_dim': 2", "'resolution': 2", "output_coordinate_dim"),
        ("no_dx=False", "no_dx=0", "no_dx"),
        ("bounds=1.6", "bounds=-1", "bounds"),
        ("bounds=1.6", "bounds='1.6'", "bounds"),
        ("sh_degree=3", "sh_degree=4", "sh_degree"),
        ("white_background=True", "white_background=None", "white_background"),
    ] {
        assert_refused(edit(from, to), &[name]);
    }
}

#[test]
fn real_files_are_read_and_those_of_other_methods_are_not() {
    DeformConfig::open(&golden::model("dynerf_like").join("cfg_args")).expect("the golden's");
    for model in ["models/fox", "models/robot", "models/stress4d"] {
        let Some(path) = shared(&format!("data/{model}/cfg_args")) else { return };
        DeformConfig::open(&path).expect(model);
    }
    let Some(path) = shared("data/pth/deformable_standup_run256/cfg_args") else { return };
    assert_refused(DeformConfig::open(&path), &["load2gpu_on_the_fly", "unknown flag"]);
}

proptest! {
    #[test]
    fn random_text_never_panics(text: String) {
        prop_assert!(parse(&text).is_err());
        drop(with(&format!("custom_sampler={text}")));
    }

    #[test]
    fn random_bytes_never_panic(bytes: Vec<u8>) {
        prop_assert!(DeformConfig::parse(Path::new("cfg_args"), &bytes).is_err());
    }

    #[test]
    fn random_tokens_never_panic(tokens in prop::collection::vec(
        prop::sample::select(vec![
            "[", "]", "{", "}", "'", "\"", "\\", ",", ":", "=", "1", "-", ".", "e", "None", "é", "(", ")",
        ]),
        0..40)) {
        drop(with(&format!("custom_sampler={}", tokens.concat())));
    }
}
