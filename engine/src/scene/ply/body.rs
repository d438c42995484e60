//! The records of a PLY body, in any of its three encodings.

use std::path::Path;

use super::header::{Element, Encoding, Header, Scalar};
use crate::base::files::bad_data;
use crate::base::numbers::narrow;
use crate::error::EngineError;

/// Random access to the values of one element.
pub(super) enum Body<'a> {
    Binary {
        records: &'a [u8],
        element: &'a Element,
        encoding: Encoding,
    },
    /// Row-major values of an ASCII body.
    Parsed {
        values: Vec<f32>,
        columns: usize,
    },
}

impl<'a> Body<'a> {
    /// Opens the records of `header.elements[index]`; ASCII bodies are parsed here, as a whole.
    pub(super) fn new(path: &Path, header: &'a Header, index: usize, bytes: &'a [u8]) -> Result<Self, EngineError> {
        let element = &header.elements[index];
        if header.encoding == Encoding::Ascii {
            return Ok(Self::Parsed {
                values: parse_ascii(path, header, index, &bytes[header.body_start..])?,
                columns: element.properties.len(),
            });
        }
        Ok(Self::Binary { records: &bytes[start_of(header, index)..], element, encoding: header.encoding })
    }

    /// The values of row `row`.
    pub(super) fn record(&self, row: usize) -> Record<'_> {
        match self {
            Self::Parsed { values, columns } => Record::Parsed(&values[row * columns..(row + 1) * columns]),
            Self::Binary { records, element, encoding } => {
                let bytes = &records[row * element.stride..(row + 1) * element.stride];
                Record::Binary { bytes, element, encoding: *encoding }
            }
        }
    }
}

/// The values of one splat.
pub(super) enum Record<'a> {
    Binary { bytes: &'a [u8], element: &'a Element, encoding: Encoding },
    Parsed(&'a [f32]),
}

impl Record<'_> {
    /// Value of a float property; integers, which no splat property has, read as 0.
    pub(super) fn value(&self, property: usize) -> f32 {
        match self {
            Self::Parsed(values) => values[property],
            Self::Binary { bytes, element, encoding } => {
                let property = &element.properties[property];
                let bytes = &bytes[property.offset..];
                match property.scalar {
                    Scalar::F32 => read_f32(bytes, *encoding),
                    Scalar::F64 => narrow(read_f64(bytes, *encoding)),
                    _ => 0.0,
                }
            }
        }
    }
}

fn read_f32(record: &[u8], encoding: Encoding) -> f32 {
    let bytes = *record.first_chunk().expect("the body's length was checked against the header");
    match encoding {
        Encoding::BigEndian => f32::from_be_bytes(bytes),
        Encoding::LittleEndian | Encoding::Ascii => f32::from_le_bytes(bytes),
    }
}

fn read_f64(record: &[u8], encoding: Encoding) -> f64 {
    let bytes = *record.first_chunk().expect("the body's length was checked against the header");
    match encoding {
        Encoding::BigEndian => f64::from_be_bytes(bytes),
        Encoding::LittleEndian | Encoding::Ascii => f64::from_le_bytes(bytes),
    }
}

/// Offset of the first record of `header.elements[index]` in a binary file of checked length.
pub(super) fn start_of(header: &Header, index: usize) -> usize {
    let before = header.elements[..index].iter();
    header.body_start + before.map(|e| e.count * e.stride).sum::<usize>()
}

/// Checks that a binary body holds exactly the records that the header declares.
pub(super) fn check_length(path: &Path, header: &Header, file_bytes: usize) -> Result<(), EngineError> {
    let mut sizes = header.elements.iter().map(|e| e.count.checked_mul(e.stride));
    let expected = sizes.try_fold(0_usize, |sum, size| sum.checked_add(size?));
    let got = file_bytes - header.body_start;
    if expected == Some(got) {
        return Ok(());
    }
    let records: Vec<String> =
        (header.elements.iter()).map(|e| format!("{} `{}` records of {} bytes", e.count, e.name, e.stride)).collect();
    let expected = expected.map_or("more than memory can hold".to_owned(), |n| n.to_string());
    Err(bad_data(path, "body", format!("{got} bytes"), format!("{expected} ({})", records.join(", "))))
}

/// Parses all numbers of an ASCII body and keeps those of `header.elements[index]`.
fn parse_ascii(path: &Path, header: &Header, index: usize, text: &[u8]) -> Result<Vec<f32>, EngineError> {
    let text =
        std::str::from_utf8(text).map_err(|_| bad_data(path, "body", "bytes that are no text", "an ASCII body"))?;
    let mut words = text.split_ascii_whitespace();
    let mut values = Vec::new();
    for (number, element) in header.elements.iter().enumerate() {
        if element.properties.is_empty() {
            continue;
        }
        for row in 0..element.count {
            for property in &element.properties {
                let field = || format!("`{}` record {row}, `{}`", element.name, property.name);
                let expected = "a number";
                let word = words.next().ok_or_else(|| bad_data(path, field(), "end of file", expected))?;
                let value: f32 = word.parse().map_err(|_| bad_data(path, field(), format!("`{word}`"), expected))?;
                if number == index {
                    values.push(value);
                }
            }
        }
    }
    match words.next() {
        Some(word) => Err(bad_data(path, "body", format!("`{word}` after the end"), "no more")),
        None => Ok(values),
    }
}
