//! SPZ files, versions 1 to 4 (nianticlabs/spz, README and `load-spz`): columns of packed values, in one gzip stream, or
//! from version 4 in a Zstandard stream each.

use std::io::{Read, Write as _};
use std::path::Path;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use half::f16;

use super::{Bytes, GZIP, logit_of_byte, rest_floats, with_capacity, with_largest};
use crate::error::EngineError;
use crate::scene::axes::HalfTurn;
use crate::scene::bad_data;
use crate::scene::gaussians::{CHANNELS, Gaussians, MAX_SH_DEGREE, SH_FLOATS};
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

/// Bytes that a byte of a gzip stream can stand for.
const MOST_EXPANSION: u64 = 1032;

/// The columns of a file, as they are behind one another in it.
struct Columns<'a> {
    version: u32,
    splats: usize,
    sh_degree: u32,
    fraction_bits: u8,
    means: &'a [u8],
    opacities: &'a [u8],
    colours: &'a [u8],
    scales: &'a [u8],
    quats: &'a [u8],
    rest: &'a [u8],
}

/// What the first 16 bytes say.
struct Head {
    version: u32,
    splats: usize,
    sh_degree: u32,
    fraction_bits: u8,
    /// Number of streams, from version 4.
    streams: u8,
}

impl Head {
    fn read(path: &Path, bytes: &mut Bytes<'_, '_>) -> Result<Self, EngineError> {
        if bytes.array::<4>("mark")? != *MAGIC {
            return Err(bad_data(path, "mark", "other bytes", "`NGSP`"));
        }
        let version = bytes.u32("version")?;
        if !(1..=STREAMS).contains(&version) {
            return Err(bad_data(path, "version", version, format!("1 to {STREAMS}")));
        }
        let splats = bytes.count("splat count")?;
        let sh_degree = u32::from(bytes.u8("SH degree")?);
        if sh_degree > MAX_SH_DEGREE {
            return Err(bad_data(path, "SH degree", sh_degree, format!("0 to {MAX_SH_DEGREE}")));
        }
        let fraction_bits = bytes.u8("fraction bits")?;
        if fraction_bits > MAX_FRACTION_BITS {
            return Err(bad_data(path, "fraction bits", fraction_bits, format!("0 to {MAX_FRACTION_BITS}")));
        }
        let _flags = bytes.u8("flags")?;
        let streams = bytes.u8("streams")?;
        Ok(Self { version, splats, sh_degree, fraction_bits, streams })
    }

    /// Bytes of the columns, in their order in the file.
    fn columns(&self) -> [usize; 6] {
        let coordinate = if self.version == 1 { size_of::<f16>() } else { 3 };
        let quat = if self.version < WRITTEN { 3 } else { size_of::<u32>() };
        [3 * coordinate, 1, CHANNELS, 3, quat, rest_floats(self.sh_degree)].map(|bytes| bytes * self.splats)
    }

    fn split<'a>(&self, columns: [&'a [u8]; 6]) -> Columns<'a> {
        let [means, opacities, colours, scales, quats, rest] = columns;
        let Self { version, splats, sh_degree, fraction_bits, .. } = *self;
        Columns { version, splats, sh_degree, fraction_bits, means, opacities, colours, scales, quats, rest }
    }
}

/// Reads the splats, turned into the axes of PLY files.
///
/// # Errors
/// [`EngineError::BadData`] for an unknown version, a damaged stream, or columns of other lengths than the head implies.
pub fn decode(path: &Path, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    let mut gaussians = match bytes.starts_with(GZIP) {
        true => decode_whole(path, bytes)?,
        false => decode_streams(path, bytes)?,
    };
    HalfTurn::AboutX.apply(&mut gaussians);
    Ok(gaussians)
}

fn decode_whole(path: &Path, file: &[u8]) -> Result<Gaussians, EngineError> {
    let mut decoder = GzDecoder::new(file);
    let head = inflate(path, &mut decoder, "head", HEAD_BYTES)?;
    let head = Head::read(path, &mut Bytes::new(path, &head))?;
    if head.version >= STREAMS {
        return Err(bad_data(path, "version", head.version, "less than 4 in a gzip stream"));
    }
    check_splats(path, "splat count", head.splats, MIN_BYTES_PER_SPLAT, file.len())?;
    let body = inflate(path, &mut decoder, "columns", head.columns().iter().sum())?;
    // What extensions may have added is passed over; the stream's checksum is behind it.
    let behind = (file.len() as u64).saturating_mul(MOST_EXPANSION);
    std::io::copy(&mut decoder.take(behind), &mut std::io::sink())
        .map_err(|error| bad_data(path, "end", error, "a whole gzip stream"))?;
    let mut rest = Bytes::new(path, &body);
    let mut columns = [&[][..]; 6];
    for (column, length) in columns.iter_mut().zip(head.columns()) {
        *column = rest.take("column", length)?;
    }
    Ok(unpack(&head.split(columns)))
}

fn decode_streams(path: &Path, file: &[u8]) -> Result<Gaussians, EngineError> {
    let mut bytes = Bytes::new(path, file);
    let head = Head::read(path, &mut bytes)?;
    if head.version < STREAMS {
        return Err(bad_data(path, "version", head.version, "4 outside a gzip stream"));
    }
    check_splats(path, "splat count", head.splats, MIN_BYTES_PER_SPLAT, file.len())?;
    let lengths = head.columns();
    let used = if head.sh_degree == 0 { 5 } else { 6 };
    if usize::from(head.streams) < used {
        return Err(bad_data(path, "streams", head.streams, format!("{used} at this SH degree")));
    }
    let table = bytes.count("place of the table")?;
    let table = file.get(table..).unwrap_or_default();
    let mut entries = Bytes::new(path, table);
    let mut sizes = Vec::with_capacity(usize::from(head.streams));
    for _ in 0..head.streams {
        sizes.push((entries.length("compressed length")?, entries.length("length")?));
    }
    let mut unpacked = Vec::with_capacity(used);
    for (index, ((packed, length), expected)) in sizes.into_iter().zip(lengths).enumerate() {
        let field = format!("stream {index}");
        if length != expected {
            return Err(bad_data(
                path,
                field,
                format!("{length} bytes"),
                format!("{expected} for {} splats", head.splats),
            ));
        }
        let stream = entries.take(&field, packed)?;
        let damaged = |error: String| bad_data(path, &field, error, "a Zstandard stream");
        let mut decoder = ruzstd::decoding::StreamingDecoder::new(stream).map_err(|e| damaged(e.to_string()))?;
        unpacked.push(inflate(path, &mut decoder, &field, length)?);
    }
    let column = |index: usize| unpacked.get(index).map_or(&[][..], Vec::as_slice);
    Ok(unpack(&head.split(std::array::from_fn(column))))
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

fn unpack(columns: &Columns<'_>) -> Gaussians {
    let mut gaussians = with_capacity(columns.splats, columns.sh_degree);
    let rest = rest_floats(columns.sh_degree);
    let unit = 1.0 / f32::from(2_u16).powi(i32::from(columns.fraction_bits));
    for row in 0..columns.splats {
        gaussians.means.push(std::array::from_fn(|axis| coordinate(columns, 3 * row + axis, unit)));
        let scale = |axis: usize| f32::from(columns.scales[3 * row + axis]) / SCALE_STEPS + LOWEST_SCALE;
        gaussians.scales.push(std::array::from_fn(scale));
        gaussians.opacities.push(logit_of_byte(columns.opacities[row]));
        gaussians.quats.push(match columns.version < WRITTEN {
            true => three_bytes(&columns.quats[3 * row..]),
            false => smallest_three(&columns.quats[4 * row..]),
        });
        let sh_coeffs = &mut gaussians.sh_coeffs[row * SH_FLOATS..];
        for (coeff, byte) in sh_coeffs.iter_mut().zip(&columns.colours[CHANNELS * row..CHANNELS * (row + 1)]) {
            *coeff = (f32::from(*byte) / 255.0 - 0.5) / COLOUR_SCALE;
        }
        for (coeff, byte) in sh_coeffs[CHANNELS..].iter_mut().zip(&columns.rest[rest * row..rest * (row + 1)]) {
            *coeff = (f32::from(*byte) - SH_ZERO) / SH_ZERO;
        }
    }
    gaussians
}

/// A coordinate: 24 bits with a sign, or in version 1 a 16-bit float.
#[allow(clippy::cast_precision_loss, reason = "24 bits fit into a float")]
fn coordinate(columns: &Columns<'_>, index: usize, unit: f32) -> f32 {
    if columns.version == 1 {
        let at = &columns.means[2 * index..];
        return f16::from_le_bytes([at[0], at[1]]).to_f32();
    }
    let at = &columns.means[3 * index..];
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
    let mut out = Vec::with_capacity(HEAD_BYTES + turned.len() * (20 + rest_floats(turned.sh_degree)));
    out.extend(MAGIC);
    out.extend(WRITTEN.to_le_bytes());
    out.extend(splats.to_le_bytes());
    out.extend([u8::try_from(turned.sh_degree).unwrap_or(u8::MAX), FRACTION_BITS, 0, 0]);
    for mean in &turned.means {
        for value in mean {
            out.extend(&fixed(path, *value)?.to_le_bytes()[..3]);
        }
    }
    out.extend(turned.opacities.iter().map(|logit| byte(255.0 / (1.0 + (-logit).exp()))));
    let splat_coeffs = || turned.sh_coeffs.chunks_exact(SH_FLOATS);
    out.extend(splat_coeffs().flat_map(|c| &c[..CHANNELS]).map(|h| byte(255.0 * (COLOUR_SCALE * h + 0.5))));
    out.extend(turned.scales.iter().flatten().map(|s| byte(SCALE_STEPS * (s - LOWEST_SCALE))));
    out.extend(turned.quats.iter().flat_map(|quat| packed_quat(*quat).to_le_bytes()));
    let rest = CHANNELS..CHANNELS + rest_floats(turned.sh_degree);
    out.extend(splat_coeffs().flat_map(|c| &c[rest.clone()]).map(|h| byte(SH_ZERO * h + SH_ZERO)));
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    let packed = encoder.write_all(&out).and_then(|()| encoder.finish());
    packed.map_err(|source| EngineError::Io { path: path.to_path_buf(), source })
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

/// The nearest byte.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
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
