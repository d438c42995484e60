//! SPZ files, versions 1 to 4 (nianticlabs/spz, README and `load-spz`): columns of packed values, in one gzip stream,
//! or from version 4 in a Zstandard stream each.

use std::io::{Read, Write as _};
use std::ops::Range;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use half::f16;

use super::bytes::{Bytes, GZIP};
use super::steps::{dithered_byte, nearest_byte};
use super::values::{logit_of_byte, rest_floats, with_capacity, with_largest};
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::axes::HalfTurn;
use crate::scene::gaussians::{CHANNELS, Gaussians, MAX_SH_DEGREE, SH_FLOATS, check_coeffs};
use crate::scene::limits::{MIN_BYTES_PER_SPLAT, check_splats};

/// First bytes of the data, and from version 4 of the file.
pub(super) const MAGIC: &[u8] = b"NGSP";

const HEAD_BYTES: usize = 16;
/// The first version whose columns are streams of their own.
const STREAMS: u32 = 4;
/// The last version in one gzip stream, which is what is written.
const WRITTEN: u32 = 3;
/// What colours are multiplied by, less than [`Y0`](crate::scene::gaussians::Y0), so that bright ones fit into a byte.
const COLOUR_SCALE: f32 = 0.15;
/// Steps of a log standard deviation for each unit, and its lowest value.
const SCALE_STEPS: f32 = 16.0;
const LOWEST_SCALE: f32 = -10.0;
/// Bits of the magnitude of a quaternion component in versions 3 and 4, which are at most 1/√2.
const QUAT_BITS: u32 = 9;
/// Value of an SH byte that means 0, and steps for each unit.
const SH_ZERO: f32 = 128.0;
/// Bits of a coordinate's fraction in files that are written: steps of 1/4096.
const FRACTION_BITS: u8 = 12;
/// Most bits of a fraction that can be read: coordinates have 24 in all.
const MAX_FRACTION_BITS: u8 = 23;

/// The flag that says how the splats were trained; others are about what follows the columns.
const ANTIALIASED: u8 = 1;

/// Bytes that a byte of a gzip stream can stand for.
const MOST_EXPANSION: u64 = 1032;

/// What the first 16 bytes say.
#[derive(Clone, Copy, Debug)]
struct Head {
    version: u32,
    splats: u32,
    sh_degree: u8,
    fraction_bits: u8,
    flags: u8,
}

impl Head {
    /// Also the number of streams, which only version 4 has.
    fn read(path: &Path, bytes: &mut Bytes<'_, '_>) -> Result<(Self, u8), EngineError> {
        if bytes.array::<4>("mark")? != *MAGIC {
            return Err(bad_data(path, "mark", "other bytes", "`NGSP`"));
        }
        let version = bytes.u32("version")?;
        if !(1..=STREAMS).contains(&version) {
            return Err(bad_data(path, "version", version, format!("1 to {STREAMS}")));
        }
        let splats = bytes.u32("splat count")?;
        let sh_degree = bytes.u8("SH degree")?;
        if u32::from(sh_degree) > MAX_SH_DEGREE {
            return Err(bad_data(path, "SH degree", sh_degree, format!("0 to {MAX_SH_DEGREE}")));
        }
        let fraction_bits = bytes.u8("fraction bits")?;
        if fraction_bits > MAX_FRACTION_BITS {
            return Err(bad_data(path, "fraction bits", fraction_bits, format!("0 to {MAX_FRACTION_BITS}")));
        }
        let flags = bytes.u8("flags")? & ANTIALIASED;
        let streams = bytes.u8("streams")?;
        Ok((Self { version, splats, sh_degree, fraction_bits, flags }, streams))
    }

    fn splats(&self) -> usize {
        self.splats as usize
    }

    /// Bytes of the columns, in their order in the file.
    fn columns(&self) -> [usize; 6] {
        let coordinate = if self.version == 1 { size_of::<f16>() } else { 3 };
        let quat = if self.version < WRITTEN { 3 } else { size_of::<u32>() };
        [3 * coordinate, 1, CHANNELS, 3, quat, rest_floats(self.sh_degree.into())].map(|bytes| bytes * self.splats())
    }

    /// Where each column is in a body.
    fn places(&self) -> [Range<usize>; 6] {
        let mut end = HEAD_BYTES;
        self.columns().map(|length| {
            end += length;
            end - length..end
        })
    }

    fn bytes(&self) -> [u8; HEAD_BYTES] {
        let mut bytes = [0; HEAD_BYTES];
        bytes[..4].copy_from_slice(MAGIC);
        bytes[4..8].copy_from_slice(&self.version.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.splats.to_le_bytes());
        bytes[12..15].copy_from_slice(&[self.sh_degree, self.fraction_bits, self.flags]);
        bytes
    }
}

/// A file whose colours can be replaced, rounded to its steps. All other bytes of its columns stay as read; what
/// extensions added behind them is left out, and so is how they were compressed.
#[derive(Clone, Debug)]
pub struct SpzFile {
    path: PathBuf,
    head: Head,
    /// Head and columns, as they are in a gzip stream.
    body: Vec<u8>,
    /// The file that is written without a change.
    packed: Vec<u8>,
}

impl SpzFile {
    /// Unpacks `bytes`, which came from `path`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for an unknown version, a damaged stream, or columns of other lengths than the head
    /// implies.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, EngineError> {
        let (head, body) = unpack(path, bytes)?;
        let packed = pack(&body);
        Ok(Self { path: path.to_path_buf(), head, body, packed })
    }

    /// The splats, turned into the axes of PLY files.
    #[must_use]
    pub fn decode(&self) -> Gaussians {
        gaussians_of(&self.head, &self.body)
    }

    /// Where the file is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The bytes that a copy with the same colours has.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.packed
    }

    /// Number of splats.
    #[must_use]
    pub fn splats(&self) -> usize {
        self.head.splats()
    }

    /// Bytes of colour that each splat has.
    #[must_use]
    pub fn words_per_splat(&self) -> usize {
        CHANNELS + rest_floats(self.head.sh_degree.into())
    }

    /// The colour bytes of the splats `rows`, or of all, as words: a splat's base colour, then its other coefficients.
    #[must_use]
    pub fn words(&self, rows: Option<&[u32]>) -> Vec<u32> {
        self.places(rows).map(|at| self.body[at].into()).collect()
    }

    /// The words that coefficients `[rows,16,3]` are stored as, dithered: one of the two nearest, so that the mean of
    /// many is kept.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for coefficients that do not fit.
    pub fn words_of(&self, rows: Option<&[u32]>, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        check_coeffs(rows.map_or(self.splats(), <[u32]>::len), self.head.sh_degree.into(), sh_coeffs)?;
        let (used, signs) = (self.words_per_splat(), HalfTurn::AboutX.sh_signs());
        let word = |row: usize, i: usize| dithered_byte(steps(i, signs[i] * sh_coeffs[row * SH_FLOATS + i]), row, i);
        let rows = 0..sh_coeffs.len() / SH_FLOATS;
        Ok(rows.flat_map(|row| (0..used).map(move |i| word(row, i).into())).collect())
    }

    /// The coefficients `[rows,16,3]` that words are read as.
    #[must_use]
    pub fn coeffs_of(&self, words: &[u32]) -> Vec<f32> {
        let used = self.words_per_splat();
        let mut turned = with_capacity(words.len() / used, self.head.sh_degree.into());
        for (splat, words) in turned.sh_coeffs.chunks_exact_mut(SH_FLOATS).zip(words.chunks_exact(used)) {
            for (i, (coeff, word)) in splat.iter_mut().zip(words).enumerate() {
                *coeff = coefficient(i, word.to_le_bytes()[0]);
            }
        }
        HalfTurn::AboutX.apply(&mut turned);
        turned.sh_coeffs
    }

    /// The file with other words in the places of [`SpzFile::words`].
    #[must_use]
    pub fn with_words(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<u8> {
        let mut body = self.body.clone();
        for (at, word) in self.places(rows).zip(words) {
            body[at] = word.to_le_bytes()[0];
        }
        pack(&body)
    }

    /// Where the words of `rows` are in the body.
    fn places<'a>(&'a self, rows: Option<&'a [u32]>) -> impl Iterator<Item = usize> + 'a {
        let [_, _, colours, _, _, rest] = self.head.places();
        let more = rest_floats(self.head.sh_degree.into());
        (0..rows.map_or(self.splats(), <[u32]>::len)).flat_map(move |index| {
            let row = rows.map_or(index, |rows| rows[index] as usize);
            let base = colours.start + CHANNELS * row;
            (base..base + CHANNELS).chain(rest.start + more * row..rest.start + more * (row + 1))
        })
    }
}

/// Reads the splats, turned into the axes of PLY files.
///
/// # Errors
/// Those of [`SpzFile::parse`].
pub fn decode(path: &Path, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    let (head, body) = unpack(path, bytes)?;
    Ok(gaussians_of(&head, &body))
}

/// Head and columns of any version, as they are in a gzip stream of a version up to 3.
fn unpack(path: &Path, bytes: &[u8]) -> Result<(Head, Vec<u8>), EngineError> {
    if bytes.starts_with(GZIP) { unpack_whole(path, bytes) } else { unpack_streams(path, bytes) }
}

fn pack(body: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(body).and_then(|()| encoder.finish()).expect("memory takes any number of bytes")
}

fn unpack_whole(path: &Path, file: &[u8]) -> Result<(Head, Vec<u8>), EngineError> {
    let mut decoder = GzDecoder::new(file);
    let head = inflate(path, &mut decoder, "head", HEAD_BYTES)?;
    let (head, _) = Head::read(path, &mut Bytes::new(path, &head))?;
    if head.version >= STREAMS {
        return Err(bad_data(path, "version", head.version, "less than 4 in a gzip stream"));
    }
    check_splats(path, "splat count", head.splats(), MIN_BYTES_PER_SPLAT, file.len())?;
    let columns = inflate(path, &mut decoder, "columns", head.columns().iter().sum())?;
    // What extensions may have added is passed over; the stream's checksum is behind it.
    let behind = (file.len() as u64).saturating_mul(MOST_EXPANSION);
    std::io::copy(&mut decoder.take(behind), &mut std::io::sink())
        .map_err(|error| bad_data(path, "end", error, "a whole gzip stream"))?;
    Ok((head, [&head.bytes(), columns.as_slice()].concat()))
}

fn unpack_streams(path: &Path, file: &[u8]) -> Result<(Head, Vec<u8>), EngineError> {
    let mut bytes = Bytes::new(path, file);
    let (head, streams) = Head::read(path, &mut bytes)?;
    if head.version < STREAMS {
        return Err(bad_data(path, "version", head.version, "4 outside a gzip stream"));
    }
    check_splats(path, "splat count", head.splats(), MIN_BYTES_PER_SPLAT, file.len())?;
    let lengths = head.columns();
    let used = if head.sh_degree == 0 { 5 } else { 6 };
    if usize::from(streams) < used {
        return Err(bad_data(path, "streams", streams, format!("{used} at this SH degree")));
    }
    let table = bytes.count("place of the table")?;
    let table = file.get(table..).unwrap_or_default();
    let mut entries = Bytes::new(path, table);
    let mut sizes = Vec::with_capacity(usize::from(streams));
    for _ in 0..streams {
        sizes.push((entries.length("compressed length")?, entries.length("length")?));
    }
    // The columns are those of version 3.
    let head = Head { version: WRITTEN, ..head };
    let mut body = head.bytes().to_vec();
    for (index, ((packed, length), expected)) in sizes.into_iter().zip(lengths).enumerate() {
        let field = format!("stream {index}");
        if length != expected {
            let expected = format!("{expected} for {} splats", head.splats);
            return Err(bad_data(path, field, format!("{length} bytes"), expected));
        }
        let stream = entries.take(&field, packed)?;
        let damaged = |error: String| bad_data(path, &field, error, "a Zstandard stream");
        let mut decoder = ruzstd::decoding::StreamingDecoder::new(stream).map_err(|e| damaged(e.to_string()))?;
        body.append(&mut inflate(path, &mut decoder, &field, length)?);
    }
    Ok((head, body))
}

/// Exactly `length` bytes of a stream; never more memory than they take.
fn inflate(path: &Path, stream: &mut impl Read, field: &str, length: usize) -> Result<Vec<u8>, EngineError> {
    let mut bytes = Vec::new();
    let read = stream.take(length as u64).read_to_end(&mut bytes);
    read.map_err(|error| bad_data(path, field, error, "a whole compressed stream"))?;
    if bytes.len() != length {
        return Err(bad_data(path, field, format!("{} bytes", bytes.len()), format!("{length}")));
    }
    Ok(bytes)
}

fn gaussians_of(head: &Head, body: &[u8]) -> Gaussians {
    let sh_degree = head.sh_degree.into();
    let mut gaussians = with_capacity(head.splats(), sh_degree);
    let [means, opacities, colours, scales, quats, rest] = head.places().map(|place| &body[place]);
    let more = rest_floats(sh_degree);
    let unit = 1.0 / f32::from(2_u16).powi(i32::from(head.fraction_bits));
    for row in 0..head.splats() {
        gaussians.means.push(std::array::from_fn(|axis| coordinate(head.version, means, 3 * row + axis, unit)));
        let scale = |axis: usize| f32::from(scales[3 * row + axis]) / SCALE_STEPS + LOWEST_SCALE;
        gaussians.scales.push(std::array::from_fn(scale));
        gaussians.opacities.push(logit_of_byte(opacities[row]));
        gaussians.quats.push(match head.version < WRITTEN {
            true => three_bytes(&quats[3 * row..]),
            false => smallest_three(&quats[4 * row..]),
        });
        let bytes = colours[CHANNELS * row..CHANNELS * (row + 1)].iter().chain(&rest[more * row..more * (row + 1)]);
        for (i, (coeff, byte)) in gaussians.sh_coeffs[row * SH_FLOATS..].iter_mut().zip(bytes).enumerate() {
            *coeff = coefficient(i, *byte);
        }
    }
    HalfTurn::AboutX.apply(&mut gaussians);
    gaussians
}

/// What a byte means as float number `index` of a splat's coefficients.
fn coefficient(index: usize, byte: u8) -> f32 {
    match index < CHANNELS {
        true => (f32::from(byte) / 255.0 - 0.5) / COLOUR_SCALE,
        false => (f32::from(byte) - SH_ZERO) / SH_ZERO,
    }
}

/// The inverse of [`coefficient`], before it is rounded.
fn steps(index: usize, coeff: f32) -> f32 {
    if index < CHANNELS { 255.0 * (COLOUR_SCALE * coeff + 0.5) } else { SH_ZERO * coeff + SH_ZERO }
}

/// A coordinate: 24 bits with a sign, or in version 1 a 16-bit float.
#[allow(clippy::cast_precision_loss, reason = "24 bits fit into a float")]
fn coordinate(version: u32, means: &[u8], index: usize, unit: f32) -> f32 {
    if version == 1 {
        let at = &means[2 * index..];
        return f16::from_le_bytes([at[0], at[1]]).to_f32();
    }
    let at = &means[3 * index..];
    // Shifted up and down again, so that the highest bit is the sign.
    (i32::from_le_bytes([0, at[0], at[1], at[2]]) >> 8) as f32 * unit
}

/// x, y, z as bytes; w is positive.
fn three_bytes(bytes: &[u8]) -> [f32; 4] {
    let part = |i: usize| f32::from(bytes[i]) / 127.5 - 1.0;
    with_largest(0, [part(0), part(1), part(2)])
}

/// Two bits that say which of x, y, z, w is left out, then sign and magnitude of the others, the last one lowest.
fn smallest_three(bytes: &[u8]) -> [f32; 4] {
    let mut word = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let largest = (word >> 30) as usize;
    let mut xyzw = [0.0; 4];
    let mut squares = 0.0;
    for index in (0..4).rev().filter(|&index| index != largest) {
        let magnitude = word & QUAT_MASK;
        let sign = if word & (QUAT_MASK + 1) == 0 { 1.0 } else { -1.0 };
        word >>= QUAT_BITS + 1;
        xyzw[index] = sign * std::f32::consts::FRAC_1_SQRT_2 * f32_of(magnitude) / f32_of(QUAT_MASK);
        squares += xyzw[index] * xyzw[index];
    }
    xyzw[largest] = f32::max(1.0 - squares, 0.0).sqrt();
    let [x, y, z, w] = xyzw;
    [w, x, y, z]
}

/// Largest magnitude of a quaternion component.
const QUAT_MASK: u32 = (1 << QUAT_BITS) - 1;

#[allow(clippy::cast_precision_loss, reason = "nine bits fit into a float")]
fn f32_of(value: u32) -> f32 {
    value as f32
}

/// Packs splats, which are in the axes of PLY files, as version 3, with eight bits for every SH coefficient.
///
/// # Errors
/// [`EngineError::BadData`] naming `path` for coordinates beyond ±2048, which the format has no place for.
pub fn encode(path: &Path, gaussians: &Gaussians) -> Result<Vec<u8>, EngineError> {
    let mut turned = gaussians.clone();
    HalfTurn::AboutX.apply(&mut turned);
    let splats = u32::try_from(turned.len()).map_err(|_| bad_data(path, "splats", turned.len(), "a 32-bit count"))?;
    let sh_degree = u8::try_from(turned.sh_degree).unwrap_or(u8::MAX);
    let head = Head { version: WRITTEN, splats, sh_degree, fraction_bits: FRACTION_BITS, flags: 0 };
    let mut out = head.bytes().to_vec();
    out.reserve_exact(head.columns().iter().sum());
    for mean in &turned.means {
        for value in mean {
            out.extend(&fixed(path, *value)?.to_le_bytes()[..3]);
        }
    }
    out.extend(turned.opacities.iter().map(|logit| nearest_byte(255.0 / (1.0 + (-logit).exp()))));
    let splat_coeffs = || turned.sh_coeffs.chunks_exact(SH_FLOATS);
    out.extend(splat_coeffs().flat_map(|c| (0..CHANNELS).map(|i| nearest_byte(steps(i, c[i])))));
    out.extend(turned.scales.iter().flatten().map(|s| nearest_byte(SCALE_STEPS * (s - LOWEST_SCALE))));
    out.extend(turned.quats.iter().flat_map(|quat| packed_quat(*quat).to_le_bytes()));
    let rest = CHANNELS..CHANNELS + rest_floats(turned.sh_degree);
    out.extend(splat_coeffs().flat_map(|c| rest.clone().map(|i| nearest_byte(steps(i, c[i])))));
    Ok(pack(&out))
}

/// A coordinate in steps of 2⁻¹², of which 24 bits are stored.
#[allow(clippy::cast_possible_truncation, reason = "the range was checked")]
fn fixed(path: &Path, value: f32) -> Result<i32, EngineError> {
    let steps = (f64::from(value) * f64::from(1_u32 << FRACTION_BITS)).round();
    let most = f64::from(1_u32 << 23);
    match (-most..most).contains(&steps) {
        true => Ok(steps as i32),
        false => {
            Err(bad_data(path, "coordinate", value, "less than 2048 from the origin, which is all that SPZ holds"))
        }
    }
}

/// The inverse of [`smallest_three`] for a quaternion w, x, y, z of any norm.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the mask")]
fn packed_quat([w, x, y, z]: [f32; 4]) -> u32 {
    let norm = (w * w + x * x + y * y + z * z).sqrt().max(f32::MIN_POSITIVE);
    let xyzw = [x, y, z, w].map(|v| v / norm);
    let largest = (0..4).max_by(|&a, &b| xyzw[a].abs().total_cmp(&xyzw[b].abs())).unwrap_or(3);
    let mut word = u32::try_from(largest).unwrap_or(3);
    for index in (0..4).filter(|&index| index != largest) {
        let is_negative = (xyzw[index] < 0.0) != (xyzw[largest] < 0.0);
        let magnitude = xyzw[index].abs() * std::f32::consts::SQRT_2 * f32_of(QUAT_MASK);
        let magnitude = (magnitude.round() as u32).min(QUAT_MASK);
        word = word << (QUAT_BITS + 1) | u32::from(is_negative) << QUAT_BITS | magnitude;
    }
    word
}
