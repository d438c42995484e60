//! Folders of numbered pictures: PNG, JPEG or OpenEXR.

use std::fs;
use std::path::{Path, PathBuf};

use image::ImageFormat;

use super::ffmpeg::Ffmpeg;
use super::frames::Frame;
use super::open_exr;
use crate::base::natural;
use crate::error::EngineError;

/// A kind of picture file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Png,
    Jpeg,
    OpenExr,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Png, Self::Jpeg, Self::OpenExr];

    /// By the extension alone: what a file of another kind holds is refused when it is read.
    fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "png" => Some(Self::Png),
            "jpg" | "jpeg" => Some(Self::Jpeg),
            "exr" => Some(Self::OpenExr),
            _ => None,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::OpenExr => "OpenEXR",
        }
    }
}

/// Pictures of a folder in natural order: `9.png` before `10.png`. Hidden files and files of other kinds are not looked
/// at.
///
/// # Errors
/// [`EngineError::MissingInput`] if the folder is missing, [`EngineError::BadData`] if it holds no picture or pictures
/// of several kinds, of which none can be told to be the clip; [`EngineError::Io`] if it cannot be listed.
pub fn list_pictures(folder: &Path) -> Result<Vec<PathBuf>, EngineError> {
    if !folder.is_dir() {
        let expected = "a folder of PNG, JPEG or OpenEXR frames".to_owned();
        return Err(EngineError::MissingInput { path: folder.to_path_buf(), expected });
    }
    let bad = |got: String, expected: &str| EngineError::BadData {
        path: folder.to_path_buf(),
        field: "frames".to_owned(),
        got,
        expected: expected.to_owned(),
    };
    let found = pictures(folder)?;
    let has = |kind: Kind| found.iter().any(|(_, k)| *k == kind);
    let kinds: Vec<_> = Kind::ALL.into_iter().filter(|kind| has(*kind)).map(Kind::name).collect();
    match kinds.len() {
        0 => return Err(bad("no .png, .jpg or .exr file in the folder".to_owned(), "at least one")),
        1 => {}
        _ => return Err(bad(format!("{} files", kinds.join(" and ")), "files of one kind")),
    }
    let mut paths: Vec<_> = found.into_iter().map(|(path, _)| path).collect();
    // Names that differ in case or leading zeros only fall back to the plain order.
    paths.sort_by_cached_key(|path| (natural::key(&file_name(path).to_lowercase()), file_name(path)));
    Ok(paths)
}

/// Pictures of a folder in any order.
///
/// # Errors
/// [`EngineError::Io`] if it cannot be listed.
pub(super) fn pictures(folder: &Path) -> Result<Vec<(PathBuf, Kind)>, EngineError> {
    let io = |source| EngineError::Io { path: folder.to_path_buf(), source };
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if let Some(kind) = Kind::of(&path).filter(|_| !file_name(&path).starts_with('.')) {
            found.push((path, kind));
        }
    }
    Ok(found)
}

/// Reads one picture of any depth; its extension says of what kind it is.
///
/// PNG and JPEG: more than 8 bits are rounded, grey is repeated, transparency is laid over `background`; gamma,
/// profiles and EXIF rotation are ignored. OpenEXR, which needs `ffmpeg`, holds light: what is above 1 is 1, and the
/// rest goes through sRGB's transfer function and is rounded to 8 bits.
///
/// # Errors
/// [`EngineError::MissingInput`], [`EngineError::BadData`] if it is no picture of its kind, [`EngineError::Io`];
/// [`EngineError::Program`] for OpenEXR without ffmpeg.
pub fn read_picture(path: &Path, background: [u8; 3], ffmpeg: &Ffmpeg) -> Result<Frame, EngineError> {
    let (kind, format) = match Kind::of(path) {
        Some(Kind::OpenExr) => return open_exr::read(path, background, ffmpeg),
        Some(Kind::Jpeg) => (Kind::Jpeg, ImageFormat::Jpeg),
        _ => (Kind::Png, ImageFormat::Png),
    };
    let file = fs::File::open(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => {
            EngineError::MissingInput { path: path.to_path_buf(), expected: format!("a {} file", kind.name()) }
        }
        _ => EngineError::Io { path: path.to_path_buf(), source },
    })?;
    let mut reader = image::ImageReader::with_format(std::io::BufReader::new(file), format);
    reader.limits(image::Limits::default());
    let picture = reader.decode().map_err(|error| EngineError::BadData {
        path: path.to_path_buf(),
        field: "picture".to_owned(),
        got: error.to_string(),
        expected: format!("a readable {}", kind.name()),
    })?;
    let (width, height) = (picture.width(), picture.height());
    if picture.color().has_alpha() {
        return Frame::from_rgba8(width, height, &picture.into_rgba8(), background);
    }
    Frame::new(width, height, picture.into_rgb8().into_raw())
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
