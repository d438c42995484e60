//! Splats as a new glTF binary.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::document::{BINARY_CHUNK, EXTENSION, F32, JSON_CHUNK, MAGIC, OPACITY, POSITION, ROTATION, SCALE, VERSION};
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::axes::HalfTurn;
use crate::scene::gaussians::{CHANNELS, Gaussians, MAX_SH_BASES, MAX_SH_DEGREE, SH_FLOATS};

/// Chunks begin at multiples of this.
const ALIGNMENT: usize = 4;
/// glTF's number for primitives that are points.
const POINTS: u32 = 0;

/// A glTF binary of `gaussians`, which are in the axes of PLY files. Coefficients are stored without any loss;
/// opacities and standard deviations as the values that they stand for.
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
