//! COLMAP's `cameras.bin` and `images.bin`: little-endian, without padding.

use std::fmt::Display;
use std::path::Path;

use super::models::{ColmapCamera, ColmapImage, MAX_NAME, MODELS};
use crate::base::files::bad_data;
use crate::error::EngineError;

/// Bytes of a camera before its parameters: number, model, width, height.
const CAMERA_HEAD: usize = 4 + 4 + 8 + 8;

/// Fewest parameters of a camera.
const FEWEST_PARAMETERS: usize = 3;

/// Bytes of an image without a name and points: number, rotation, translation, camera, a NUL, number of points.
const SMALLEST_IMAGE: usize = 4 + 7 * 8 + 4 + 1 + 8;

/// Bytes of a point in an image: x, y, number.
const POINT: usize = 3 * 8;

/// Reads `cameras.bin`.
pub(super) fn cameras(path: &Path, bytes: &[u8]) -> Result<Vec<ColmapCamera>, EngineError> {
    let mut bytes = Bytes { path, rest: bytes };
    let count = bytes.count("number of cameras", CAMERA_HEAD + FEWEST_PARAMETERS * 8)?;
    let mut cameras = Vec::with_capacity(count);
    for number in 0..count {
        let id = u32::from_le_bytes(bytes.take(format_args!("cameras[{number}].id"))?);
        let of = format!("camera {id}: ");
        let model = i32::from_le_bytes(bytes.take(format_args!("{of}model"))?);
        let Some(model) = usize::try_from(model).ok().and_then(|model| MODELS.get(model)) else {
            let expected = format!("a model from 0 to {}", MODELS.len() - 1);
            return Err(bad_data(path, format!("{of}model"), model, expected));
        };
        let width = u64::from_le_bytes(bytes.take(format_args!("{of}width"))?);
        let height = u64::from_le_bytes(bytes.take(format_args!("{of}height"))?);
        let parameters = (0..model.parameters()).map(|_| bytes.float(format_args!("{of}parameters")));
        let parameters = parameters.collect::<Result<_, _>>()?;
        cameras.push(ColmapCamera { id, model, width, height, parameters });
    }
    bytes.end("cameras")?;
    Ok(cameras)
}

/// Reads `images.bin`.
pub(super) fn images(path: &Path, bytes: &[u8]) -> Result<Vec<ColmapImage>, EngineError> {
    let mut bytes = Bytes { path, rest: bytes };
    let count = bytes.count("number of images", SMALLEST_IMAGE)?;
    let mut images = Vec::with_capacity(count);
    for number in 0..count {
        let id = u32::from_le_bytes(bytes.take(format_args!("images[{number}].id"))?);
        let of = format!("image {id}: ");
        let mut pose = [0.0; 7];
        for value in &mut pose {
            *value = bytes.float(format_args!("{of}pose"))?;
        }
        let [w, x, y, z, translation @ ..] = pose;
        let camera_id = u32::from_le_bytes(bytes.take(format_args!("{of}camera"))?);
        let name = bytes.name(format_args!("{of}name"))?;
        let points = bytes.count(format_args!("{of}number of points"), POINT)?;
        // In range: the count was checked.
        bytes.rest = &bytes.rest[points * POINT..];
        images.push(ColmapImage { id, rotation: [w, x, y, z], translation, camera_id, name });
    }
    bytes.end("images")?;
    Ok(images)
}

/// What of a file is still unread.
struct Bytes<'a> {
    path: &'a Path,
    rest: &'a [u8],
}

impl Bytes<'_> {
    fn take<const N: usize>(&mut self, field: impl Display) -> Result<[u8; N], EngineError> {
        let Some((first, rest)) = self.rest.split_first_chunk() else {
            let got = format!("the file ends, {} bytes are left", self.rest.len());
            return Err(bad_data(self.path, field, got, format!("{N} bytes")));
        };
        self.rest = rest;
        Ok(*first)
    }

    fn float(&mut self, field: impl Display) -> Result<f64, EngineError> {
        let value = f64::from_le_bytes(self.take(&field)?);
        match value.is_finite() {
            true => Ok(value),
            false => Err(bad_data(self.path, field, value, "a finite number")),
        }
    }

    /// How many records of at least `smallest` bytes follow; no more than the file has room for.
    fn count(&mut self, field: impl Display, smallest: usize) -> Result<usize, EngineError> {
        let count = u64::from_le_bytes(self.take(&field)?);
        let room = self.rest.len() / smallest;
        let fits = usize::try_from(count).ok().filter(|count| *count <= room);
        fits.ok_or_else(|| {
            let expected = format!("at most {room}, for which the file has room");
            bad_data(self.path, field, count, expected)
        })
    }

    /// A text that ends with a NUL.
    fn name(&mut self, field: impl Display) -> Result<String, EngineError> {
        let Some(length) = self.rest.iter().take(MAX_NAME + 1).position(|byte| *byte == 0) else {
            let expected = format!("at most {MAX_NAME} bytes, then a NUL");
            return Err(bad_data(self.path, field, "no end", expected));
        };
        let (name, rest) = self.rest.split_at(length);
        self.rest = &rest[1..];
        Ok(String::from_utf8_lossy(name).into_owned())
    }

    fn end(&self, of: &str) -> Result<(), EngineError> {
        match self.rest.len() {
            0 => Ok(()),
            more => {
                Err(bad_data(self.path, format!("end of the {of}"), format!("{more} bytes more"), "the file's end"))
            }
        }
    }
}
