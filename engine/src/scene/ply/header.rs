//! The text head of a PLY file: encoding, elements, properties and where the body starts.

use std::path::Path;

use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, MAX_SH_DEGREE, sh_bases};

/// Longest head that is searched for `end_header`; INRIA files need about 1.5 KiB.
const MAX_HEADER_BYTES: usize = 64 * 1024;

/// How the body is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// Type of a scalar property.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes in a binary body.
    pub(super) fn size_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// One property of an element.
#[derive(Clone, Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) scalar: Scalar,
    /// Offset inside a binary record.
    pub(super) offset: usize,
}

/// One element: `count` records of the same properties.
#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
    /// Bytes of one binary record.
    pub(super) stride: usize,
}

impl Element {
    pub(super) fn find(&self, name: &str) -> Option<(usize, &Property)> {
        self.properties.iter().enumerate().find(|(_, property)| property.name == name)
    }
}

/// The parsed head.
#[derive(Clone, Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// What `comment` and `obj_info` lines say.
    pub(super) comments: Vec<String>,
    /// Offset of the first byte after `end_header` and its line end.
    pub(super) body_start: usize,
}

impl Header {
    /// Parses the head of `bytes`; comments, `obj_info` lines and CRLF line ends are accepted.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the line.
    pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Self, EngineError> {
        let mut lines = Lines { bytes, at: 0 };
        if lines.next_line(path)? != "ply" {
            return Err(bad_data(path, "header line 1", "no `ply` mark", "`ply`"));
        }
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut comments = Vec::new();
        for number in 2.. {
            let line = lines.next_line(path)?;
            let field = || format!("header line {number}");
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["comment" | "obj_info", said @ ..] => comments.push(said.join(" ")),
                [] => {}
                ["end_header"] => break,
                ["format", name, "1.0"] if encoding.is_none() => {
                    encoding = Some(parse_encoding(name).ok_or_else(|| {
                        let expected = "ascii, binary_little_endian or binary_big_endian";
                        bad_data(path, field(), format!("format `{name}`"), expected)
                    })?);
                }
                ["element", name, count] => {
                    elements.push(parse_element(path, &field(), name, count)?);
                }
                ["property", rest @ ..] => {
                    let element = elements
                        .last_mut()
                        .ok_or_else(|| bad_data(path, field(), "property before any element", "an element"))?;
                    add_property(path, &field(), element, rest)?;
                }
                _ => {
                    let expected = "format, comment, element, property or end_header";
                    return Err(bad_data(path, field(), format!("`{line}`"), expected));
                }
            }
        }
        let encoding = encoding.ok_or_else(|| bad_data(path, "header", "no `format` line", "`format … 1.0`"))?;
        Ok(Self { encoding, elements, comments, body_start: lines.at })
    }
}

/// Walks over the head's lines.
struct Lines<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Lines<'a> {
    fn next_line(&mut self, path: &Path) -> Result<&'a str, EngineError> {
        let end = self.bytes.len().min(MAX_HEADER_BYTES);
        let rest = self.bytes.get(self.at..end).unwrap_or_default();
        let Some(length) = rest.iter().position(|&byte| byte == b'\n') else {
            let got = format!("no `end_header` in the first {end} bytes");
            return Err(bad_data(path, "header", got, "`ply` … `end_header`"));
        };
        self.at += length + 1;
        let line = std::str::from_utf8(&rest[..length])
            .map_err(|_| bad_data(path, "header", "bytes that are no text", "text lines"))?;
        Ok(line.strip_suffix('\r').unwrap_or(line))
    }
}

fn parse_encoding(name: &str) -> Option<Encoding> {
    match name {
        "ascii" => Some(Encoding::Ascii),
        "binary_little_endian" => Some(Encoding::LittleEndian),
        "binary_big_endian" => Some(Encoding::BigEndian),
        _ => None,
    }
}

fn parse_element(path: &Path, field: &str, name: &str, count: &str) -> Result<Element, EngineError> {
    let count = count.parse().map_err(|_| {
        let got = format!("element `{name}` with count `{count}`");
        bad_data(path, field, got, "a whole number of records")
    })?;
    Ok(Element { name: name.to_owned(), count, properties: Vec::new(), stride: 0 })
}

fn add_property(path: &Path, field: &str, element: &mut Element, words: &[&str]) -> Result<(), EngineError> {
    let &[kind, name] = words else {
        let got = format!("`property {}`", words.join(" "));
        let expected = "`property TYPE NAME`; list properties are not read";
        return Err(bad_data(path, field, got, expected));
    };
    let scalar = Scalar::parse(kind).ok_or_else(|| {
        let got = format!("property `{name}` of type `{kind}`");
        bad_data(path, field, got, "a PLY scalar type such as float")
    })?;
    if element.find(name).is_some() {
        let got = format!("property `{name}` a second time");
        return Err(bad_data(path, field, got, "each property once"));
    }
    element.properties.push(Property { name: name.to_owned(), scalar, offset: element.stride });
    element.stride += scalar.size_bytes();
    Ok(())
}

/// Name of the element that holds the splats.
pub(super) const VERTEX: &str = "vertex";

/// Index of the floating-point property `name`.
pub(super) fn find_float(path: &Path, element: &Element, name: &str) -> Result<usize, EngineError> {
    let field = format!("property `{name}`");
    let expected = "a float property, as in an uncompressed INRIA 3DGS PLY";
    let (index, property) = element.find(name).ok_or_else(|| bad_data(path, &field, "missing", expected))?;
    match property.scalar {
        Scalar::F32 | Scalar::F64 => Ok(index),
        other => Err(bad_data(path, &field, format!("type {other:?}"), expected)),
    }
}

/// The SH degree that the number of `f_rest_*` properties tells.
pub(super) fn degree_of(path: &Path, element: &Element) -> Result<u32, EngineError> {
    let rest = element.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
    (0..=MAX_SH_DEGREE)
        .find(|&degree| (sh_bases(degree) - 1) * CHANNELS == rest)
        .ok_or_else(|| bad_data(path, "properties `f_rest_*`", format!("{rest} properties"), "0, 9, 24 or 45"))
}
