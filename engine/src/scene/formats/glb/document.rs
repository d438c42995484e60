//! What a glTF binary is made of: its numbers and names, the objects of its JSON text, and its two chunks.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use serde::Deserialize;
use serde_json::{Map, Value};

use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::formats::bytes::Bytes;
use crate::scene::limits::MAX_JSON_BYTES;

/// First four bytes.
pub(in crate::scene::formats) const MAGIC: &[u8] = b"glTF";

pub(super) const VERSION: u32 = 2;
pub(super) const JSON_CHUNK: u32 = 0x4E4F_534A;
pub(super) const BINARY_CHUNK: u32 = 0x004E_4942;

pub(super) const EXTENSION: &str = "KHR_gaussian_splatting";
pub(super) const POSITION: &str = "POSITION";
pub(super) const ROTATION: &str = "KHR_gaussian_splatting:ROTATION";
pub(super) const SCALE: &str = "KHR_gaussian_splatting:SCALE";
pub(super) const OPACITY: &str = "KHR_gaussian_splatting:OPACITY";

/// glTF's numbers for component types.
pub(super) const I8: u32 = 5120;
pub(super) const U8: u32 = 5121;
pub(super) const I16: u32 = 5122;
pub(super) const U16: u32 = 5123;
pub(super) const F32: u32 = 5126;

#[derive(Deserialize)]
pub(super) struct Document {
    #[serde(default)]
    pub(super) asset: Asset,
    #[serde(default)]
    pub(super) nodes: Vec<Node>,
    #[serde(default)]
    pub(super) meshes: Vec<Mesh>,
    #[serde(default)]
    pub(super) accessors: Vec<Accessor>,
    #[serde(default, rename = "bufferViews")]
    pub(super) buffer_views: Vec<BufferView>,
}

#[derive(Default, Deserialize)]
pub(super) struct Asset {
    pub(super) copyright: Option<String>,
    pub(super) generator: Option<String>,
}

#[derive(Deserialize)]
pub(super) struct Node {
    pub(super) mesh: Option<usize>,
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
}

#[derive(Deserialize)]
pub(super) struct Mesh {
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
pub(super) struct Primitive {
    pub(super) attributes: BTreeMap<String, usize>,
    #[serde(default)]
    pub(super) extensions: Map<String, Value>,
}

#[derive(Deserialize)]
pub(super) struct Accessor {
    #[serde(rename = "bufferView")]
    pub(super) buffer_view: Option<usize>,
    #[serde(default, rename = "byteOffset")]
    pub(super) byte_offset: usize,
    #[serde(rename = "componentType")]
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: usize,
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) sparse: Option<Value>,
}

#[derive(Deserialize)]
pub(super) struct BufferView {
    #[serde(default)]
    pub(super) buffer: usize,
    #[serde(default, rename = "byteOffset")]
    pub(super) byte_offset: usize,
    #[serde(rename = "byteLength")]
    pub(super) byte_length: usize,
    #[serde(rename = "byteStride")]
    pub(super) byte_stride: Option<usize>,
}

/// The JSON text, and where the binary chunk is in the file.
pub(super) fn chunks<'a>(path: &Path, file: &'a [u8]) -> Result<(&'a [u8], Range<usize>), EngineError> {
    let mut bytes = Bytes::new(path, file);
    if bytes.array::<4>("mark")? != *MAGIC {
        return Err(bad_data(path, "mark", "other bytes", "`glTF`"));
    }
    let version = bytes.u32("version")?;
    if version != VERSION {
        return Err(bad_data(path, "version", version, VERSION));
    }
    let length = bytes.count("length")?;
    if length != file.len() {
        return Err(bad_data(path, "length", length, format!("{}, the bytes of the file", file.len())));
    }
    let mut chunk = |name: &str, kind: u32| {
        let length = bytes.count(name)?;
        let got = bytes.u32(name)?;
        match got == kind {
            true => bytes.take(name, length),
            false => Err(bad_data(path, name, format!("type {got:#x}"), format!("{kind:#x}"))),
        }
    };
    let json = chunk("JSON chunk", JSON_CHUNK)?;
    if json.len() > MAX_JSON_BYTES {
        return Err(bad_data(path, "JSON chunk", format!("{} bytes", json.len()), format!("at most {MAX_JSON_BYTES}")));
    }
    let binary = chunk("binary chunk", BINARY_CHUNK)?;
    let start = binary.as_ptr().addr() - file.as_ptr().addr();
    Ok((json, start..start + binary.len()))
}
