//! PLY files: read by name, refused with a reason, and written back byte for byte.

use std::path::Path;

use guard4d_engine::scene::PlyFile;
use guard4d_engine::scene::gaussians::SH_FLOATS;
use guard4d_engine::scene::ply::encode;
use proptest::prelude::*;

use crate::scene::assert_refused;
use crate::support::fixture::gaussians;
use crate::support::shared;

fn parse(bytes: &[u8]) -> Result<PlyFile, guard4d_engine::EngineError> {
    PlyFile::parse(Path::new("test.ply"), bytes.to_vec())
}

/// Decodes after parsing; ASCII numbers only show then.
fn decode(bytes: &[u8]) -> Result<guard4d_engine::scene::Gaussians, guard4d_engine::EngineError> {
    parse(bytes)?.decode()
}

/// Splits an encoded file into its head and body.
fn split(bytes: &[u8]) -> (String, Vec<u8>) {
    let mark = b"end_header\n";
    let end = bytes.windows(mark.len()).position(|w| w == mark).expect("an encoded PLY has a head") + mark.len();
    let head = String::from_utf8(bytes[..end].to_vec()).expect("the head is text");
    (head, bytes[end..].to_vec())
}

fn join(head: &str, body: &[u8]) -> Vec<u8> {
    [head.as_bytes(), body].concat()
}

fn values(body: &[u8]) -> Vec<f32> {
    body.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

#[test]
fn sh_values_lie_channel_major_in_the_file() {
    let splats = gaussians(2, 3, 1);
    let (_, body) = split(&encode(&splats));
    let stored = values(&body);
    let per_splat = stored.len() / 2;
    for (splat, record) in stored.chunks_exact(per_splat).enumerate() {
        let sh = &splats.sh_coeffs[splat * SH_FLOATS..][..SH_FLOATS];
        for channel in 0..3 {
            assert_eq!(record[6 + channel], sh[channel], "f_dc_{channel}");
            for basis in 1..16 {
                let index = 15 * channel + basis - 1;
                assert_eq!(record[9 + index], sh[basis * 3 + channel], "f_rest_{index}");
            }
        }
    }
}

#[test]
fn all_encodings_of_the_same_splats_decode_alike() {
    let splats = gaussians(5, 2, 2);
    let (head, body) = split(&encode(&splats));
    let floats = values(&body);
    let big = head.replace("little", "big");
    let big_body: Vec<u8> = floats.iter().flat_map(|value| value.to_be_bytes()).collect();
    let double = head.replace("property float", "property double");
    let double_body: Vec<u8> = floats.iter().flat_map(|value| f64::from(*value).to_le_bytes()).collect();
    let ascii = head.replace("binary_little_endian", "ascii");
    let ascii_body: String = floats.iter().map(|value| format!("{value} ")).collect();
    let crlf = head.replace('\n', "\r\n");
    for (name, file) in [
        ("big endian", join(&big, &big_body)),
        ("double", join(&double, &double_body)),
        ("ascii", join(&ascii, ascii_body.as_bytes())),
        ("CRLF", join(&crlf, &body)),
    ] {
        assert_eq!(decode(&file).expect(name), splats, "{name}");
    }
}

#[test]
fn properties_are_found_by_name_and_others_are_kept() {
    let splats = gaussians(3, 1, 3);
    let (head, body) = split(&encode(&splats));
    let head = head
        .replace("property float x\n", "comment first\nproperty uchar mark\nproperty float x\n")
        .replace("end_header", "property short tail\nend_header");
    let stride = body.len() / 3;
    let records: Vec<u8> = body.chunks_exact(stride).flat_map(|r| [&[7_u8], r, &[1, 2]].concat()).collect();
    let file = join(&head, &records);
    let ply = parse(&file).expect("extra properties are accepted");
    assert_eq!(ply.decode().expect("the values are finite"), splats);
    let other = gaussians(3, 1, 4).sh_coeffs;
    let marked = ply.with_sh(None, &other).expect("SH can be replaced");
    assert_eq!(decode(&marked).expect("still a PLY").sh_coeffs, other);
    assert_eq!(parse(&marked).expect("still a PLY").with_sh(None, &splats.sh_coeffs).expect("and back"), file);
}

#[test]
fn elements_before_and_after_the_splats_are_kept() {
    let splats = gaussians(2, 0, 5);
    let (head, body) = split(&encode(&splats));
    let head = head
        .replace("element vertex", "element before 2\nproperty short a\nelement vertex")
        .replace("end_header", "element after 1\nproperty double b\nend_header");
    let file = join(&head, &[&[1, 2, 3, 4], body.as_slice(), &[5; 8]].concat());
    let ply = parse(&file).expect("other elements are accepted");
    assert_eq!(ply.decode().expect("the values are finite"), splats);
    assert_eq!(ply.with_sh(None, &splats.sh_coeffs).expect("SH can be replaced"), file);
}

#[test]
fn wrong_heads_are_refused_with_their_line() {
    let (head, body) = split(&encode(&gaussians(2, 0, 6)));
    let edit = |from: &str, to: &str| parse(&join(&head.replacen(from, to, 1), &body));
    assert_refused(parse(b""), &["header", "no `end_header`"]);
    assert_refused(parse(b"PK\x03\x04 not a ply\n"), &["header line 1", "`ply`"]);
    assert_refused(parse(&head.as_bytes()[..40]), &["no `end_header`"]);
    assert_refused(edit("format binary_little_endian 1.0\n", ""), &["no `format` line"]);
    assert_refused(edit("little_endian", "middle_endian"), &["header line 2", "binary_middle_endian"]);
    assert_refused(edit("element vertex 2", "element vertex many"), &["header line 3", "`many`"]);
    assert_refused(edit("element vertex 2", "element vertex -2"), &["header line 3", "`-2`"]);
    assert_refused(edit("element vertex", "element face"), &["no `vertex` element"]);
    assert_refused(edit("property float x\n", "property float y\n"), &["`y` a second time"]);
    assert_refused(edit("property float nx", "property list uchar int nx"), &["list properties are not read"]);
    assert_refused(edit("property float nx", "property quad nx"), &["type `quad`"]);
    assert_refused(edit("property float nx", "prop float nx"), &["`prop float nx`"]);
    assert_refused(edit("element vertex 2\n", "property float q\nelement vertex 2\n"), &["before any element"]);
}

#[test]
fn missing_and_mistyped_properties_are_refused_by_name() {
    let (head, body) = split(&encode(&gaussians(2, 3, 7)));
    let edit = |from: &str, to: &str| parse(&join(&head.replacen(from, to, 1), &body));
    for name in ["x", "f_dc_1", "opacity", "scale_2", "rot_3"] {
        let property = format!("property float {name}\n");
        assert_refused(edit(&property, "property float other\n"), &[&format!("`{name}`"), "missing"]);
        assert_refused(edit(&property, &format!("property int {name}\n")), &[&format!("`{name}`"), "I32"]);
    }
    assert_refused(edit("f_rest_44", "other"), &["f_rest_*", "44 properties", "0, 9, 24 or 45"]);
    assert_refused(edit("f_rest_44", "f_rest_45"), &["`f_rest_44`", "missing"]);
}

#[test]
fn bodies_of_another_length_are_refused_with_both_lengths() {
    let file = encode(&gaussians(2, 3, 8));
    let (head, body) = split(&file);
    assert_eq!(body.len(), 2 * 248, "an INRIA splat has 248 bytes");
    assert_refused(parse(&file[..file.len() - 1]), &["body", "495 bytes", "496 (2 `vertex` records of 248 bytes)"]);
    assert_refused(parse(&[file.as_slice(), &[0]].concat()), &["body", "497 bytes", "496"]);
    assert_refused(parse(&join(&head.replace("vertex 2", "vertex 0"), &[])), &["0 splats", "at least one"]);
    let huge = head.replace("vertex 2", &format!("vertex {}", usize::MAX));
    assert_refused(parse(&join(&huge, &body)), &["body", "more than memory can hold"]);
}

#[test]
fn broken_ascii_numbers_are_refused_by_place() {
    let (head, _) = split(&encode(&gaussians(1, 0, 9)));
    let head = head.replace("binary_little_endian", "ascii");
    let numbers = "1 ".repeat(17);
    assert!(decode(&join(&head, numbers.as_bytes())).is_ok(), "17 numbers are one splat of degree 0");
    assert_refused(decode(&join(&head, numbers.replacen('1', "one", 1).as_bytes())), &["record 0, `x`", "`one`"]);
    assert_refused(decode(&join(&head, &numbers.as_bytes()[2..])), &["`rot_3`", "end of file"]);
    assert_refused(decode(&join(&head, format!("{numbers} 1").as_bytes())), &["after the end"]);
    let huge = head.replace("vertex 1", "vertex 99999999999999");
    assert_refused(parse(&join(&huge, numbers.as_bytes())), &["element `vertex`", "99999999999999", "have room for"]);
}

#[test]
fn new_sh_values_that_do_not_fit_are_refused() {
    let ply = parse(&encode(&gaussians(2, 1, 12))).expect("a good file");
    let mut sh = gaussians(2, 1, 13).sh_coeffs;
    let usage = |sh: &[f32]| {
        let error = ply.with_sh(None, sh).expect_err("the values do not fit");
        assert_eq!(error.exit_code(), 2, "{error}");
        error.to_string()
    };
    assert!(usage(&sh[1..]).contains("95 values"), "the number of values is named");
    sh[SH_FLOATS + 12] = 1.0;
    assert!(usage(&sh).contains("values above degree 1 at splat 1"), "the degree is named");
    sh[3] = f32::NAN;
    assert!(usage(&sh).contains("NaN at splat 0"), "the splat is named");
}

#[test]
fn sh_of_ascii_and_double_files_cannot_be_replaced() {
    let splats = gaussians(1, 0, 14);
    let (head, body) = split(&encode(&splats));
    let ascii = head.replace("binary_little_endian", "ascii");
    let text: String = values(&body).iter().map(|value| format!("{value} ")).collect();
    let ply = parse(&join(&ascii, text.as_bytes())).expect("ASCII is read");
    assert_refused(ply.with_sh(None, &splats.sh_coeffs), &["format", "ascii", "binary PLY"]);
    let double = head.replace("property float f_dc_0", "property double f_dc_0");
    let ply = parse(&join(&double, &[body.as_slice(), &[0; 4]].concat())).expect("doubles are read");
    assert_refused(ply.with_sh(None, &splats.sh_coeffs), &["`f_dc_0`", "double"]);
}

#[test]
fn real_files_come_back_byte_for_byte() {
    let files = [
        ("data/static/three_points_from_train.ply", 3),
        ("data/static/fruit_drops_minimal.ply", 4721),
        ("data/models/fox/point_cloud/iteration_20000/point_cloud.ply", 19867),
    ];
    for (file, count) in files {
        let Some(path) = shared(file) else { return };
        let ply = PlyFile::open(&path).expect(file);
        let splats = ply.decode().expect(file);
        assert_eq!((ply.len(), splats.len(), splats.sh_degree), (count, count, 3), "{file}");
        assert_eq!(ply.with_sh(None, &splats.sh_coeffs).expect(file), ply.bytes(), "{file}");
    }
}

#[test]
fn compressed_ply_is_refused_as_such() {
    let Some(path) = shared("data/static/biker.compressed.ply") else { return };
    assert_refused(PlyFile::open(&path), &["f_dc_0", "missing", "uncompressed INRIA 3DGS PLY"]);
}

#[test]
fn a_missing_file_and_a_folder_have_their_own_errors() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let missing = PlyFile::open(&folder.path().join("no.ply")).expect_err("nothing is there");
    assert_eq!(missing.exit_code(), 66, "{missing}");
    assert_refused(PlyFile::open(folder.path()), &["not a regular file"]);
}

proptest! {
    #[test]
    fn any_splats_survive_encoding(count in 1_usize..20, degree in 0_u32..4, seed: u64) {
        let splats = gaussians(count, degree, seed);
        let file = encode(&splats);
        prop_assert_eq!(decode(&file).expect("an encoded file is good"), splats.clone());
        let ply = parse(&file).expect("an encoded file is good");
        let other = gaussians(count, degree, seed ^ 1);
        let marked = ply.with_sh(None, &other.sh_coeffs).expect("the values fit");
        prop_assert_eq!(&decode(&marked).expect("still good"), &guard4d_engine::scene::Gaussians {
            sh_coeffs: other.sh_coeffs.clone(), ..splats.clone()
        });
        let undone = parse(&marked).expect("still good").with_sh(None, &splats.sh_coeffs).expect("the values fit");
        prop_assert_eq!(undone, file);
    }

    #[test]
    fn random_bytes_never_panic(bytes: Vec<u8>) {
        prop_assert!(decode(&bytes).is_err());
        prop_assert!(decode(&[b"ply\n".as_slice(), &bytes].concat()).is_err());
    }

    #[test]
    fn damaged_files_never_panic(at in 0_usize..2000, value: u8, cut in 0_usize..2000) {
        let mut file = encode(&gaussians(3, 3, 1));
        let at = at % file.len();
        file[at] = value;
        let kept = file.len() - cut % file.len();
        drop(decode(&file));
        drop(decode(&file[..kept]));
    }
}
