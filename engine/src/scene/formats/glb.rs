//! glTF binaries with `KHR_gaussian_splatting` (Khronos): every value has an accessor of its own. Coefficients are always
//! floats, so that new ones can be written in place.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::bytes::f32_at;
use super::{Bytes, log_scale, logit, with_capacity};
use crate::error::EngineError;
use crate::scene::axes::HalfTurn;
use crate::scene::bad_data;
use crate::scene::gaussians::{CHANNELS, Gaussians, MAX_SH_BASES, MAX_SH_DEGREE, SH_FLOATS, check_coeffs, sh_bases};
use crate::scene::limits::{MAX_JSON_BYTES, check_splats};

/// First four bytes.
pub(super) const MAGIC: &[u8] = b"glTF";

const VERSION: u32 = 2;
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BINARY_CHUNK: u32 = 0x004E_4942;
/// Chunks begin at multiples of this.
const ALIGNMENT: usize = 4;

const EXTENSION: &str = "KHR_gaussian_splatting";
const POSITION: &str = "POSITION";
const ROTATION: &str = "KHR_gaussian_splatting:ROTATION";
const SCALE: &str = "KHR_gaussian_splatting:SCALE";
const OPACITY: &str = "KHR_gaussian_splatting:OPACITY";

/// glTF's numbers for component types, and for points.
const I8: u32 = 5120;
const U8: u32 = 5121;
const I16: u32 = 5122;
const U16: u32 = 5123;
const F32: u32 = 5126;
const POINTS: u32 = 0;

/// Fewest bytes of a splat: a position of floats, and the DC terms.
const MIN_SPLAT_BYTES: usize = 24;

#[derive(Deserialize)]
struct Document {
    #[serde(default)]
    asset: Asset,
    #[serde(default)]
    nodes: Vec<Node>,
    #[serde(default)]
    meshes: Vec<Mesh>,
    #[serde(default)]
    accessors: Vec<Accessor>,
    #[serde(default, rename = "bufferViews")]
    buffer_views: Vec<BufferView>,
}

#[derive(Default, Deserialize)]
struct Asset {
    copyright: Option<String>,
    generator: Option<String>,
}

#[derive(Deserialize)]
struct Node {
    mesh: Option<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct Mesh {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: BTreeMap<String, usize>,
    #[serde(default)]
    extensions: Map<String, Value>,
}

#[derive(Deserialize)]
struct Accessor {
    #[serde(rename = "bufferView")]
    buffer_view: Option<usize>,
    #[serde(default, rename = "byteOffset")]
    byte_offset: usize,
    #[serde(rename = "componentType")]
    component_type: u32,
    #[serde(default)]
    normalized: bool,
    count: usize,
    #[serde(rename = "type")]
    kind: String,
    sparse: Option<Value>,
}

#[derive(Deserialize)]
struct BufferView {
    #[serde(default)]
    buffer: usize,
    #[serde(default, rename = "byteOffset")]
    byte_offset: usize,
    #[serde(rename = "byteLength")]
    byte_length: usize,
    #[serde(rename = "byteStride")]
    byte_stride: Option<usize>,
}

/// Where the values of an attribute are in the file.
#[derive(Clone, Copy, Debug)]
struct Slot {
    start: usize,
    stride: usize,
    component_type: u32,
    normalized: bool,
}

/// One primitive of splats.
#[derive(Clone, Debug)]
struct Part {
    splats: usize,
    position: Slot,
    rotation: Slot,
    scale: Slot,
    opacity: Slot,
    /// By basis.
    sh_coeffs: Vec<Slot>,
}

/// A glTF binary whose coefficients can be replaced.
#[derive(Clone, Debug)]
pub struct GlbFile {
    path: PathBuf,
    bytes: Vec<u8>,
    parts: Vec<Part>,
    /// What was taken for granted.
    warnings: Vec<String>,
    /// Rights and maker.
    comments: Vec<String>,
}

impl GlbFile {
    /// Takes over `bytes`, which came from `path`. All primitives with the extension are one scene, in the axes of their
    /// meshes.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the object that is missing, points outside the file, has another type than the
    /// extension asks for, or stands beside others that a node has moved elsewhere.
    pub fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, EngineError> {
        let (json, binary) = chunks(path, &bytes)?;
        let document: Document = crate::json::parse(path, "JSON chunk", json, "a glTF document")?;
        let reader = Reader { path, document: &document, binary };
        let mut parts = Vec::new();
        let mut used = Vec::new();
        for (number, mesh) in document.meshes.iter().enumerate() {
            for (index, primitive) in mesh.primitives.iter().enumerate() {
                if primitive.extensions.contains_key(EXTENSION) {
                    parts.push(reader.part(&format!("meshes[{number}].primitives[{index}]"), primitive)?);
                    used.push(number);
                }
            }
        }
        if parts.is_empty() {
            return Err(bad_data(path, "meshes", "no splats", format!("a primitive with `{EXTENSION}`")));
        }
        let splats = parts.iter().map(|part| part.splats).try_fold(0_usize, usize::checked_add);
        check_splats(path, "splats", splats.unwrap_or(usize::MAX), MIN_SPLAT_BYTES, bytes.len())?;
        let warnings = reader.transforms(&used)?.into_iter().collect();
        let comments = document.asset.copyright.into_iter().chain(document.asset.generator).collect();
        Ok(Self { path: path.to_path_buf(), bytes, parts, warnings, comments })
    }

    /// The file's bytes as read.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Where the bytes came from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Rights and maker, as far as the file tells.
    #[must_use]
    pub fn comments(&self) -> &[String] {
        &self.comments
    }

    /// What was taken for granted about the file.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The splats, those with values that are not finite among them, turned into the axes of PLY files.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for opacities outside 0 to 1.
    pub fn decode(&self) -> Result<Gaussians, EngineError> {
        let splats = self.splats();
        let mut gaussians = with_capacity(splats, self.sh_degree());
        let mut scales: Vec<[f32; 3]> = Vec::with_capacity(splats);
        let mut rows = gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS);
        for part in &self.parts {
            for (row, splat) in (0..part.splats).zip(rows.by_ref()) {
                let [x, y, z, w] = self.values(part.rotation, row);
                gaussians.quats.push([w, x, y, z]);
                gaussians.means.push(self.values(part.position, row));
                scales.push(self.values(part.scale, row));
                let [opacity] = self.values(part.opacity, row);
                if !opacity.is_nan() && !(0.0..=1.0).contains(&opacity) {
                    let field = format!("{OPACITY} of splat {row}");
                    return Err(bad_data(&self.path, field, opacity, "0 to 1"));
                }
                gaussians.opacities.push(if opacity.is_nan() { opacity } else { logit(opacity) });
                for (basis, slot) in part.sh_coeffs.iter().enumerate() {
                    let colour: [f32; CHANNELS] = self.values(*slot, row);
                    splat[CHANNELS * basis..CHANNELS * (basis + 1)].copy_from_slice(&colour);
                }
            }
        }
        // Drafts of the extension stored the logarithm, which tells itself by its sign or by a signed type.
        let signed = |part: &Part| matches!(part.scale.component_type, I8 | I16);
        if !self.parts.iter().any(signed) && !scales.iter().flatten().any(|scale| *scale < 0.0) {
            scales.iter_mut().flatten().for_each(|scale| *scale = log_scale(*scale));
        }
        gaussians.scales = scales;
        HalfTurn::AboutZ.apply(&mut gaussians);
        Ok(gaussians)
    }

    /// The stored words of all coefficients of the splats `rows`, or of all.
    #[must_use]
    pub fn words(&self, rows: Option<&[u32]>) -> Vec<u32> {
        let word = |at: usize| u32::from_le_bytes(*self.bytes[at..].first_chunk().expect("slots lie in the file"));
        self.places(rows).map(|(at, _)| word(at)).collect()
    }

    /// How many words [`GlbFile::words`] has.
    #[must_use]
    pub fn num_words(&self, rows: Option<&[u32]>) -> usize {
        self.places(rows).count()
    }

    /// The words that coefficients `[rows,16,3]`, in the axes of PLY files, are stored as.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for coefficients that do not fit, also above the degree of a splat's own primitive.
    pub fn words_of(&self, rows: Option<&[u32]>, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        check_coeffs(rows.map_or(self.splats(), <[u32]>::len), self.sh_degree(), sh_coeffs)?;
        let signs = HalfTurn::AboutZ.sh_signs();
        Ok(self.places(rows).map(|(_, float)| signs[float % SH_FLOATS] * sh_coeffs[float]).map(f32::to_bits).collect())
    }

    /// The coefficients `[rows,16,3]` that words are read as.
    #[must_use]
    pub fn coeffs_of(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<f32> {
        let signs = HalfTurn::AboutZ.sh_signs();
        let mut coeffs = vec![0.0; SH_FLOATS * rows.map_or(self.splats(), <[u32]>::len)];
        for ((_, float), word) in self.places(rows).zip(words) {
            coeffs[float] = signs[float % SH_FLOATS] * f32::from_bits(*word);
        }
        coeffs
    }

    /// The file with other words in the places of [`GlbFile::words`].
    #[must_use]
    pub fn with_words(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        for ((at, _), word) in self.places(rows).zip(words) {
            bytes[at..at + size_of::<u32>()].copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }

    /// Number of splats.
    #[must_use]
    pub fn splats(&self) -> usize {
        self.parts.iter().map(|part| part.splats).sum()
    }

    fn sh_degree(&self) -> u32 {
        let bases = self.parts.iter().map(|part| part.sh_coeffs.len()).max().unwrap_or(1);
        (0..=MAX_SH_DEGREE).find(|&degree| sh_bases(degree) == bases).unwrap_or(MAX_SH_DEGREE)
    }

    /// Where each coefficient of the splats `rows`, or of all, is in the file, and which of `[rows,16,3]` it is.
    fn places<'a>(&'a self, rows: Option<&'a [u32]>) -> impl Iterator<Item = (usize, usize)> + 'a {
        let starts = self.parts.iter().scan(0, |start, part| {
            let first = *start;
            *start += part.splats;
            Some((first, part))
        });
        let of_part = move |(first, part): (usize, &'a Part)| {
            let range = first..first + part.splats;
            // Rows are in ascending order, so that those of a part are side by side.
            let used = match rows {
                None => range,
                Some(rows) => {
                    let index = |row: usize| rows.partition_point(|&other| (other as usize) < row);
                    index(range.start)..index(range.end)
                }
            };
            used.flat_map(move |index| {
                let row = rows.map_or(index, |rows| rows[index] as usize) - first;
                let bases = part.sh_coeffs.iter().enumerate();
                bases.flat_map(move |(basis, slot)| {
                    let at = slot.start + row * slot.stride;
                    (0..CHANNELS).map(move |c| (at + c * size_of::<f32>(), SH_FLOATS * index + CHANNELS * basis + c))
                })
            })
        };
        starts.flat_map(of_part)
    }

    /// The values of one splat.
    fn values<const N: usize>(&self, slot: Slot, row: usize) -> [f32; N] {
        let record = &self.bytes[slot.start + row * slot.stride..];
        std::array::from_fn(|i| {
            let signed_unit = |value: f32, most: f32| if slot.normalized { (value / most).max(-1.0) } else { value };
            match slot.component_type {
                I8 => signed_unit(f32::from(i8::from_le_bytes([record[i]])), f32::from(i8::MAX)),
                U8 => signed_unit(f32::from(record[i]), f32::from(u8::MAX)),
                I16 => {
                    signed_unit(f32::from(i16::from_le_bytes([record[2 * i], record[2 * i + 1]])), f32::from(i16::MAX))
                }
                U16 => {
                    signed_unit(f32::from(u16::from_le_bytes([record[2 * i], record[2 * i + 1]])), f32::from(u16::MAX))
                }
                _ => f32_at(record, i),
            }
        })
    }
}

/// The JSON text, and where the binary chunk is in the file.
fn chunks<'a>(path: &Path, file: &'a [u8]) -> Result<(&'a [u8], std::ops::Range<usize>), EngineError> {
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

struct Reader<'a> {
    path: &'a Path,
    document: &'a Document,
    binary: std::ops::Range<usize>,
}

impl Reader<'_> {
    fn part(&self, field: &str, primitive: &Primitive) -> Result<Part, EngineError> {
        let of = |name: &str| primitive.attributes.get(name).copied();
        let find = |name: &str, kind: &str, types: &[u32]| {
            let index = of(name).ok_or_else(|| bad_data(self.path, field, format!("no `{name}`"), "one"))?;
            self.slot(&format!("{field}, `{name}`"), index, kind, types)
        };
        let (position, splats) = find(POSITION, "VEC3", &[F32])?;
        let coefficient = |degree: u32, index: u32| format!("{EXTENSION}:SH_DEGREE_{degree}_COEF_{index}");
        let degree = (0..=MAX_SH_DEGREE).take_while(|&degree| of(&coefficient(degree, 0)).is_some()).last();
        let degree = degree.ok_or_else(|| bad_data(self.path, field, "no colours", coefficient(0, 0)))?;
        let names = (0..=degree).flat_map(|degree| (0..=2 * degree).map(move |index| (degree, index)));
        let mut all = vec![find(ROTATION, "VEC4", &[F32, I8, I16])?, find(SCALE, "VEC3", &[F32, I8, I16])?];
        all.push(find(OPACITY, "SCALAR", &[F32, U8, U16])?);
        for (degree, index) in names {
            all.push(find(&coefficient(degree, index), "VEC3", &[F32])?);
        }
        if let Some((_, count)) = all.iter().find(|(_, count)| *count != splats) {
            return Err(bad_data(
                self.path,
                field,
                format!("{splats} positions, {count} values beside them"),
                "as many",
            ));
        }
        let slots: Vec<Slot> = all.into_iter().map(|(slot, _)| slot).collect();
        let (rotation, scale, opacity) = (slots[0], slots[1], slots[2]);
        Ok(Part { splats, position, rotation, scale, opacity, sh_coeffs: slots[3..].to_vec() })
    }

    /// Where the values of an accessor are, and how many.
    fn slot(&self, field: &str, index: usize, kind: &str, types: &[u32]) -> Result<(Slot, usize), EngineError> {
        let bad = |got: String, expected: String| bad_data(self.path, field, got, expected);
        let missing = |what: &str, index: usize| bad(format!("no {what}[{index}]"), "one".to_owned());
        let accessor = self.document.accessors.get(index).ok_or_else(|| missing("accessors", index))?;
        if accessor.kind != kind || !types.contains(&accessor.component_type) {
            let got = format!("{} of component type {}", accessor.kind, accessor.component_type);
            return Err(bad(got, format!("{kind} of one of {types:?}")));
        }
        if accessor.sparse.is_some() {
            return Err(bad("a sparse accessor".to_owned(), "values side by side".to_owned()));
        }
        let view = accessor.buffer_view.ok_or_else(|| bad("no buffer view".to_owned(), "one".to_owned()))?;
        let view = self.document.buffer_views.get(view).ok_or_else(|| missing("bufferViews", view))?;
        if view.buffer != 0 {
            return Err(bad(format!("buffer {}", view.buffer), "the file's own buffer, 0".to_owned()));
        }
        let components = match kind {
            "SCALAR" => 1,
            "VEC3" => 3,
            _ => 4,
        };
        let component_bytes = match accessor.component_type {
            I8 | U8 => 1,
            I16 | U16 => 2,
            _ => 4,
        };
        let record = components * component_bytes;
        let stride = view.byte_stride.unwrap_or(record);
        let last = accessor.count.checked_sub(1).and_then(|last| last.checked_mul(stride));
        let end = last.and_then(|last| last.checked_add(record)?.checked_add(accessor.byte_offset));
        let inside_view = end.is_some_and(|end| end <= view.byte_length) && stride >= record;
        let view_end = view.byte_offset.checked_add(view.byte_length);
        if !inside_view || view_end.is_none_or(|end| end > self.binary.len()) {
            let got = format!("{} values from byte {} on", accessor.count, accessor.byte_offset);
            return Err(bad(got, "at least one, all inside buffer view and file".to_owned()));
        }
        let start = self.binary.start + view.byte_offset + accessor.byte_offset;
        let Accessor { component_type, normalized, count, .. } = *accessor;
        Ok((Slot { start, stride, component_type, normalized }, count))
    }

    /// Refuses meshes that their nodes move apart; a note when they move all of them alike.
    fn transforms(&self, used: &[usize]) -> Result<Option<String>, EngineError> {
        let moves = |node: &Node| (node.matrix, node.translation, node.rotation, node.scale);
        let holds_splats = |node: &&Node| node.mesh.is_some_and(|mesh| used.contains(&mesh));
        let mut nodes = self.document.nodes.iter().filter(holds_splats).map(moves);
        let Some(first) = nodes.next() else { return Ok(None) };
        if nodes.any(|other| other != first) {
            let expected = "one transform for all splats; export them as one mesh";
            return Err(bad_data(self.path, "nodes", "splats that are moved apart", expected));
        }
        let is_moved = first != (None, None, None, None);
        Ok(is_moved.then(|| {
            format!("{}: its node is moved or turned; cameras are in the axes of the mesh", self.path.display())
        }))
    }
}

/// A glTF binary of `gaussians`, which are in the axes of PLY files. Coefficients are stored without any loss; opacities
/// and standard deviations as the values that they stand for.
///
/// # Errors
/// [`EngineError::BadData`] naming `path` when the file would have more than 4 GiB.
pub fn encode(path: &Path, gaussians: &Gaussians) -> Result<Vec<u8>, EngineError> {
    let mut turned = gaussians.clone();
    HalfTurn::AboutZ.apply(&mut turned);
    let mut out = Writer::default();
    out.positions(&turned.means);
    let unit = |quat: &[f32; 4]| {
        let norm = quat.iter().map(|v| v * v).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
        let [w, x, y, z] = quat.map(|v| v / norm);
        [x, y, z, w]
    };
    out.attribute(ROTATION, "VEC4", turned.quats.iter().map(unit));
    out.attribute(SCALE, "VEC3", turned.scales.iter().map(|scale| scale.map(f32::exp)));
    out.attribute(OPACITY, "SCALAR", turned.opacities.iter().map(|logit| [1.0 / (1.0 + (-logit).exp())]));
    let mut basis = 0;
    for degree in 0..=turned.sh_degree {
        for index in 0..=2 * degree {
            let coeffs = turned.sh_coeffs.chunks_exact(SH_FLOATS);
            let colour = |splat: &[f32]| std::array::from_fn::<_, CHANNELS, _>(|c| splat[CHANNELS * basis + c]);
            out.attribute(&format!("{EXTENSION}:SH_DEGREE_{degree}_COEF_{index}"), "VEC3", coeffs.map(colour));
            basis += 1;
        }
    }
    debug_assert!(basis <= MAX_SH_BASES, "degrees end at {MAX_SH_DEGREE}");
    out.finish(path)
}

/// A document that grows attribute by attribute.
#[derive(Default)]
struct Writer {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    attributes: Map<String, Value>,
}

impl Writer {
    fn attribute<const N: usize>(&mut self, name: &str, kind: &str, rows: impl Iterator<Item = [f32; N]>) {
        let start = self.binary.len();
        self.binary.extend(rows.flatten().flat_map(f32::to_le_bytes));
        let length = self.binary.len() - start;
        let count = length / (N * size_of::<f32>());
        self.attributes.insert(name.to_owned(), json!(self.accessors.len()));
        self.accessors
            .push(json!({ "bufferView": self.views.len(), "componentType": F32, "count": count, "type": kind }));
        self.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": length }));
    }

    /// Positions must tell their range.
    fn positions(&mut self, means: &[[f32; 3]]) {
        self.attribute(POSITION, "VEC3", means.iter().copied());
        let bound = |pick: fn(f32, f32) -> f32, start: f32| -> [f32; 3] {
            std::array::from_fn(|axis| means.iter().map(|mean| mean[axis]).fold(start, pick))
        };
        if let Some(Value::Object(accessor)) = self.accessors.last_mut() {
            accessor.insert("min".to_owned(), json!(bound(f32::min, f32::INFINITY)));
            accessor.insert("max".to_owned(), json!(bound(f32::max, f32::NEG_INFINITY)));
        }
    }

    fn finish(self, path: &Path) -> Result<Vec<u8>, EngineError> {
        let Self { mut binary, views, accessors, attributes } = self;
        let splats = json!({ "kernel": "ellipse", "colorSpace": "srgb_rec709_display" });
        let primitive = json!({ "attributes": attributes, "mode": POINTS, "extensions": { EXTENSION: splats } });
        let document = json!({
            "asset": { "version": "2.0", "generator": concat!("guard4d ", env!("CARGO_PKG_VERSION")) },
            "extensionsUsed": [EXTENSION],
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [primitive] }],
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{ "byteLength": binary.len() }],
        });
        let mut json = document.to_string().into_bytes();
        json.resize(json.len().next_multiple_of(ALIGNMENT), b' ');
        binary.resize(binary.len().next_multiple_of(ALIGNMENT), 0);
        let word = |length: usize| {
            u32::try_from(length).map_err(|_| bad_data(path, "length", length, "a glTF binary below 4 GiB"))
        };
        let heads = 5 * size_of::<u32>() + 2 * size_of::<u32>();
        let mut out = Vec::with_capacity(heads + json.len() + binary.len());
        out.extend(MAGIC);
        for value in [VERSION, word(heads + json.len() + binary.len())?, word(json.len())?, JSON_CHUNK] {
            out.extend(value.to_le_bytes());
        }
        out.extend(&json);
        for value in [word(binary.len())?, BINARY_CHUNK] {
            out.extend(value.to_le_bytes());
        }
        out.extend(&binary);
        Ok(out)
    }
}
