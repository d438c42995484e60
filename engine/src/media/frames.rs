//! 8-bit frames and folders of PNG files.

use std::cmp::Ordering;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _, ImageFormat};

use crate::EngineError;

/// An 8-bit RGB picture, rows from top to bottom.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    width: u32,
    height: u32,
    rgb: Vec<u8>,
}

impl Frame {
    /// Wraps samples `[H, W, 3]`.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the picture is empty or the length is not 3·H·W.
    pub fn new(width: u32, height: u32, rgb: Vec<u8>) -> Result<Self, EngineError> {
        check_length(width, height, 3, rgb.len())?;
        Ok(Self { width, height, rgb })
    }

    /// Rounds a rendered picture `[H, W, 4]` to the nearest of 256 levels; the fourth channel is dropped.
    ///
    /// Truncation would cost 52.9 dB by itself, more than a faint mark; rounding costs 58.9 dB.
    /// Values outside [0, 1] are clamped.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] for a NaN or infinite colour; [`EngineError::Usage`] for a wrong length.
    pub fn from_rgba32f(width: u32, height: u32, pixels: &[f32]) -> Result<Self, EngineError> {
        check_length(width, height, 4, pixels.len())?;
        let mut rgb = Vec::with_capacity(pixels.len() / 4 * 3);
        for (at, pixel) in pixels.chunks_exact(4).enumerate() {
            for &colour in &pixel[..3] {
                if !colour.is_finite() {
                    let width = width as usize;
                    return Err(EngineError::NotFinite {
                        what: format!("rendered pixel ({}, {})", at % width, at / width),
                        got: f64::from(colour),
                    });
                }
                rgb.push(round_to_u8(colour));
            }
        }
        Ok(Self { width, height, rgb })
    }

    /// Width in pixels.
    #[must_use]
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// Samples `[H, W, 3]`.
    #[must_use]
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// The picture as `[H, W, 4]` with colours in [0, 1] and a fourth channel of 0.
    #[must_use]
    pub fn to_rgba32f(&self) -> Vec<f32> {
        let unit = |level: u8| f32::from(level) / 255.0;
        self.rgb.chunks_exact(3).flat_map(|p| [unit(p[0]), unit(p[1]), unit(p[2]), 0.0]).collect()
    }

    /// Lays RGBA samples `[H, W, 4]` with straight alpha over a background.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the picture is empty or the length is not 4·H·W.
    pub fn from_rgba8(width: u32, height: u32, rgba: &[u8], background: [u8; 3]) -> Result<Self, EngineError> {
        check_length(width, height, 4, rgba.len())?;
        let over = |colour: u8, behind: u8, alpha: u8| {
            let (alpha, rest) = (u32::from(alpha), 255 - u32::from(alpha));
            let sum = u32::from(colour) * alpha + u32::from(behind) * rest;
            u8::try_from((sum + 127) / 255).expect("a weighted mean of bytes is a byte")
        };
        let rgb = rgba
            .chunks_exact(4)
            .flat_map(|p| std::array::from_fn::<u8, 3, _>(|c| over(p[c], background[c], p[3])))
            .collect();
        Ok(Self { width, height, rgb })
    }
}

fn check_length(width: u32, height: u32, channels: u64, got: usize) -> Result<(), EngineError> {
    let expected = u64::from(width) * u64::from(height) * channels;
    if expected > 0 && got as u64 == expected {
        return Ok(());
    }
    Err(EngineError::Usage {
        what: "picture".to_owned(),
        got: format!("{got} samples"),
        expected: format!("{height} x {width} x {channels} samples, at least one pixel"),
    })
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a rounded number in 0..=255 is exact in u8"
)]
fn round_to_u8(colour: f32) -> u8 {
    (colour.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// PNG files of a folder in natural order: `9.png` before `10.png`. Other files are not looked at.
///
/// # Errors
/// [`EngineError::MissingInput`] if the folder is missing, [`EngineError::BadData`] if it holds no PNG,
/// [`EngineError::Io`] if it cannot be listed.
pub fn list_png_folder(folder: &Path) -> Result<Vec<PathBuf>, EngineError> {
    let io = |source| EngineError::Io { path: folder.to_path_buf(), source };
    if !folder.is_dir() {
        let expected = "a folder of PNG frames".to_owned();
        return Err(EngineError::MissingInput { path: folder.to_path_buf(), expected });
    }
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if is_png_name(&path) {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        return Err(EngineError::BadData {
            path: folder.to_path_buf(),
            field: "frames".to_owned(),
            got: "no .png file in the folder".to_owned(),
            expected: "at least one".to_owned(),
        });
    }
    paths.sort_by(|a, b| natural_order(&file_name(a), &file_name(b)));
    Ok(paths)
}

/// Reads one PNG of any depth. More than 8 bits are rounded, grey is repeated, transparency is laid over
/// `background`; gamma and profile chunks are ignored.
///
/// # Errors
/// [`EngineError::MissingInput`], [`EngineError::BadData`] if it is no PNG, [`EngineError::Io`].
pub fn read_png(path: &Path, background: [u8; 3]) -> Result<Frame, EngineError> {
    let file = fs::File::open(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => {
            EngineError::MissingInput { path: path.to_path_buf(), expected: "a PNG file".to_owned() }
        }
        _ => EngineError::Io { path: path.to_path_buf(), source },
    })?;
    let mut reader = image::ImageReader::with_format(std::io::BufReader::new(file), ImageFormat::Png);
    reader.limits(image::Limits::default());
    let picture = reader.decode().map_err(|error| EngineError::BadData {
        path: path.to_path_buf(),
        field: "picture".to_owned(),
        got: error.to_string(),
        expected: "a readable PNG".to_owned(),
    })?;
    let (width, height) = (picture.width(), picture.height());
    if picture.color().has_alpha() {
        return Frame::from_rgba8(width, height, &picture.into_rgba8(), background);
    }
    Frame::new(width, height, picture.into_rgb8().into_raw())
}

/// Writes frames as `00000.png`, `00001.png`, … into a folder, which is created if need be.
///
/// # Errors
/// [`EngineError::CannotCreate`] if the folder cannot be made or already holds PNG files, which a reader
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
/// [`EngineError::CannotCreate`] if it cannot be made or already holds PNG files.
pub fn prepare_png_folder(folder: &Path) -> Result<(), EngineError> {
    let cannot = |reason: String| EngineError::CannotCreate { path: folder.to_path_buf(), reason };
    fs::create_dir_all(folder).map_err(|error| cannot(error.to_string()))?;
    if list_png_folder(folder).is_ok() {
        return Err(cannot("the folder already holds PNG files".to_owned()));
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
    PngEncoder::new(&mut out)
        .write_image(&frame.rgb, frame.width, frame.height, ExtendedColorType::Rgb8)
        .map_err(std::io::Error::other)
        .and_then(|()| out.flush())
        .map_err(|source| EngineError::Io { path: path.to_path_buf(), source })
}

fn is_png_name(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str());
    let hidden = file_name(path).starts_with('.');
    !hidden && extension.is_some_and(|e| e.eq_ignore_ascii_case("png"))
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Compares names with runs of digits as numbers; equal numbers fall back to the plain order.
fn natural_order(a: &str, b: &str) -> Ordering {
    natural_key(a).cmp(&natural_key(b)).then_with(|| a.cmp(b))
}

/// Text and number runs in turn; a number is its digits without leading zeros, after their count.
fn natural_key(name: &str) -> Vec<(String, usize, String)> {
    let mut key = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text_end = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(text_end);
        let digits_end = tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len());
        let (digits, tail) = tail.split_at(digits_end);
        let number = digits.trim_start_matches('0');
        key.push((text.to_lowercase(), number.len(), number.to_owned()));
        rest = tail;
    }
    key
}
