//! Tensors as strided views of raw storages, copied out row by row.

use half::{bf16, f16};

use super::archive::Archive;
use super::flaw::Flaw;
use super::values::{Tensor, TensorData};
use crate::base::numbers::narrow;

/// Element type of a storage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Dtype {
    F32,
    F64,
    F16,
    Bf16,
    I64,
    I32,
    I16,
    I8,
    U8,
    Bool,
}

impl Dtype {
    /// The type behind a class name of module `torch`.
    pub(super) fn from_storage(class: &str) -> Option<Self> {
        Some(match class {
            "FloatStorage" => Self::F32,
            "DoubleStorage" => Self::F64,
            "HalfStorage" => Self::F16,
            "BFloat16Storage" => Self::Bf16,
            "LongStorage" => Self::I64,
            "IntStorage" => Self::I32,
            "ShortStorage" => Self::I16,
            "CharStorage" => Self::I8,
            "ByteStorage" => Self::U8,
            "BoolStorage" => Self::Bool,
            _ => return None,
        })
    }

    fn size_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 | Self::Bool => 1,
            Self::F16 | Self::Bf16 | Self::I16 => 2,
            Self::F32 | Self::I32 => 4,
            Self::F64 | Self::I64 => 8,
        }
    }
}

/// A storage as the pickle names it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Storage<'a> {
    pub(super) dtype: Dtype,
    pub(super) key: &'a str,
    /// Elements.
    pub(super) count: usize,
}

/// A strided view; offset and strides count elements.
#[derive(Clone, Debug)]
pub(super) struct View<'a> {
    pub(super) storage: Storage<'a>,
    pub(super) offset: usize,
    pub(super) shape: Vec<usize>,
    pub(super) strides: Vec<usize>,
}

impl View<'_> {
    /// Checks the view against its storage and returns its number of elements.
    ///
    /// The count may not exceed the storage's, so views that repeat elements (stride 0) cannot grow.
    fn check(&self) -> Result<usize, (String, String)> {
        let limit = self.storage.count;
        let shape = format!("shape {:?}, strides {:?}", self.shape, self.strides);
        let bad = |expected: String| Err((format!("{shape}, offset {}", self.offset), expected));
        if self.shape.len() != self.strides.len() {
            return bad("one stride per dimension".to_owned());
        }
        let product = |sum: usize, &size: &usize| sum.checked_mul(size);
        let count = match self.shape.contains(&0) {
            true => Some(0),
            false => self.shape.iter().try_fold(1, product),
        };
        let Some(count) = count.filter(|&count| count <= limit) else {
            return bad(format!("at most the {limit} elements of its storage"));
        };
        let mut steps = self.shape.iter().zip(&self.strides);
        let last = steps.try_fold(self.offset, |last, (&size, &stride)| {
            last.checked_add(size.saturating_sub(1).checked_mul(stride)?)
        });
        if count > 0 && last.is_none_or(|last| last >= limit) {
            return bad(format!("a view inside its {limit} elements"));
        }
        Ok(count)
    }

    /// Element indices in row-major order; the view must have passed [`View::check`].
    fn indices(&self, count: usize) -> impl Iterator<Item = usize> {
        let mut position = vec![0; self.shape.len()];
        let mut at = self.offset;
        (0..count).map(move |_| {
            let current = at;
            for dim in (0..position.len()).rev() {
                if position[dim] + 1 < self.shape[dim] {
                    position[dim] += 1;
                    at += self.strides[dim];
                    break;
                }
                at -= position[dim] * self.strides[dim];
                position[dim] = 0;
            }
            current
        })
    }
}

/// Copies tensors out of an archive, and stops when they add up to more than the file.
pub(super) struct Reader<'a> {
    archive: &'a Archive<'a>,
    bytes_left: usize,
}

impl<'a> Reader<'a> {
    pub(super) fn new(archive: &'a Archive<'a>, file_bytes: usize) -> Self {
        Self { archive, bytes_left: file_bytes }
    }

    /// Reads the tensor `name`.
    pub(super) fn read(&mut self, name: &str, view: &View<'_>) -> Result<Tensor, Flaw> {
        let field = || format!("`{name}`");
        let Storage { dtype, key, count } = view.storage;
        let raw = self.archive.storage(key)?;
        let size_bytes = dtype.size_bytes();
        if count.checked_mul(size_bytes) != Some(raw.len()) {
            let got = format!("storage {key} of {} bytes", raw.len());
            let expected = format!("{count} elements of {size_bytes} bytes");
            return Err(Flaw::new(field(), got, expected));
        }
        let count = view.check().map_err(|(got, expected)| Flaw::new(field(), got, expected))?;
        let left = self.bytes_left.checked_sub(count * size_bytes);
        self.bytes_left = left.ok_or_else(|| {
            let expected = "tensors that share no storage";
            Flaw::new(field(), "more tensor data than the file has bytes", expected)
        })?;
        Ok(Tensor { shape: view.shape.clone(), data: decode(view, count, raw) })
    }
}

fn decode(view: &View<'_>, count: usize, raw: &[u8]) -> TensorData {
    match view.storage.dtype {
        Dtype::F32 => TensorData::F32(gather(view, count, raw, f32::from_le_bytes)),
        Dtype::F64 => TensorData::F32(gather(view, count, raw, |b| narrow(f64::from_le_bytes(b)))),
        Dtype::F16 => TensorData::F32(gather(view, count, raw, |b| f16::from_le_bytes(b).into())),
        Dtype::Bf16 => TensorData::F32(gather(view, count, raw, |b| bf16::from_le_bytes(b).into())),
        Dtype::I64 => TensorData::I64(gather(view, count, raw, i64::from_le_bytes)),
        Dtype::I32 => TensorData::I64(gather(view, count, raw, |b| i32::from_le_bytes(b).into())),
        Dtype::I16 => TensorData::I64(gather(view, count, raw, |b| i16::from_le_bytes(b).into())),
        Dtype::I8 => TensorData::I64(gather(view, count, raw, |b| i8::from_le_bytes(b).into())),
        Dtype::U8 => TensorData::I64(gather(view, count, raw, |[b]| b.into())),
        Dtype::Bool => TensorData::Bool(gather(view, count, raw, |[b]| b != 0)),
    }
}

fn gather<T, const SIZE: usize>(
    view: &View<'_>,
    count: usize,
    raw: &[u8],
    convert: impl Fn([u8; SIZE]) -> T,
) -> Vec<T> {
    let (elements, _) = raw.as_chunks::<SIZE>();
    let indices = view.indices(count);
    indices.map(|index| convert(elements[index])).collect()
}
