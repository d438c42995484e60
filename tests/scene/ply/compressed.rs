//! Compressed PLY files with new base colours.

use std::path::Path;

use guard4d_engine::scene::gaussians::Y0;
use guard4d_engine::scene::ply::CompressedPlyFile;

use crate::scene::assert_refused;
use crate::scene::formats::{golden, golden_bytes, in_kind, moved, open_bytes_in_kind};
use crate::support::close::largest;

const NAME: &str = "scene.compressed.ply";
/// Bytes of a chunk's record, those of its colours at the end of it, and bytes of a splat.
const CHUNK: usize = 72;
const COLOURS: usize = 24;
const SPLAT: usize = 16;
const SPLATS_PER_CHUNK: usize = 256;

fn parse(bytes: &[u8]) -> CompressedPlyFile {
    CompressedPlyFile::parse(Path::new(NAME), bytes.to_vec()).expect("a compressed PLY")
}

/// Where the records begin.
fn body(file: &[u8]) -> usize {
    let end = b"end_header\n";
    end.len() + file.windows(end.len()).position(|w| w == end).expect("a head")
}

/// Where the bounds of a chunk's colours are: lowest red, green and blue, then highest.
fn bounds(file: &[u8], chunk: usize) -> usize {
    body(file) + CHUNK * (chunk + 1) - COLOURS
}

fn float(file: &[u8], at: usize) -> f64 {
    f32::from_le_bytes(*file[at..].first_chunk().expect("four bytes")).into()
}

/// The same file from before there were bounds of colours, so that the same bytes are colours from 0 to 1.
fn without_colour_bounds(file: &[u8]) -> Vec<u8> {
    let start = body(file);
    let head = String::from_utf8(file[..start].to_vec()).expect("text");
    let is_bound =
        |line: &str| ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"].iter().any(|b| line.ends_with(b));
    let mut out: Vec<u8> =
        head.lines().filter(|line| !is_bound(line)).flat_map(|l| format!("{l}\n").into_bytes()).collect();
    for chunk in 0..2 {
        out.extend(&file[start + CHUNK * chunk..][..CHUNK - COLOURS]);
    }
    out.extend(&file[start + 2 * CHUNK..]);
    out
}

#[test]
fn moved_base_colours_come_back_to_within_half_a_step_of_their_chunk() {
    let file = golden_bytes(NAME);
    let [asked, stored] = in_kind(NAME, &file, 0.02);
    for (row, (asked, stored)) in asked.chunks_exact(48).zip(stored.chunks_exact(48)).enumerate() {
        for channel in 0..3 {
            let at = bounds(&file, row / SPLATS_PER_CHUNK) + 4 * channel;
            let (low, high) = (float(&file, at), float(&file, at + COLOURS / 2));
            let [asked, stored] = [asked, stored].map(|c| 0.5 + Y0 * f64::from(c[channel]));
            let error = (asked.clamp(low, high) - stored).abs();
            // Roundings of values up to 1.8 come on top.
            assert!(error < 1e-6 + (high - low) / 255.0 / 2.0, "splat {row}, channel {channel}: {error}");
        }
    }
    let splats = parse(&file);
    let copy = splats.with_words(None, &splats.words_of(None, &asked).expect("they fit"));
    let first = body(&file) + 2 * CHUNK;
    let changed: Vec<usize> = (0..file.len()).filter(|&at| file[at] != copy[at]).collect();
    assert!(changed.len() > 300, "{} bytes", changed.len());
    // Opacity is the first byte of the last of four words.
    let is_colour = |at: usize| (first..first + 300 * SPLAT).contains(&at) && (at - first) % SPLAT > 12;
    assert!(changed.iter().all(|&at| is_colour(at)), "colours alone");
}

#[test]
fn files_without_bounds_hold_colours_from_0_to_1() {
    let file = without_colour_bounds(&golden_bytes(NAME));
    let [asked, stored] = in_kind(NAME, &file, 0.02);
    let colour = |dc: &f32| 0.5 + Y0 * f64::from(*dc);
    let errors = asked.iter().zip(&stored).map(|(a, b)| (colour(a).clamp(0.0, 1.0) - colour(b)).abs());
    let worst = largest(errors);
    assert!(worst < 1e-6 + 0.5 / 255.0, "{worst}");
}

#[test]
fn colours_end_at_the_bounds_of_their_chunk() {
    let file = golden_bytes(NAME);
    let splats = parse(&file);
    for (far, end) in [(-1e6, 0), (1e6, 255), (-1e30, 0), (1e30, 255)] {
        let mut asked = vec![0.0; 300 * 48];
        asked.chunks_exact_mut(48).for_each(|splat| splat[..3].fill(far));
        let words = splats.words_of(None, &asked).expect("they fit");
        assert!(words.iter().all(|word| *word == end), "{far}");
        let stored = splats.coeffs_of(None, &words);
        for (row, splat) in stored.chunks_exact(48).enumerate() {
            let at = bounds(&file, row / SPLATS_PER_CHUNK) + if end == 0 { 0 } else { COLOURS / 2 };
            for (channel, dc) in splat[..3].iter().enumerate() {
                let colour = 0.5 + Y0 * f64::from(*dc);
                assert!((colour - float(&file, at + 4 * channel)).abs() < 1e-6, "splat {row}: {colour}");
            }
        }
    }
}

#[test]
fn a_chunk_of_one_colour_keeps_its_bytes() {
    let mut file = golden_bytes(NAME);
    let at = bounds(&file, 0);
    let low = file[at..at + COLOURS / 2].to_vec();
    file[at + COLOURS / 2..at + COLOURS].copy_from_slice(&low);
    let model = open_bytes_in_kind(NAME, &file).expect("a compressed PLY");
    let copy = model.with_words(&model.words_of(&moved(&model, 0.5)).expect("they fit")).concat();
    let first = body(&file) + 2 * CHUNK;
    let (middle, end) = (first + SPLATS_PER_CHUNK * SPLAT, first + 300 * SPLAT);
    assert!(copy[..middle] == file[..middle], "no byte is nearer than another");
    assert!(copy[middle..end] != file[middle..end], "the other chunk");
}

#[test]
fn splats_that_cannot_be_drawn_stay_as_they_are() {
    let mut file = golden_bytes(NAME);
    // Red of the second chunk has no bounds.
    let at = bounds(&file, 1);
    file[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let model = open_bytes_in_kind(NAME, &file).expect("a chunk is sound");
    assert_eq!(model.gaussians.len(), SPLATS_PER_CHUNK, "the second one is left out");
    let asked = moved(&model, 0.1);
    let words = model.words_of(&asked).expect("they fit");
    let copy = model.with_words(&words).concat();
    let middle = body(&file) + 2 * CHUNK + SPLATS_PER_CHUNK * SPLAT;
    assert!(copy[middle..] == file[middle..] && copy[..middle] != file[..middle], "the first one alone changes");
    let read = open_bytes_in_kind(NAME, &copy).expect("a copy").gaussians.sh_coeffs;
    assert_eq!(read, model.as_stored(&asked).expect("they fit"), "as judged");
}

#[test]
fn what_is_not_whole_is_refused() {
    let file = golden_bytes(NAME);
    let cut = |length: usize| CompressedPlyFile::parse(Path::new(NAME), file[..length].to_vec());
    assert_refused(cut(file.len() - 1), &["body"]);
    assert_refused(cut(body(&file) - 1), &["header"]);
    let plain = std::fs::read(golden("scene.ply")).expect("a PLY");
    assert_refused(CompressedPlyFile::parse(Path::new("scene.ply"), plain), &["chunk"]);
}
