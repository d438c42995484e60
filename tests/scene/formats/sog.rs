//! SOG archives with new base colours.

use std::io::{Cursor, Read as _, Write as _};
use std::path::Path;

use guard4d_engine::error::EngineError;
use guard4d_engine::scene::formats::sog::SogFile;
use serde_json::{Value, json};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::{golden_bytes, in_kind, moved, open_bytes_in_kind};
use crate::scene::assert_refused;
use crate::support::close::largest;
use crate::support::shared;

const NAME: &str = "scene.sog";
const META: &str = "meta.json";
const SH0: &str = "sh0.webp";

/// A file of an archive.
#[derive(Clone, Debug, PartialEq)]
struct Entry {
    name: String,
    content: Vec<u8>,
}

fn entries(archive: &[u8]) -> Vec<Entry> {
    let mut zip = ZipArchive::new(Cursor::new(archive)).expect("a ZIP archive");
    let count = zip.len();
    let entry = |index: usize| {
        let mut entry = zip.by_index(index).expect("an entry");
        let name = entry.name().expect("a name").into_owned();
        let mut content = Vec::new();
        entry.read_to_end(&mut content).expect("a whole file");
        Entry { name, content }
    };
    (0..count).map(entry).collect()
}

fn packed(entries: &[Entry], method: CompressionMethod) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.set_comment("kept").expect("a short comment");
    for entry in entries {
        let options = SimpleFileOptions::default().compression_method(method);
        zip.start_file(&*entry.name, options).expect("a new entry");
        zip.write_all(&entry.content).expect("memory");
    }
    zip.finish().expect("memory").into_inner()
}

/// The golden file with other files.
fn edited(edit: impl Fn(&mut Entry)) -> Vec<u8> {
    let mut entries = entries(&golden_bytes(NAME));
    entries.iter_mut().for_each(edit);
    packed(&entries, CompressionMethod::Stored)
}

/// The golden file with another description.
fn described(edit: impl Fn(&mut Value)) -> Vec<u8> {
    edited(|entry| {
        if entry.name == META {
            let mut meta: Value = serde_json::from_slice(&entry.content).expect("JSON");
            edit(&mut meta);
            entry.content = serde_json::to_vec(&meta).expect("JSON");
        }
    })
}

fn content(archive: &[u8], name: &str) -> Vec<u8> {
    entries(archive).into_iter().find(|entry| entry.name == name).expect(name).content
}

fn codebook(archive: &[u8]) -> Vec<f32> {
    let meta: Value = serde_json::from_slice(&content(archive, META)).expect("JSON");
    let codes = meta["sh0"]["codebook"].as_array().expect("a codebook");
    codes.iter().map(|code| code.as_f64().expect("a number") as f32).collect()
}

/// Colours and opacities of all splats.
fn texels(archive: &[u8]) -> Vec<u8> {
    let image = image::load_from_memory_with_format(&content(archive, SH0), image::ImageFormat::WebP);
    image.expect("a WebP image").into_rgba8().into_raw()
}

fn parse(bytes: &[u8]) -> Result<SogFile, EngineError> {
    SogFile::parse(Path::new(NAME), bytes.to_vec())
}

/// Fails unless each DC term that is stored is as near to the one that was asked for as any of the codebook.
fn assert_nearest(file: &[u8], [asked, stored]: &[Vec<f32>; 2]) {
    let codes = codebook(file);
    for (row, (asked, stored)) in asked.chunks_exact(48).zip(stored.chunks_exact(48)).enumerate() {
        for (asked, stored) in asked[..3].iter().zip(stored) {
            let nearest = -largest(codes.iter().map(|code| -(code - asked).abs()));
            assert!((asked - stored).abs() <= nearest, "splat {row}: {stored} for {asked}, which is {nearest} off");
        }
    }
}

#[test]
fn moved_base_colours_come_back_as_the_nearest_codes() {
    let file = golden_bytes(NAME);
    let coeffs = in_kind(NAME, &file, 0.02);
    assert_nearest(&file, &coeffs);
    let splats = parse(&file).expect("a SOG archive");
    let copy = splats.with_words(None, &splats.words_of(None, &coeffs[0]).expect("they fit"));
    let (before, after) = (entries(&file), entries(&copy));
    assert_eq!(before.len(), after.len(), "as many files");
    for (before, after) in before.iter().zip(&after) {
        assert_eq!(before.name, after.name, "in their order");
        assert_eq!(before.content == after.content, before.name != SH0, "{}", before.name);
    }
    let (before, after) = (texels(&file), texels(&copy));
    let changed: Vec<usize> = (0..before.len()).filter(|&at| before[at] != after[at]).collect();
    assert!(changed.len() > 300, "{} codes", changed.len());
    assert!(changed.iter().all(|at| at % 4 < 3 && *at < 4 * 300), "colours of splats alone");
    let back = parse(&copy).expect("our own file").with_words(None, &splats.words(None));
    assert_eq!(entries(&file).len(), entries(&back).len(), "as many files");
    assert_eq!(texels(&back), before, "the colours of the original");
}

#[test]
fn colours_of_splats_that_are_not_seen_come_through() {
    // Programs that pack pictures are free to drop the colour of what is transparent.
    let file = edited(|entry| {
        if entry.name == SH0 {
            let image = image::load_from_memory_with_format(&entry.content, image::ImageFormat::WebP);
            let mut image = image.expect("a WebP image").into_rgba8();
            image.pixels_mut().step_by(2).for_each(|pixel| pixel.0[3] = 0);
            entry.content.clear();
            image.write_to(&mut Cursor::new(&mut entry.content), image::ImageFormat::WebP).expect("memory");
        }
    });
    assert_nearest(&file, &in_kind(NAME, &file, 0.02));
}

#[test]
fn packed_archives_stay_packed_with_their_comment() {
    let file = packed(&entries(&golden_bytes(NAME)), CompressionMethod::Deflated);
    let splats = parse(&file).expect("a SOG archive");
    let words: Vec<u32> = splats.words(None).iter().map(|word| 255 - word).collect();
    let copy = splats.with_words(None, &words);
    assert!(copy == splats.with_words(None, &words), "the same bytes each time");
    let mut zip = ZipArchive::new(Cursor::new(&copy)).expect("a ZIP archive");
    assert_eq!(zip.comment(), b"kept");
    for index in 0..zip.len() {
        let method = zip.by_index(index).expect("an entry").compression();
        assert_eq!(method, CompressionMethod::Deflated, "file {index}");
    }
    assert_eq!(parse(&copy).expect("our own file").words(None), words, "what was asked for");
}

#[test]
fn colours_end_at_the_ends_of_the_codebook_in_whatever_order() {
    // Sorted, and with its halves exchanged.
    let exchanged = described(|meta| {
        meta["sh0"]["codebook"].as_array_mut().expect("a codebook").rotate_left(128);
    });
    for file in [golden_bytes(NAME), exchanged] {
        let splats = parse(&file).expect("a SOG archive");
        let codes = codebook(&file);
        let (low, high) = (-largest(codes.iter().map(|code| -code)), largest(codes.iter().copied()));
        for (asked, end) in [(low - 0.1, low), (-1e30, low), (high + 0.1, high), (1e30, high)] {
            let coeffs: Vec<f32> = (0..48).map(|i| if i < 3 { asked } else { 0.0 }).collect();
            let stored = splats.coeffs_of(Some(&[7]), &splats.words_of(Some(&[7]), &coeffs).expect("they fit"));
            assert_eq!(stored[..3], [end; 3], "{asked}");
        }
        assert_nearest(&file, &in_kind(NAME, &file, 0.02));
    }
}

#[test]
fn codes_that_mean_the_same_stay_apart() {
    // All codes have a twin, and the same colours are the same codes none the less.
    let file = described(|meta| {
        let codes = meta["sh0"]["codebook"].as_array_mut().expect("a codebook");
        (0..256).for_each(|i| codes[i] = json!(f64::from(u8::try_from(i / 2).expect("half of 256")) / 64.0 - 1.0));
    });
    assert_nearest(&file, &in_kind(NAME, &file, 0.02));
}

#[test]
fn splats_that_cannot_be_drawn_stay_as_they_are() {
    // A code beyond single precision: splats that have it are left out, and no other gets it.
    let code = texels(&golden_bytes(NAME))[0];
    let file = described(|meta| meta["sh0"]["codebook"][usize::from(code)] = json!(1e300));
    let model = open_bytes_in_kind(NAME, &file).expect("some are sound");
    assert!((1..300).contains(&model.gaussians.len()), "{} splats", model.gaussians.len());
    let asked = moved(&model, 0.3);
    let copy = model.with_words(&model.words_of(&asked).expect("they fit")).concat();
    let (before, after) = (texels(&file), texels(&copy));
    for (before, after) in before.chunks_exact(4).zip(after.chunks_exact(4)).take(300) {
        let is_broken = before[..3].contains(&code);
        assert!(if is_broken { before == after } else { !after[..3].contains(&code) }, "{before:?} {after:?}");
    }
    let read = open_bytes_in_kind(NAME, &copy).expect("a copy").gaussians.sh_coeffs;
    assert_eq!(read, model.as_stored(&asked).expect("they fit"), "as judged");
}

#[test]
fn a_texture_of_two_meanings_is_refused() {
    let file = described(|meta| meta["scales"]["files"][0] = json!(SH0));
    assert_refused(parse(&file), &["`sh0.files`", SH0, "a texture of its own"]);
    assert_refused(parse(&described(|meta| meta["version"] = json!(1))), &["version", "1", "2"]);
}

#[test]
fn entries_that_lie_over_each_other_are_refused() {
    let mut all = entries(&golden_bytes(NAME));
    all.push(Entry { name: "extra".to_owned(), content: vec![0; 40] });
    let mut file = packed(&all, CompressionMethod::Stored);
    assert!(parse(&file).is_ok(), "whatever else is in it");
    // Sizes are 20 and 24 bytes behind the start of a directory's entry, its name 46.
    let name = file.windows(5).rposition(|w| w == b"extra").expect("it is in the directory");
    let size = u32::try_from(file.len() - 100).expect("a small file").to_le_bytes();
    let first = all.iter().map(|entry| 30 + entry.name.len() + entry.content.len()).sum::<usize>();
    assert!(name > first, "the directory's entry");
    for at in [name - 26, name - 22] {
        file[at..at + 4].copy_from_slice(&size);
    }
    // Where it begins: before all others.
    file[name - 4..name].fill(0);
    assert_refused(parse(&file), &["packed bytes of all entries", &file.len().to_string()]);
}

#[test]
fn a_capture_changes_in_its_colours_alone() {
    let Some(file) = shared("data/static/skull.sog") else { return };
    let file = std::fs::read(file).expect("readable");
    let coeffs = in_kind("skull.sog", &file, 0.02);
    assert_nearest(&file, &coeffs.map(|c| c[..2000 * 48].to_vec()));
}
