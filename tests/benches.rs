//! The arithmetic behind the benchmarks' reports: nothing here is timed.

#[path = "../benches/report/chart.rs"]
mod chart;
#[path = "../benches/report/compare.rs"]
mod compare;
#[path = "../benches/harness/scene.rs"]
mod scene;
#[path = "../benches/report/stats.rs"]
mod stats;
#[path = "../benches/report/target.rs"]
mod target;

use chart::Bars;
use compare::{CORE_MS, JUDGED_BY, MS, NAME, QUARTILES, parse, table};
use guard4d_engine::base::tensor_file::TensorFile;
use roxmltree::{Document, Node};
use stats::{Quartiles, exponent};
use target::{Bound, Measured, TARGETS};

#[test]
fn quartiles_interpolate_and_refuse_what_is_no_number() {
    let of = |samples: &[f64]| {
        let Quartiles { low, median, high } = Quartiles::of(samples);
        [low, median, high]
    };
    assert_eq!(of(&[7.0]), [7.0; 3]);
    assert_eq!(of(&[4.0, 1.0, 3.0, 2.0]), [1.75, 2.5, 3.25], "as R, NumPy and spreadsheets do");
    assert_eq!(of(&[5.0, 1.0, 2.0, 4.0, 3.0]), [2.0, 3.0, 4.0]);
    assert_eq!(Quartiles::of(&[1.0, 2.0, 3.0, 4.0, 5.0]).spread(), 1.0 / 3.0);
    for none in [&[][..], &[1.0, f64::NAN, 2.0]] {
        assert!(of(none).iter().all(|q| q.is_nan()), "{none:?}");
    }
}

#[test]
fn scenes_for_other_implementations_hold_what_the_benchmark_draws() {
    const N: usize = 3;
    let (width, height) = (6, 6);
    let camera = scene::camera(6).expect("a size that cameras have");
    let splats = scene::splats(N, &camera);
    let image: Vec<f32> = (0..4 * width * height).map(|i| i as f32).collect();
    let folder = tempfile::tempdir().expect("a folder for the test");
    let path = folder.path().join("scene.safetensors");
    scene::write(&path, &splats, &camera, image.clone()).expect("it is written");
    let file = TensorFile::read(&path).expect("it is read back");
    for (name, shape, want) in [
        ("means", &[N, 3][..], &splats.means.concat()),
        ("quats", &[N, 4], &splats.quats.concat()),
        ("scales", &[N, 3], &splats.scales.concat()),
        ("opacities", &[N], &splats.opacities),
        ("sh_coeffs", &[N, 16, 3], &splats.sh_coeffs),
        ("image", &[height, width, 4], &image),
        ("viewmat", &[4, 4], &glam::Mat4::IDENTITY.to_cols_array().to_vec()),
    ] {
        assert_eq!(file.finite(name, shape).expect(name), want, "{name}");
    }
    let k = file.finite("intrinsics", &[3, 3]).expect("intrinsics");
    assert_eq!([k[2], k[5]], [3.0; 2], "the middle of the image, from its corner");
    assert_eq!([k[0], k[4]], [camera.fx, camera.fy]);
    scene::write(&path, &splats, &camera, vec![0.0; 4]).expect_err("a picture of another size");
}

#[test]
fn exponents_are_slopes_between_logarithms() {
    let law = |power: f64| -> Vec<(f64, f64)> {
        (0..5).map(|i| f64::from(1 << i)).map(|size| (size, 3.0 * size.powf(power))).collect()
    };
    for power in [0.0, 0.5, 1.0, 2.0] {
        let fitted = exponent(&law(power)).expect("five sizes");
        // Five logarithms are summed in f64.
        assert!((fitted - power).abs() < 1e-12, "{fitted} for {power}");
    }
    let bent = exponent(&[(1.0, 1.0), (2.0, 3.0), (4.0, 4.0)]).expect("three sizes");
    // With equal steps the middle point does not count: log 4 / log 4.
    assert!((bent - 1.0).abs() < 1e-12, "{bent}");
    for useless in [&[][..], &[(1.0, 1.0)], &[(2.0, 1.0), (2.0, 3.0)], &[(1.0, 1.0), (2.0, 0.0)]] {
        assert_eq!(exponent(useless), None, "{useless:?}");
    }
    assert_eq!(exponent(&[(1.0, 1.0), (2.0, f64::NAN)]), None, "a NaN gives no exponent");
}

/// A results file: name, clock, quartiles of the time by that clock. Other columns stand between.
fn results(rows: &[(&str, &str, [f64; 3])]) -> String {
    let mut text = NAME.to_owned();
    for clock in [MS, CORE_MS] {
        for end in QUARTILES {
            text.push_str(&format!(",{clock}{end}"));
        }
    }
    text.push_str(&format!(",work,{JUDGED_BY}\n"));
    for (name, judged_by, quartiles) in rows {
        let numbers = quartiles.map(|q| q.to_string()).join(",");
        let other = "1,1,1";
        let both = if *judged_by == MS { format!("{numbers},{other}") } else { format!("{other},{numbers}") };
        text.push_str(&format!("\"{name}\",{both},\"2·m, or so\",{judged_by}\n"));
    }
    text
}

/// The line of a comparison that ends with this row's name and verdict.
fn compared(a: [f64; 3], b: [f64; 3]) -> String {
    let [a, b] = [a, b].map(|q| parse(&results(&[("nn/x 3, 4", CORE_MS, q)])).expect("well-formed"));
    let text = table(&a, &b);
    text.lines().find(|line| line.contains("nn/x 3, 4")).expect("the row is there").to_owned()
}

#[test]
fn comparisons_flag_what_exceeds_a_tenth_and_the_spread() {
    let steady = [99.0, 100.0, 101.0];
    let slower = compared(steady, [118.0, 120.0, 122.0]);
    assert!(slower.ends_with("SLOWER") && slower.contains("1.200"), "{slower}");
    assert!(compared(steady, [79.0, 80.0, 81.0]).ends_with("faster"), "a gain is told too");
    assert!(compared(steady, [107.0, 108.0, 109.0]).ends_with("nn/x 3, 4"), "less than a tenth");
    assert!(compared(steady, [80.0, 120.0, 160.0]).ends_with("nn/x 3, 4"), "within the spread of B");
    assert!(compared([60.0, 100.0, 140.0], [118.0, 120.0, 122.0]).ends_with("nn/x 3, 4"), "within the spread of A");
    for no_number in [[f64::NAN; 3], [0.0; 3], [1.0, f64::INFINITY, 1.0]] {
        let line = compared(no_number, steady);
        assert!(line.ends_with("no comparison"), "{line}");
    }
}

#[test]
fn comparisons_name_what_only_one_run_has() {
    let row = |name, clock| (name, clock, [1.0, 1.0, 1.0]);
    let a = parse(&results(&[row("old", CORE_MS), row("both", CORE_MS)])).expect("well-formed");
    let b = parse(&results(&[row("both", MS), row("new", MS)])).expect("well-formed");
    let text = table(&a, &b);
    assert!(text.contains("only in A: old") && text.contains("only in B: new"), "{text}");
    assert!(text.contains("1 without comparison"), "another clock: {text}");
}

#[test]
fn results_of_another_form_are_refused_by_line() {
    let old = parse("name,median_ms\n\"nn/x\",1.5\n").expect_err("no such columns");
    assert_eq!((old.line, old.got.as_str()), (1, "no such column"), "{}", old.expected);
    let good = results(&[("nn/x", CORE_MS, [1.0, 2.0, 3.0])]);
    let word = parse(&good.replace(",2,", ",two,")).expect_err("a word");
    assert_eq!((word.line, word.got.as_str()), (2, "two"), "{}", word.expected);
    let short = parse(&format!("{good}\"nn/y\",1\n")).expect_err("a line that was cut off");
    assert_eq!((short.line, short.got.as_str()), (3, "2 cells"), "{}", short.expected);
}

#[test]
fn targets_are_met_by_numbers_alone() {
    let (least, most) = (Bound::AtLeast(30.0, Some(38.0)), Bound::AtMost(20.0, None));
    for (bound, value, verdict) in [
        (least, Some(38.0), "met, with the stretch"),
        (least, Some(30.0), "met"),
        (least, Some(29.9), "**not met**"),
        (least, Some(f64::NAN), "**not met**"),
        (most, Some(20.0), "met"),
        (most, Some(20.1), "**not met**"),
        (most, Some(f64::NAN), "**not met**"),
        (most, None, "not measured"),
    ] {
        assert_eq!(bound.verdict(value), verdict, "{bound:?} {value:?}");
    }
    let figures = Measured { median: 1.06, best: 0.97 };
    let text = target::table(|target| (target.row == "V").then_some(figures));
    assert_eq!(text.lines().count(), TARGETS.len() + 2, "a line for every target");
    assert!(text.contains("| cost over views | V | ≤ 1.05 |  | 1.06 | 0.97 | met | **not met** |"), "{text}");
    assert_eq!(text.matches("not measured").count(), 2 * (TARGETS.len() - 1), "{text}");
}

/// Words of a picture with the room that they take: left, top, right, bottom.
fn words_of(picture: &str) -> Vec<(String, [f64; 4])> {
    let document = Document::parse(picture).expect("a picture is XML");
    let texts = document.descendants().filter(|node| node.has_tag_name("text"));
    let area = |node: &Node<'_, '_>, words: &str| {
        let number = |name: &str| node.attribute(name).and_then(|v| v.parse::<f64>().ok()).expect("a number");
        let (x, y, size) = (number("x"), number("y"), number("font-size"));
        // Digits and small letters of DejaVu Sans, one of the widest fonts, take 0.65 of their size.
        let wide = 0.65 * size * words.chars().count() as f64;
        let left = match node.attribute("text-anchor") {
            Some("start") => x,
            Some("middle") => x - 0.5 * wide,
            _ => x - wide,
        };
        [left, y - 0.5 * size, left + wide, y + 0.5 * size]
    };
    texts
        .map(|node| {
            let words = node.text().unwrap_or_default().trim().to_owned();
            let area = area(&node, &words);
            (words, area)
        })
        .collect()
}

#[test]
fn the_chart_shows_each_share_and_stays_inside() {
    let bars = |name: &str, shares| Bars { name: name.to_owned(), shares };
    let rows = [
        bars("a<b", [Some(50.0), None]),
        bars("cached", [Some(250.0), Some(f64::NAN)]),
        bars("a row with a name that is rather long, 512 x 512", [Some(50.0), Some(51.0)]),
    ];
    let picture = chart::svg(["share of the device's peak in this run", "core"], &rows);
    let words = words_of(&picture);
    for shown in ["a<b", "50 %", "250 %", "51 %", "core"] {
        assert!(words.iter().any(|(words, _)| words == shown), "`{shown}`: {words:?}");
    }
    assert!(!picture.contains("NaN"), "{picture}");
    let document = Document::parse(&picture).expect("a picture is XML");
    let size = |name: &str| document.root_element().attribute(name).and_then(|v| v.parse::<f64>().ok());
    let (width, height) = (size("width").expect("a width"), size("height").expect("a height"));
    for (i, (one, area)) in words.iter().enumerate() {
        let [left, top, right, bottom] = *area;
        assert!(left >= 0.0 && top >= 0.0 && right <= width && bottom <= height, "`{one}` leaves the picture");
        for (other, beside) in &words[..i] {
            let is_apart = right <= beside[0] || beside[2] <= left || bottom <= beside[1] || beside[3] <= top;
            assert!(is_apart, "`{one}` lies over `{other}`: {area:?} {beside:?}");
        }
    }
    // Four bars and two squares of the legend; full scale is 400 px, which a bar does not pass.
    assert_eq!(picture.matches(" height=\"8\"").count(), 6, "{picture}");
    assert_eq!(picture.matches(" width=\"400\"").count(), 1, "{picture}");
    assert_eq!(picture.matches(" width=\"200\"").count(), 2, "{picture}");
}
