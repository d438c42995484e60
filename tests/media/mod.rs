//! Frames, folders of pictures, and video through the ffmpeg program.

mod codec;
mod decode;
mod encode;
mod folder;
mod frames;
mod framing;
mod open_exr;
mod source;

use std::path::{Path, PathBuf};
use std::process::Command;

use guard4d_engine::error::EngineError;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::png::write_png_folder;
use guard4d_engine::media::{Clip, Frame, ReadOptions, read_clip};
use guard4d_engine::picture::metrics::{Picture, PsnrSummary, SquaredError};

/// Runs ffmpeg with words separated by blanks; the output path comes last.
pub(crate) fn ffmpeg(words: &str, output: &Path) {
    let run = Command::new("ffmpeg").args(["-v", "error", "-y"]).args(words.split(' ')).arg(output).output();
    let run = run.expect("has_ffmpeg was asked");
    assert!(run.status.success(), "ffmpeg {words}: {}", String::from_utf8_lossy(&run.stderr));
}

/// A smooth moving picture: codecs keep it, so that what differs is our doing.
pub(super) fn smooth(width: u32, height: u32, time: u32) -> Frame {
    let pixel = |i: u32| {
        let (x, y) = (f64::from(i % width + time) / 24.0, f64::from(i / width) / 18.0);
        [x.sin(), y.cos(), (x + y).sin()].map(|v| (128.0 + 90.0 * v).round() as u8)
    };
    Frame::new(width, height, (0..width * height).flat_map(pixel).collect()).expect("the length fits")
}

pub(super) fn read(path: &Path) -> Clip {
    read_clip(path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

pub(super) fn code<T>(result: Result<T, EngineError>) -> u8 {
    result.map(|_| ()).expect_err("this is refused").exit_code()
}

pub(super) fn psnr(a: &[Frame], b: &[Frame]) -> f64 {
    let error = |(a, b): (&Frame, &Frame)| SquaredError::between(&Picture::from_frame(a), &Picture::from_frame(b));
    let errors: Result<Vec<_>, _> = a.iter().zip(b).map(error).collect();
    PsnrSummary::of(&errors.expect("equal sizes")).expect("there are frames").pooled_db.0
}

pub(super) fn written(folder: &Path, frames: &[Frame], options: &EncodeOptions) -> PathBuf {
    let path = folder.join("clip.mp4");
    write_video(&path, frames, options).unwrap_or_else(|error| panic!("{error}"));
    path
}

/// Frames as a folder of PNG files for ffmpeg.
pub(super) fn pngs(folder: &Path, frames: &[Frame]) -> String {
    let pngs = folder.join("pngs");
    write_png_folder(&pngs, frames).expect("the folder is writable");
    pngs.join("%05d.png").display().to_string()
}
