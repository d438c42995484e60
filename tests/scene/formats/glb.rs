//! glTF binaries: new coefficients in place, and whole scenes.

use std::path::Path;

use guard4d_engine::scene::formats::glb::{GlbFile, encode};

use super::{assert_same_scene, golden_bytes, open_bytes};
use crate::scene::assert_refused;
use crate::support::fixture;

fn parse(bytes: &[u8]) -> Result<GlbFile, guard4d_engine::EngineError> {
    GlbFile::parse(Path::new("test.glb"), bytes.to_vec())
}

#[test]
fn coefficients_of_a_written_scene_are_the_same_to_the_bit() {
    let splats = fixture::gaussians(70, 2, 5);
    let bytes = encode(Path::new("test.glb"), &splats).expect("it fits");
    let back = parse(&bytes).and_then(|glb| glb.decode()).expect("our own file");
    assert_eq!(back.sh_coeffs, splats.sh_coeffs, "no rounding");
    assert_eq!(back.means, splats.means, "no rounding");
    // exp and ln, sigmoid and logit, and a norm, there and back.
    assert_same_scene(&back, &splats, 2e-6, "our own file");
}

#[test]
fn new_coefficients_change_no_other_byte() {
    let file = golden_bytes("scene.glb");
    let glb = parse(&file).expect("a glTF binary");
    let splats = glb.decode().expect("sound splats");
    assert_eq!(glb.with_words(None, &glb.words_of(None, &splats.sh_coeffs).expect("they fit")), file, "the same again");
    let mut other = splats.sh_coeffs.clone();
    other.iter_mut().for_each(|value| *value += 0.125);
    let marked = glb.with_words(None, &glb.words_of(None, &other).expect("they fit"));
    assert_eq!(parse(&marked).and_then(|glb| glb.decode()).expect("still good").sh_coeffs, other, "what was asked for");
    let changed = marked.iter().zip(&file).filter(|(a, b)| a != b).count();
    assert!(changed > 0 && changed <= 300 * 48 * 4, "{changed} bytes changed");
    // Two of three rows only: the row between keeps its bytes.
    let rows = [1, 299];
    let some = glb.words_of(Some(&rows), &other[..2 * 48]).expect("they fit");
    let partly = parse(&glb.with_words(Some(&rows), &some)).and_then(|glb| glb.decode()).expect("still good");
    assert_eq!(partly.sh_coeffs[48..2 * 48], other[..48], "row 1");
    assert_eq!(partly.sh_coeffs[299 * 48..], other[48..2 * 48], "row 299");
    assert_eq!(partly.sh_coeffs[..48], splats.sh_coeffs[..48], "row 0 stays");
}

#[test]
fn what_the_extension_does_not_allow_is_refused_by_name() {
    let file = golden_bytes("scene.glb");
    let text_end = 20 + u32::from_le_bytes(file[12..16].try_into().expect("four bytes")) as usize;
    let edit = |from: &str, to: &str| {
        let json = String::from_utf8(file[20..text_end].to_vec()).expect("text");
        assert!(json.contains(from), "{from} is there");
        let mut json = json.replacen(from, to, 1).into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let length = u32::try_from(20 + json.len() + file.len() - text_end).expect("short");
        let head = [&b"glTF"[..], &2_u32.to_le_bytes(), &length.to_le_bytes()].concat();
        let chunk = [&u32::try_from(json.len()).expect("short").to_le_bytes()[..], b"JSON", &json].concat();
        parse(&[head, chunk, file[text_end..].to_vec()].concat())
    };
    assert_refused(
        edit("\"KHR_gaussian_splatting:OPACITY\"", "\"OTHER\""),
        &["primitives[0]", "KHR_gaussian_splatting:OPACITY"],
    );
    assert_refused(edit("\"count\":300", "\"count\":301"), &["POSITION", "301 values", "inside"]);
    assert_refused(edit("\"componentType\":5126", "\"componentType\":5125"), &["POSITION", "5125"]);
    assert_refused(edit("\"byteOffset\":0", "\"byteOffset\":99999999"), &["inside"]);
    assert_refused(
        edit("\"extensions\":{\"KHR_gaussian_splatting\"", "\"extensions\":{\"OTHER\""),
        &["meshes", "no splats"],
    );
    assert_refused(parse(&file[..file.len() - 1]), &["length", "the bytes of the file"]);
    assert_refused(parse(b"glTF\x01\0\0\0"), &["version", "1", "2"]);
}

#[test]
fn an_opacity_is_a_share() {
    let splats = fixture::gaussians(1, 0, 1);
    let mut bytes = encode(Path::new("test.glb"), &splats).expect("it fits");
    let opacity = (1.0 / (1.0 + (-splats.opacities[0]).exp())).to_le_bytes();
    let at = bytes.windows(4).position(|w| w == opacity).expect("it is stored");
    bytes[at..at + 4].copy_from_slice(&1.5_f32.to_le_bytes());
    assert_refused(open_bytes("test.glb", &bytes), &["OPACITY of splat 0", "1.5", "0 to 1"]);
}
