//! Compressed PLY files (`SuperSplat`): chunks of 256 splats, each splat packed into four words between its chunk's
//! bounds.

use std::path::{Path, PathBuf};

use super::body::{self, start_of};
use super::header::{Element, Encoding, Header, Scalar, VERTEX, degree_of};
use crate::base::files::bad_data;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::formats::steps::nearest_byte;
use crate::scene::formats::values::{logit_of_byte, with_capacity, with_largest};
use crate::scene::gaussians::{CHANNELS, Gaussians, SH_FLOATS, Y0, check_coeffs, dc_of_colour, sh_bases};
use crate::scene::limits::check_splats;

const CHUNK: &str = "chunk";
const SH: &str = "sh";
const SPLATS_PER_CHUNK: usize = 256;
/// Splats are four words.
const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
/// The one with the colour: red, green, blue and opacity, the first in the highest byte.
const COLOUR: usize = 3;
const PACKED_BYTES: usize = PACKED.len() * size_of::<u32>();
/// SH behind the DC terms lie in -4 to 4, in 256 steps.
const SH_RANGE: f32 = 8.0;

/// Whether a PLY file is of this kind; damaged ones are not.
pub(in crate::scene) fn is_compressed(bytes: &[u8]) -> bool {
    Header::parse(Path::new(""), bytes).is_ok_and(|header| element(&header, CHUNK).is_some())
}

fn element<'a>(header: &'a Header, name: &str) -> Option<(usize, &'a Element)> {
    header.elements.iter().enumerate().find(|(_, element)| element.name == name)
}

/// A compressed PLY whose base colours can be replaced, rounded to the nearest step of their chunk and cut off at its
/// bounds: an offset of less than half a step from one of them is lost. All other bytes stay as read.
#[derive(Clone, Debug)]
pub struct CompressedPlyFile {
    path: PathBuf,
    bytes: Vec<u8>,
    comments: Vec<String>,
    layout: Layout,
}

impl CompressedPlyFile {
    /// Takes over `bytes`, which came from `path`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the element or property that is missing or of another type, and counts that do
    /// not fit together.
    pub fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, EngineError> {
        let header = Header::parse(path, &bytes)?;
        let layout = Layout::find(path, &header, bytes.len())?;
        Ok(Self { path: path.to_path_buf(), bytes, comments: header.comments, layout })
    }

    /// The splats, those with values that are not finite among them.
    #[must_use]
    pub fn decode(&self) -> Gaussians {
        self.layout.decode(&self.bytes)
    }

    /// Where the bytes came from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file's bytes as read.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Comments of the head, line by line.
    #[must_use]
    pub fn comments(&self) -> &[String] {
        &self.comments
    }

    /// Number of splats.
    #[must_use]
    pub fn splats(&self) -> usize {
        self.layout.splats.count
    }

    /// The colour bytes of the splats `rows`, or of all, as words: red, green and blue.
    #[must_use]
    pub fn words(&self, rows: Option<&[u32]>) -> Vec<u32> {
        self.rows(rows).flat_map(|row| self.layout.colour(&self.bytes, row)).map(u32::from).collect()
    }

    /// The words that DC terms are stored as: the nearest colours of their chunk. Other coefficients have no place
    /// here.
    ///
    /// # Shapes
    /// in `sh_coeffs` \[rows,16,3\] coefficient-major
    ///
    /// # Errors
    /// [`EngineError::Usage`] for coefficients that do not fit.
    pub fn words_of(&self, rows: Option<&[u32]>, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        check_coeffs(rows.map_or(self.splats(), <[u32]>::len), self.layout.sh_degree(), sh_coeffs)?;
        let splats = self.rows(rows).zip(sh_coeffs.chunks_exact(SH_FLOATS));
        let words = splats.flat_map(|(row, splat)| {
            let (spans, stored) = (self.layout.spans(&self.bytes, row), self.layout.colour(&self.bytes, row));
            (0..CHANNELS).map(move |i| spans[i].nearest(splat[i], stored[i]).into())
        });
        Ok(words.collect())
    }

    /// The coefficients that words are read as, with those behind the DC terms as they are in the file.
    ///
    /// # Shapes
    /// out \[rows,16,3\] coefficient-major
    #[must_use]
    pub fn coeffs_of(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<f32> {
        let mut coeffs = vec![0.0; words.len() / CHANNELS * SH_FLOATS];
        let splats = coeffs.chunks_exact_mut(SH_FLOATS).zip(words.chunks_exact(CHANNELS));
        for ((splat, words), row) in splats.zip(self.rows(rows)) {
            let spans = self.layout.spans(&self.bytes, row);
            for ((coeff, word), span) in splat.iter_mut().zip(words).zip(spans) {
                *coeff = span.dc(word.to_le_bytes()[0]);
            }
            if let Some(rest) = &self.layout.rest {
                rest.read(&self.bytes, row, splat);
            }
        }
        coeffs
    }

    /// The file with other words in the places of [`CompressedPlyFile::words`].
    #[must_use]
    pub fn with_words(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        for (row, splat) in self.rows(rows).zip(words.chunks_exact(CHANNELS)) {
            // The highest byte of the word is red, the lowest opacity.
            let at = self.layout.splats.at(row) + self.layout.words[COLOUR];
            for (byte, word) in bytes[at + 1..=at + CHANNELS].iter_mut().rev().zip(splat) {
                *byte = word.to_le_bytes()[0];
            }
        }
        bytes
    }

    fn rows<'a>(&self, rows: Option<&'a [u32]>) -> impl Iterator<Item = usize> + use<'a> {
        let count = rows.map_or(self.splats(), <[u32]>::len);
        (0..count).map(move |index| rows.map_or(index, |rows| rows[index] as usize))
    }
}

/// Reads the splats of a compressed PLY.
///
/// # Errors
/// Those of [`CompressedPlyFile::parse`].
pub(in crate::scene) fn decode_compressed(path: &Path, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    let layout = Layout::find(path, &Header::parse(path, bytes)?, bytes.len())?;
    Ok(layout.decode(bytes))
}

/// The records of an element.
#[derive(Clone, Debug)]
struct Records {
    start: usize,
    stride: usize,
    count: usize,
}

impl Records {
    fn of(header: &Header, index: usize) -> Self {
        let element = &header.elements[index];
        Self { start: start_of(header, index), stride: element.stride, count: element.count }
    }

    /// Where record number `row` is.
    fn at(&self, row: usize) -> usize {
        self.start + self.stride * row
    }

    /// The four bytes of a property of record number `row`.
    fn word(&self, bytes: &[u8], row: usize, offset: usize) -> [u8; 4] {
        *bytes[self.at(row) + offset..].first_chunk().expect("the body's length was checked")
    }
}

/// What a byte of a colour means: a share of the way between the bounds of its chunk.
#[derive(Clone, Copy, Debug)]
struct Span {
    low: f32,
    high: f32,
}

impl Span {
    fn dc(self, byte: u8) -> f32 {
        dc_of_colour(between(self.low, self.high, f32::from(byte) / 255.0))
    }

    /// The byte that is read as the nearest to a DC term; the stored one where that is read as this term, and where all
    /// bytes mean the same.
    fn nearest(self, dc: f32, stored: u8) -> u8 {
        let (low, high) = (f64::from(self.low), f64::from(self.high));
        let share = (0.5 + Y0 * f64::from(dc) - low) / (high - low);
        if self.dc(stored) == dc || !share.is_finite() { stored } else { nearest_byte(narrow(255.0 * share)) }
    }
}

/// Where the values are.
#[derive(Clone, Debug)]
struct Layout {
    splats: Records,
    words: [usize; PACKED.len()],
    chunks: Chunks,
    rest: Option<Rest>,
}

impl Layout {
    fn find(path: &Path, header: &Header, file_bytes: usize) -> Result<Self, EngineError> {
        if header.encoding != Encoding::LittleEndian {
            return Err(bad_data(path, "format", format!("{:?}", header.encoding), "binary_little_endian"));
        }
        body::check_length(path, header, file_bytes)?;
        let find = |name: &str| {
            element(header, name).ok_or_else(|| bad_data(path, "header", format!("no `{name}` element"), "one"))
        };
        let (vertex_index, vertex) = find(VERTEX)?;
        let (chunk_index, chunk) = find(CHUNK)?;
        check_splats(path, "element `vertex`", vertex.count, PACKED_BYTES, file_bytes)?;
        if chunk.count != vertex.count.div_ceil(SPLATS_PER_CHUNK) {
            let expected = format!("{} for {} splats", vertex.count.div_ceil(SPLATS_PER_CHUNK), vertex.count);
            return Err(bad_data(path, "element `chunk`", chunk.count, expected));
        }
        Ok(Self {
            splats: Records::of(header, vertex_index),
            words: places(path, vertex, PACKED, Scalar::U32)?,
            chunks: Chunks::find(path, chunk, Records::of(header, chunk_index))?,
            rest: Rest::find(path, header, vertex.count)?,
        })
    }

    fn sh_degree(&self) -> u32 {
        self.rest.as_ref().map_or(0, |rest| rest.sh_degree)
    }

    fn decode(&self, bytes: &[u8]) -> Gaussians {
        let mut gaussians = with_capacity(self.splats.count, self.sh_degree());
        for (row, sh_coeffs) in gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS).enumerate() {
            let word = |index: usize| u32::from_le_bytes(self.splats.word(bytes, row, self.words[index]));
            let chunk = row / SPLATS_PER_CHUNK;
            gaussians.means.push(vector(self.chunks.spans(bytes, chunk, self.chunks.means), word(0)));
            gaussians.quats.push(quat(word(1)));
            gaussians.scales.push(vector(self.chunks.spans(bytes, chunk, self.chunks.scales), word(2)));
            let spans = self.spans(bytes, row);
            for ((coeff, span), byte) in sh_coeffs.iter_mut().zip(spans).zip(self.colour(bytes, row)) {
                *coeff = span.dc(byte);
            }
            let [a, ..] = self.splats.word(bytes, row, self.words[COLOUR]);
            gaussians.opacities.push(logit_of_byte(a));
            if let Some(rest) = &self.rest {
                rest.read(bytes, row, sh_coeffs);
            }
        }
        gaussians
    }

    /// Red, green and blue of a splat.
    fn colour(&self, bytes: &[u8], row: usize) -> [u8; CHANNELS] {
        let [_, b, g, r] = self.splats.word(bytes, row, self.words[COLOUR]);
        [r, g, b]
    }

    /// Bounds of the colour of a splat.
    fn spans(&self, bytes: &[u8], row: usize) -> [Span; CHANNELS] {
        let whole = [Span { low: 0.0, high: 1.0 }; CHANNELS];
        self.chunks.colours.map_or(whole, |places| self.chunks.spans(bytes, row / SPLATS_PER_CHUNK, places))
    }
}

/// Offsets of the properties `names` in a record, all of the type `scalar`.
fn places<const N: usize>(
    path: &Path,
    element: &Element,
    names: [&str; N],
    scalar: Scalar,
) -> Result<[usize; N], EngineError> {
    let mut places = [0; N];
    for (place, name) in places.iter_mut().zip(names) {
        *place = place_of(path, element, name, scalar)?;
    }
    Ok(places)
}

fn place_of(path: &Path, element: &Element, name: &str, scalar: Scalar) -> Result<usize, EngineError> {
    let field = format!("element `{}`, property `{name}`", element.name);
    match element.find(name) {
        Some((_, property)) if property.scalar == scalar => Ok(property.offset),
        Some((_, property)) => Err(bad_data(path, field, format!("type {:?}", property.scalar), format!("{scalar:?}"))),
        None => Err(bad_data(path, field, "missing", format!("one of type {scalar:?}"))),
    }
}

/// The records of the chunks, and where in them their bounds are: the lowest values, then the highest.
#[derive(Clone, Debug)]
struct Chunks {
    records: Records,
    means: [usize; 6],
    scales: [usize; 6],
    /// Colours of files without these bounds lie in 0 to 1.
    colours: Option<[usize; 6]>,
}

impl Chunks {
    fn find(path: &Path, element: &Element, records: Records) -> Result<Self, EngineError> {
        let named = |names: [&str; 6]| places(path, element, names, Scalar::F32);
        let scales = ["min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z"];
        let colours = ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"];
        let has_colours = element.find(colours[0]).is_some();
        Ok(Self {
            records,
            means: named(["min_x", "min_y", "min_z", "max_x", "max_y", "max_z"])?,
            scales: named(scales)?,
            colours: has_colours.then(|| named(colours)).transpose()?,
        })
    }

    fn spans(&self, bytes: &[u8], chunk: usize, places: [usize; 6]) -> [Span; 3] {
        let float = |place: usize| f32::from_le_bytes(self.records.word(bytes, chunk, place));
        let [a, b, c, d, e, f] = places.map(float);
        [Span { low: a, high: d }, Span { low: b, high: e }, Span { low: c, high: f }]
    }
}

/// The element with SH behind the DC terms: a byte for each, channel by channel.
#[derive(Clone, Debug)]
struct Rest {
    records: Records,
    sh_degree: u32,
    places: Vec<usize>,
}

impl Rest {
    fn find(path: &Path, header: &Header, splats: usize) -> Result<Option<Self>, EngineError> {
        let Some((index, sh)) = element(header, SH) else { return Ok(None) };
        if sh.count != splats {
            return Err(bad_data(path, "element `sh`", sh.count, format!("{splats}, one for each splat")));
        }
        let sh_degree = degree_of(path, sh)?;
        let floats = (sh_bases(sh_degree) - 1) * CHANNELS;
        let places = (0..floats).map(|i| place_of(path, sh, &format!("f_rest_{i}"), Scalar::U8));
        let places = places.collect::<Result<_, _>>()?;
        Ok(Some(Self { records: Records::of(header, index), sh_degree, places }))
    }

    fn read(&self, bytes: &[u8], row: usize, sh_coeffs: &mut [f32]) {
        let record = &bytes[self.records.at(row)..];
        let per_channel = self.places.len() / CHANNELS;
        for (i, place) in self.places.iter().enumerate() {
            let (channel, basis) = (i / per_channel, i % per_channel + 1);
            sh_coeffs[CHANNELS * basis + channel] = ((f32::from(record[*place]) + 0.5) / 256.0 - 0.5) * SH_RANGE;
        }
    }
}

/// `bits` bits of `word` from bit `shift` on, as a share of their largest value.
fn unit(word: u32, shift: u32, bits: u32) -> f32 {
    let mask = (1_u32 << bits) - 1;
    narrow(f64::from(word >> shift & mask) / f64::from(mask))
}

fn between(low: f32, high: f32, unit: f32) -> f32 {
    low * (1.0 - unit) + high * unit
}

/// Eleven, ten and eleven bits, each a share of the way between two bounds.
fn vector(spans: [Span; 3], word: u32) -> [f32; 3] {
    let units = [unit(word, 21, 11), unit(word, 11, 10), unit(word, 0, 11)];
    std::array::from_fn(|i| between(spans[i].low, spans[i].high, units[i]))
}

/// Two bits that say which of w, x, y, z was left out, then ten for each of the others.
fn quat(word: u32) -> [f32; 4] {
    let part = |shift: u32| (unit(word, shift, 10) - 0.5) * std::f32::consts::SQRT_2;
    with_largest((word >> 30) as usize, [part(20), part(10), part(0)])
}
