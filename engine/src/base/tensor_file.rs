//! Named tensors in a safetensors file: keys, extractors, checkpoints and dumps.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, TensorView, View};

use crate::error::EngineError;

/// Elements of one tensor.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// 32-bit floats.
    F32(Vec<f32>),
    /// 32-bit unsigned integers.
    U32(Vec<u32>),
    /// 64-bit integers, as token ids are stored by other tools.
    I64(Vec<i64>),
}

/// One tensor, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Extents.
    pub shape: Vec<usize>,
    /// Elements.
    pub values: Values,
}

impl Tensor {
    /// A tensor of floats.
    #[must_use]
    pub fn f32(shape: &[usize], values: Vec<f32>) -> Self {
        Self { shape: shape.to_vec(), values: Values::F32(values) }
    }

    /// A tensor of unsigned integers.
    #[must_use]
    pub fn u32(shape: &[usize], values: Vec<u32>) -> Self {
        Self { shape: shape.to_vec(), values: Values::U32(values) }
    }
}

/// Tensors by name, with text metadata.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TensorFile {
    /// Where it was read from; named in errors.
    pub path: PathBuf,
    /// Tensors by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// Text metadata.
    pub meta: BTreeMap<String, String>,
}

struct Bytes<'a>(Dtype, &'a [usize], &'a [u8]);

impl View for Bytes<'_> {
    fn dtype(&self) -> Dtype {
        self.0
    }
    fn shape(&self) -> &[usize] {
        self.1
    }
    fn data(&self) -> std::borrow::Cow<'_, [u8]> {
        self.2.into()
    }
    fn data_len(&self) -> usize {
        self.2.len()
    }
}

impl TensorFile {
    /// Reads a file. Half-precision tensors become `f32`.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], or [`EngineError::BadData`] naming the tensor.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        let bytes = std::fs::read(path).map_err(|source| match source.kind() {
            std::io::ErrorKind::NotFound => {
                EngineError::MissingInput { path: path.to_owned(), expected: "a safetensors file".to_owned() }
            }
            _ => EngineError::Io { path: path.to_owned(), source },
        })?;
        Self::from_bytes(path, &bytes)
    }

    /// Reads a file's bytes; `path` is for messages.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the tensor.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, EngineError> {
        let bad = |field: &str, got: String, expected: &str| EngineError::BadData {
            path: path.to_owned(),
            field: field.to_owned(),
            got,
            expected: expected.to_owned(),
        };
        let whole = |e: safetensors::SafeTensorError| bad("header", e.to_string(), "a safetensors file");
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(whole)?;
        let file = SafeTensors::deserialize(bytes).map_err(whole)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.tensors() {
            let values = values(&view)
                .ok_or_else(|| bad(&name, format!("{:?}", view.dtype()), "F32, F16, BF16, U32, I32 or I64"))?;
            tensors.insert(name, Tensor { shape: view.shape().to_vec(), values });
        }
        let mut meta: BTreeMap<String, String> = header.metadata().clone().unwrap_or_default().into_iter().collect();
        if let Some(own) = meta.remove(META) {
            let own: BTreeMap<String, String> =
                serde_json::from_str(&own).map_err(|e| bad("metadata", e.to_string(), "a JSON object of strings"))?;
            meta.extend(own);
        }
        Ok(Self { path: path.to_owned(), tensors, meta })
    }

    /// The file's bytes; the same content always gives the same bytes.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when a shape does not fit its elements.
    pub fn to_bytes(&self) -> Result<Vec<u8>, EngineError> {
        let views = self.tensors.iter().map(|(name, tensor)| {
            let (dtype, bytes) = match &tensor.values {
                Values::F32(v) => (Dtype::F32, bytemuck::cast_slice(v)),
                Values::U32(v) => (Dtype::U32, bytemuck::cast_slice(v)),
                Values::I64(v) => (Dtype::I64, bytemuck::cast_slice(v)),
            };
            (name, Bytes(dtype, &tensor.shape, bytes))
        });
        // A hash map with a single entry serialises in one order only, so the bytes are stable.
        let text = serde_json::to_string(&self.meta).expect("a map of strings is always valid JSON");
        let packed = (!self.meta.is_empty()).then(|| HashMap::from([(META.to_owned(), text)]));
        safetensors::serialize(views, packed).map_err(|e| EngineError::BadData {
            path: self.path.clone(),
            field: "tensors".to_owned(),
            got: e.to_string(),
            expected: "shapes that fit their elements".to_owned(),
        })
    }

    /// The floats of tensor `name`, whose shape must be `shape`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the tensor, what it is and what it should be.
    pub fn floats(&self, name: &str, shape: &[usize]) -> Result<&[f32], EngineError> {
        match self.get(name)? {
            Tensor { shape: got, values: Values::F32(values) } if got == shape => Ok(values),
            other => Err(self.wrong(name, other, &format!("f32 {shape:?}"))),
        }
    }

    /// As [`TensorFile::floats`], for weights: NaN and infinity are refused.
    ///
    /// # Errors
    /// [`EngineError::BadData`] as there, and naming the first element that is no number.
    pub fn finite(&self, name: &str, shape: &[usize]) -> Result<&[f32], EngineError> {
        let values = self.floats(name, shape)?;
        match values.iter().position(|v| !v.is_finite()) {
            None => Ok(values),
            Some(at) => Err(EngineError::BadData {
                path: self.path.clone(),
                field: name.to_owned(),
                got: format!("{} at element {at}", values[at]),
                expected: "finite numbers".to_owned(),
            }),
        }
    }

    /// The integers of tensor `name`, whose shape must be `shape`.
    ///
    /// # Errors
    /// As [`TensorFile::floats`].
    pub fn integers(&self, name: &str, shape: &[usize]) -> Result<&[u32], EngineError> {
        match self.get(name)? {
            Tensor { shape: got, values: Values::U32(values) } if got == shape => Ok(values),
            other => Err(self.wrong(name, other, &format!("u32 {shape:?}"))),
        }
    }

    /// Any tensor by name.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when there is none.
    pub fn get(&self, name: &str) -> Result<&Tensor, EngineError> {
        self.tensors.get(name).ok_or_else(|| EngineError::BadData {
            path: self.path.clone(),
            field: name.to_owned(),
            got: "nothing".to_owned(),
            expected: "a tensor of this name".to_owned(),
        })
    }

    /// Metadata entry `name`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when there is none.
    pub fn text(&self, name: &str) -> Result<&str, EngineError> {
        self.meta.get(name).map(String::as_str).ok_or_else(|| EngineError::BadData {
            path: self.path.clone(),
            field: format!("metadata `{name}`"),
            got: "nothing".to_owned(),
            expected: "an entry".to_owned(),
        })
    }

    /// What is wrong with an entry of this file.
    #[must_use]
    pub fn bad(&self, field: &str, got: &str, expected: &str) -> EngineError {
        EngineError::BadData {
            path: self.path.clone(),
            field: field.to_owned(),
            got: got.to_owned(),
            expected: expected.to_owned(),
        }
    }

    /// Refuses a metadata entry `name` that is not `expected`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when it is missing or another.
    pub fn expect_text(&self, name: &str, expected: &str) -> Result<(), EngineError> {
        let got = self.text(name)?;
        if got == expected { Ok(()) } else { Err(self.bad(name, got, expected)) }
    }

    fn wrong(&self, name: &str, got: &Tensor, expected: &str) -> EngineError {
        let kind = match got.values {
            Values::F32(_) => "f32",
            Values::U32(_) => "u32",
            Values::I64(_) => "i64",
        };
        EngineError::BadData {
            path: self.path.clone(),
            field: name.to_owned(),
            got: format!("{kind} {:?}", got.shape),
            expected: expected.to_owned(),
        }
    }
}

fn values(view: &TensorView<'_>) -> Option<Values> {
    let data = view.data();
    let halves = |f: fn([u8; 2]) -> f32| data.as_chunks().0.iter().map(|b| f(*b)).collect();
    Some(match view.dtype() {
        Dtype::F32 => Values::F32(data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()),
        Dtype::F16 => Values::F32(halves(|b| half::f16::from_le_bytes(b).to_f32())),
        Dtype::BF16 => Values::F32(halves(|b| half::bf16::from_le_bytes(b).to_f32())),
        Dtype::U32 => Values::U32(data.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect()),
        Dtype::I32 => Values::I64(data.as_chunks().0.iter().map(|b| i64::from(i32::from_le_bytes(*b))).collect()),
        Dtype::I64 => Values::I64(data.as_chunks().0.iter().map(|b| i64::from_le_bytes(*b)).collect()),
        _ => return None,
    })
}

/// The single metadata entry under which our own files keep their sorted metadata.
const META: &str = "guard4d";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_round_trips_to_the_same_bytes() {
        let mut file = TensorFile::default();
        file.tensors.insert("a".to_owned(), Tensor::f32(&[2, 1], vec![1.5, f32::NAN]));
        file.tensors.insert("b".to_owned(), Tensor::u32(&[3], vec![1, 2, u32::MAX]));
        file.meta.insert("format".to_owned(), "x".to_owned());
        file.meta.insert("bits".to_owned(), "16".to_owned());
        let bytes = file.to_bytes().expect("serialises");
        let back = TensorFile::from_bytes(Path::new("x"), &bytes).expect("reads");
        assert_eq!(back.text("bits").expect("there"), "16", "metadata");
        assert_eq!(back.integers("b", &[3]).expect("there"), [1, 2, u32::MAX], "integers");
        assert!(back.floats("a", &[2, 1]).expect("there")[1].is_nan(), "a NaN stays one");
        assert_eq!(back.to_bytes().expect("serialises"), bytes, "same content, same bytes");
    }

    #[test]
    fn wrong_names_shapes_and_bytes_are_told() {
        let mut file = TensorFile::default();
        file.tensors.insert("a".to_owned(), Tensor::f32(&[2], vec![0.0; 2]));
        let message = file.floats("a", &[3]).expect_err("shape").to_string();
        assert!(message.contains("f32 [2]") && message.contains("f32 [3]"), "{message}");
        assert!(file.floats("b", &[2]).is_err(), "missing");
        assert!(TensorFile::from_bytes(Path::new("x"), b"not one").is_err(), "bytes");
    }

    /// What tells -0 from 0.
    fn bits(values: &[f32]) -> Vec<u32> {
        values.iter().map(|v| v.to_bits()).collect()
    }

    /// A file with one tensor of raw `words`.
    fn halves(dtype: Dtype, words: &[u16]) -> TensorFile {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let view = Bytes(dtype, &[words.len()], &bytes);
        let file = safetensors::serialize([("a", view)], None).expect("serialises");
        TensorFile::from_bytes(Path::new("x"), &file).expect("reads")
    }

    #[test]
    fn half_precision_becomes_f32_exactly() {
        let smallest = 2.0_f32.powi(-24);
        for (word, want) in [
            (0x0000, 0.0),
            (0x8000, -0.0),
            (0x0001, smallest),
            (0x83ff, -1023.0 * smallest), // the largest subnormal
            (0x0400, 1024.0 * smallest),  // the smallest normal
            (0x3555, 1365.0 / 4096.0),    // nearest to a third
            (0xbc00, -1.0),
            (0x3c01, 1.0 + 1.0 / 1024.0),
            (0x7bff, 65504.0),
            (0x7c00, f32::INFINITY),
            (0xfc00, f32::NEG_INFINITY),
        ] {
            let file = halves(Dtype::F16, &[0x3c00, word, 0x3c00]);
            let got = file.floats("a", &[3]).expect("floats");
            assert_eq!(bits(got), bits(&[1.0, want, 1.0]), "{word:#06x}");
        }
        assert!(halves(Dtype::F16, &[0x7e00]).floats("a", &[1]).expect("floats")[0].is_nan(), "a quiet NaN");
        assert!(halves(Dtype::F16, &[0xfc01]).floats("a", &[1]).expect("floats")[0].is_nan(), "a signalling NaN");
    }

    #[test]
    fn bfloat16_becomes_the_upper_half_of_an_f32() {
        // Zeros, subnormals, the least and the largest normal number, ones, 3.140625, and infinities.
        for word in [0x0000, 0x8000, 0x0001, 0x807f, 0x0080, 0x7f7f, 0x3f80, 0xbf80, 0x4049, 0x7f80, 0xff80_u16] {
            let file = halves(Dtype::BF16, &[word, 0x3f80]);
            let got = file.floats("a", &[2]).expect("floats");
            assert_eq!(bits(got), [u32::from(word) << 16, 1.0_f32.to_bits()], "{word:#06x}");
        }
        assert_eq!(halves(Dtype::BF16, &[0x4049]).floats("a", &[1]).expect("floats"), [3.140_625], "a value");
        assert!(halves(Dtype::BF16, &[0x7fc0]).floats("a", &[1]).expect("floats")[0].is_nan(), "a quiet NaN");
        assert!(halves(Dtype::BF16, &[0xff81]).floats("a", &[1]).expect("floats")[0].is_nan(), "a signalling NaN");
    }

    #[test]
    fn weights_in_half_precision_must_be_finite() {
        for (dtype, one, infinite) in [(Dtype::F16, 0x3c00, 0x7c00), (Dtype::BF16, 0x3f80, 0x7f80)] {
            let error = halves(dtype, &[one, infinite]).finite("a", &[2]).expect_err("infinite").to_string();
            assert!(error.contains("inf at element 1"), "{error}");
        }
    }

    #[test]
    fn signed_integers_keep_their_sign_and_doubles_are_refused() {
        let read = |dtype: Dtype, bytes: &[u8]| {
            let file = safetensors::serialize([("a", Bytes(dtype, &[1], bytes))], None).expect("serialises");
            TensorFile::from_bytes(Path::new("x"), &file)
        };
        let file = read(Dtype::I32, &(-7_i32).to_le_bytes()).expect("reads");
        assert_eq!(file.get("a").expect("there").values, Values::I64(vec![-7]), "I32");
        let file = read(Dtype::I64, &i64::MIN.to_le_bytes()).expect("reads");
        assert_eq!(file.get("a").expect("there").values, Values::I64(vec![i64::MIN]), "I64");
        let error = read(Dtype::F64, &1.0_f64.to_le_bytes()).expect_err("F64").to_string();
        assert!(error.contains("a: F64") && error.contains("BF16"), "{error}");
    }
}
