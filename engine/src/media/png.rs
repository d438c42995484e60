//! Numbered PNG files.

use std::fs;
use std::io::Write as _;
use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};

use super::folder::pictures;
use super::frames::Frame;
use crate::error::EngineError;

/// Writes frames as `00000.png`, `00001.png`, … into a folder, which is created if need be.
///
/// # Errors
/// [`EngineError::CannotCreate`] if the folder cannot be made or already holds pictures, which a reader
/// would mix with the new ones; [`EngineError::Io`] if writing fails.
pub fn write_png_folder(folder: &Path, frames: &[Frame]) -> Result<(), EngineError> {
    prepare_png_folder(folder)?;
    for (index, frame) in frames.iter().enumerate() {
        write_png(&folder.join(png_name(index)), frame)?;
    }
    Ok(())
}

/// Makes a folder ready for numbered frames.
///
/// # Errors
/// [`EngineError::CannotCreate`] if it cannot be made or already holds pictures; [`EngineError::Io`] if it cannot be
/// listed.
pub fn prepare_png_folder(folder: &Path) -> Result<(), EngineError> {
    let cannot = |reason: String| EngineError::CannotCreate { path: folder.to_path_buf(), reason };
    fs::create_dir_all(folder).map_err(|error| cannot(error.to_string()))?;
    if !pictures(folder)?.is_empty() {
        return Err(cannot("the folder already holds pictures".to_owned()));
    }
    Ok(())
}

/// Name of a numbered frame.
#[must_use]
pub fn png_name(index: usize) -> String {
    format!("{index:05}.png")
}

/// Writes one PNG; never over an existing file.
///
/// # Errors
/// [`EngineError::CannotCreate`] if it exists or cannot be made, [`EngineError::Io`] if writing fails.
pub fn write_png(path: &Path, frame: &Frame) -> Result<(), EngineError> {
    let file = fs::File::create_new(path)
        .map_err(|error| EngineError::CannotCreate { path: path.to_path_buf(), reason: error.to_string() })?;
    let mut out = std::io::BufWriter::new(file);
    encode(&mut out, frame)
        .and_then(|()| out.flush())
        .map_err(|source| EngineError::Io { path: path.to_path_buf(), source })
}

/// A frame as a PNG in memory.
///
/// # Panics
/// Never: memory takes any picture.
#[must_use]
pub fn png_bytes(frame: &Frame) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(&mut bytes, frame).expect("memory takes any picture");
    bytes
}

fn encode(out: impl std::io::Write, frame: &Frame) -> std::io::Result<()> {
    let encoder = PngEncoder::new(out);
    let written = encoder.write_image(frame.rgb(), frame.width(), frame.height(), ExtendedColorType::Rgb8);
    written.map_err(std::io::Error::other)
}
