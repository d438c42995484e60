//! Compressed PLY files (`SuperSplat`): chunks of 256 splats, each splat packed into four words between its chunk's
//! bounds.

use std::path::Path;

use super::body::{self, start_of};
use super::header::{Element, Encoding, Header, Scalar, VERTEX, degree_of};
use crate::base::files::bad_data;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::formats::values::{logit_of_byte, with_capacity, with_largest};
use crate::scene::gaussians::{CHANNELS, Gaussians, SH_FLOATS, dc_of_colour, sh_bases};
use crate::scene::limits::check_splats;

const CHUNK: &str = "chunk";
const SH: &str = "sh";
const SPLATS_PER_CHUNK: usize = 256;
/// Splats are four words.
const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
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

/// Bounds of a chunk: lowest and highest position, log standard deviation and colour.
struct Bounds {
    means: [[f32; 3]; 2],
    scales: [[f32; 3]; 2],
    colours: [[f32; 3]; 2],
}

/// Reads the splats of a compressed PLY.
///
/// # Errors
/// [`EngineError::BadData`] naming the element or property that is missing or of another type, and counts that do not
/// fit together.
pub(in crate::scene) fn decode_compressed(path: &Path, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    let header = Header::parse(path, bytes)?;
    if header.encoding != Encoding::LittleEndian {
        return Err(bad_data(path, "format", format!("{:?}", header.encoding), "binary_little_endian"));
    }
    body::check_length(path, &header, bytes.len())?;
    let find = |name: &str| {
        element(&header, name).ok_or_else(|| bad_data(path, "header", format!("no `{name}` element"), "one"))
    };
    let (vertex_index, vertex) = find(VERTEX)?;
    let (chunk_index, chunk) = find(CHUNK)?;
    check_splats(path, "element `vertex`", vertex.count, PACKED_BYTES, bytes.len())?;
    if chunk.count != vertex.count.div_ceil(SPLATS_PER_CHUNK) {
        let expected = format!("{} for {} splats", vertex.count.div_ceil(SPLATS_PER_CHUNK), vertex.count);
        return Err(bad_data(path, "element `chunk`", chunk.count, expected));
    }
    let words = places(path, vertex, PACKED, Scalar::U32)?;
    let chunks = Chunks::find(path, chunk, &bytes[start_of(&header, chunk_index)..])?;
    let rest = Rest::find(path, &header, bytes, vertex.count)?;
    let mut gaussians = with_capacity(vertex.count, rest.as_ref().map_or(0, |rest| rest.sh_degree));
    let records = bytes[start_of(&header, vertex_index)..].chunks_exact(vertex.stride).take(vertex.count);
    for (row, (record, sh_coeffs)) in records.zip(gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS)).enumerate() {
        let word = |index: usize| {
            u32::from_le_bytes(*record[words[index]..].first_chunk().expect("the body's length was checked"))
        };
        let bounds = chunks.bounds(row / SPLATS_PER_CHUNK);
        gaussians
            .means
            .push(between(bounds.means, [unit(word(0), 21, 11), unit(word(0), 11, 10), unit(word(0), 0, 11)]));
        gaussians.quats.push(quat(word(1)));
        gaussians
            .scales
            .push(between(bounds.scales, [unit(word(2), 21, 11), unit(word(2), 11, 10), unit(word(2), 0, 11)]));
        let [r, g, b, a] = word(3).to_be_bytes();
        let colour = between(bounds.colours, [r, g, b].map(|byte| f32::from(byte) / 255.0));
        for (coeff, colour) in sh_coeffs.iter_mut().zip(colour) {
            *coeff = dc_of_colour(colour);
        }
        gaussians.opacities.push(logit_of_byte(a));
        if let Some(rest) = &rest {
            rest.read(row, sh_coeffs);
        }
    }
    Ok(gaussians)
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

/// The records of the chunks.
struct Chunks<'a> {
    records: &'a [u8],
    stride: usize,
    means: [usize; 6],
    scales: [usize; 6],
    /// Colours of files without these bounds lie in 0 to 1.
    colours: Option<[usize; 6]>,
}

impl<'a> Chunks<'a> {
    fn find(path: &Path, element: &Element, records: &'a [u8]) -> Result<Self, EngineError> {
        let named = |names: [&str; 6]| places(path, element, names, Scalar::F32);
        let scales = ["min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z"];
        let colours = ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"];
        let has_colours = element.find(colours[0]).is_some();
        Ok(Self {
            records,
            stride: element.stride,
            means: named(["min_x", "min_y", "min_z", "max_x", "max_y", "max_z"])?,
            scales: named(scales)?,
            colours: has_colours.then(|| named(colours)).transpose()?,
        })
    }

    fn bounds(&self, chunk: usize) -> Bounds {
        let record = &self.records[self.stride * chunk..];
        let float = |at: usize| f32::from_le_bytes(*record[at..].first_chunk().expect("the body's length was checked"));
        let pair = |places: [usize; 6]| {
            let [a, b, c, d, e, f] = places.map(float);
            [[a, b, c], [d, e, f]]
        };
        Bounds {
            means: pair(self.means),
            scales: pair(self.scales),
            colours: self.colours.map_or([[0.0; 3], [1.0; 3]], pair),
        }
    }
}

/// The element with SH behind the DC terms: a byte for each, channel by channel.
struct Rest<'a> {
    records: &'a [u8],
    stride: usize,
    sh_degree: u32,
    places: Vec<usize>,
}

impl<'a> Rest<'a> {
    fn find(path: &Path, header: &Header, bytes: &'a [u8], splats: usize) -> Result<Option<Self>, EngineError> {
        let Some((index, sh)) = element(header, SH) else { return Ok(None) };
        if sh.count != splats {
            return Err(bad_data(path, "element `sh`", sh.count, format!("{splats}, one for each splat")));
        }
        let sh_degree = degree_of(path, sh)?;
        let floats = (sh_bases(sh_degree) - 1) * CHANNELS;
        let places = (0..floats).map(|i| place_of(path, sh, &format!("f_rest_{i}"), Scalar::U8));
        let places = places.collect::<Result<_, _>>()?;
        Ok(Some(Self { records: &bytes[start_of(header, index)..], stride: sh.stride, sh_degree, places }))
    }

    fn read(&self, row: usize, sh_coeffs: &mut [f32]) {
        let record = &self.records[self.stride * row..];
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

fn between([low, high]: [[f32; 3]; 2], units: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| low[i] * (1.0 - units[i]) + high[i] * units[i])
}

/// Two bits that say which of w, x, y, z was left out, then ten for each of the others.
fn quat(word: u32) -> [f32; 4] {
    let part = |shift: u32| (unit(word, shift, 10) - 0.5) * std::f32::consts::SQRT_2;
    with_largest((word >> 30) as usize, [part(20), part(10), part(0)])
}
