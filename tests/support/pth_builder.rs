//! Writes `.pth` files byte by byte: well-formed ones, and ones that no torch would write.

/// A pickle program in the making.
#[derive(Clone, Default)]
pub(crate) struct Pickle(pub(crate) Vec<u8>);

impl Pickle {
    /// A program that starts as torch's do: protocol 2.
    pub(crate) fn new() -> Self {
        Self(vec![0x80, 2])
    }

    pub(crate) fn op(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    pub(crate) fn global(self, module: &str, name: &str) -> Self {
        self.op(format!("c{module}\n{name}\n").as_bytes())
    }

    pub(crate) fn text(self, text: &str) -> Self {
        let length = text.len() as u32;
        self.op(b"X").op(&length.to_le_bytes()).op(text.as_bytes())
    }

    pub(crate) fn int(self, value: i32) -> Self {
        self.op(b"J").op(&value.to_le_bytes())
    }

    pub(crate) fn ints(self, values: &[i32]) -> Self {
        values.iter().fold(self.op(b"("), |pickle, &value| pickle.int(value)).op(b"t")
    }

    pub(crate) fn ordered_dict(self) -> Self {
        self.global("collections", "OrderedDict").op(b")R")
    }

    /// `_rebuild_tensor_v2` of the storage `key`, whose class and element count are given.
    pub(crate) fn tensor(self, key: &str, storage: (&str, i32), view: &RawView) -> Self {
        let (class, count) = storage;
        self.global("torch._utils", "_rebuild_tensor_v2")
            .op(b"((")
            .text("storage")
            .global("torch", class)
            .text(key)
            .text("cpu")
            .int(count)
            .op(b"tQ")
            .int(view.offset)
            .ints(&view.shape)
            .ints(&view.strides)
            .op(&[0x89])
            .ordered_dict()
            .op(b"tR")
    }

    pub(crate) fn stop(self) -> Vec<u8> {
        self.op(b".").0
    }
}

/// Offset, sizes and strides as the pickle states them, right or wrong.
#[derive(Clone)]
pub(crate) struct RawView {
    pub(crate) offset: i32,
    pub(crate) shape: Vec<i32>,
    pub(crate) strides: Vec<i32>,
}

impl RawView {
    /// The whole storage, row-major.
    pub(crate) fn contiguous(shape: &[usize]) -> Self {
        let shape: Vec<i32> = shape.iter().map(|&size| size as i32).collect();
        let strides = (0..shape.len()).map(|dim| shape[dim + 1..].iter().product()).collect();
        Self { offset: 0, shape, strides }
    }
}

/// A named f32 tensor.
#[derive(Clone)]
pub(crate) struct NamedTensor {
    pub(crate) name: String,
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Vec<f32>,
}

/// A well-formed state dict.
pub(crate) fn state_dict(tensors: &[NamedTensor]) -> Vec<u8> {
    let mut pickle = Pickle::new().ordered_dict().op(b"(");
    let mut entries = Vec::new();
    for (key, tensor) in tensors.iter().enumerate() {
        let key = key.to_string();
        let storage = ("FloatStorage", tensor.values.len() as i32);
        let view = RawView::contiguous(&tensor.shape);
        pickle = pickle.text(&tensor.name).tensor(&key, storage, &view);
        let raw: Vec<u8> = tensor.values.iter().flat_map(|value| value.to_le_bytes()).collect();
        entries.push((format!("archive/data/{key}"), raw));
    }
    entries.insert(0, ("archive/data.pkl".to_owned(), pickle.op(b"u").stop()));
    zip(&entries)
}

/// An archive with one storage, `0`, and the program `pickle`.
pub(crate) fn archive(pickle: Vec<u8>, storage: &[u8]) -> Vec<u8> {
    zip(&[("archive/data.pkl".to_owned(), pickle), ("archive/data/0".to_owned(), storage.to_vec())])
}

/// A bare tensor at the root.
pub(crate) fn bare(class: &str, view: &RawView, count: i32, storage: &[u8]) -> Vec<u8> {
    archive(Pickle::new().tensor("0", (class, count), view).stop(), storage)
}

/// A ZIP archive of stored entries.
pub(crate) fn zip(entries: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut directory = Vec::new();
    for (name, data) in entries {
        let start = file.len() as u32;
        let fields = zip_fields(name, data);
        file.extend_from_slice(b"PK\x03\x04\x14\x00");
        file.extend_from_slice(&fields);
        file.extend_from_slice(name.as_bytes());
        file.extend_from_slice(data);
        directory.extend_from_slice(b"PK\x01\x02\x14\x00\x14\x00");
        directory.extend_from_slice(&fields);
        directory.extend_from_slice(&[0; 10]); // comment length, disk, attributes
        directory.extend_from_slice(&start.to_le_bytes());
        directory.extend_from_slice(name.as_bytes());
    }
    let start = file.len() as u32;
    let count = entries.len() as u16;
    file.extend_from_slice(&directory);
    file.extend_from_slice(b"PK\x05\x06\0\0\0\0");
    file.extend_from_slice(&count.to_le_bytes());
    file.extend_from_slice(&count.to_le_bytes());
    file.extend_from_slice(&(directory.len() as u32).to_le_bytes());
    file.extend_from_slice(&start.to_le_bytes());
    file.extend_from_slice(&[0, 0]);
    file
}

/// The fields that local header and directory share, from the flags to the length of the extra field.
fn zip_fields(name: &str, data: &[u8]) -> Vec<u8> {
    let size = (data.len() as u32).to_le_bytes();
    let mut fields = vec![0; 8]; // flags, method (stored), time, date
    fields.extend_from_slice(&crc32(data).to_le_bytes());
    fields.extend_from_slice(&size);
    fields.extend_from_slice(&size);
    fields.extend_from_slice(&(name.len() as u16).to_le_bytes());
    fields.extend_from_slice(&[0, 0]);
    fields
}

/// CRC-32 bit by bit, unlike the reader's table.
fn crc32(data: &[u8]) -> u32 {
    let mut crc = !0_u32;
    for &byte in data {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
        }
    }
    !crc
}

#[test]
fn crc_has_the_check_value_of_its_definition() {
    assert_eq!(crc32(b"123456789"), 0xCBF4_3926, "the published check value of CRC-32");
}
