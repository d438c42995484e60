//! Little-endian values at checked places of a file.

use std::path::Path;

use crate::base::files::bad_data;
use crate::error::EngineError;

/// First bytes of a gzip stream.
pub(super) const GZIP: &[u8] = &[0x1F, 0x8B];

/// The bytes of a file, read from front to back.
pub(super) struct Bytes<'p, 'a> {
    path: &'p Path,
    rest: &'a [u8],
}

impl<'p, 'a> Bytes<'p, 'a> {
    pub(super) const fn new(path: &'p Path, bytes: &'a [u8]) -> Self {
        Self { path, rest: bytes }
    }

    /// The next `count` bytes, which are `field`.
    pub(super) fn take(&mut self, field: &str, count: usize) -> Result<&'a [u8], EngineError> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or_else(|| {
            let got = format!("{} bytes to the end of the data", self.rest.len());
            bad_data(self.path, field, got, format!("{count} bytes"))
        })?;
        self.rest = rest;
        Ok(taken)
    }

    pub(super) fn array<const N: usize>(&mut self, field: &str) -> Result<[u8; N], EngineError> {
        let taken = self.take(field, N)?;
        Ok(*taken.first_chunk().expect("`take` returns what was asked for"))
    }

    pub(super) fn u8(&mut self, field: &str) -> Result<u8, EngineError> {
        Ok(u8::from_le_bytes(self.array(field)?))
    }

    pub(super) fn u32(&mut self, field: &str) -> Result<u32, EngineError> {
        Ok(u32::from_le_bytes(self.array(field)?))
    }

    /// A 32-bit count or length.
    pub(super) fn count(&mut self, field: &str) -> Result<usize, EngineError> {
        Ok(self.u32(field)? as usize)
    }

    /// A 64-bit length.
    pub(super) fn length(&mut self, field: &str) -> Result<usize, EngineError> {
        let value = u64::from_le_bytes(self.array(field)?);
        usize::try_from(value).map_err(|_| bad_data(self.path, field, value, "a length that memory can hold"))
    }
}

/// The `index`-th little-endian float of a slice whose length was checked.
pub(super) fn f32_at(bytes: &[u8], index: usize) -> f32 {
    let at = index * size_of::<f32>();
    f32::from_le_bytes(*bytes[at..].first_chunk().expect("the length was checked"))
}
