//! The distance of two single frames, with nothing to prepare.

use guard4d_kernels::image::resize::ImageSize;

use super::network::{Lpips, LpipsScore};
use super::pass::{LpipsPass, Pair};
use crate::error::EngineError;
use crate::media::Frame;

impl Lpips {
    /// Distance of two pictures of the same size.
    ///
    /// # Errors
    /// [`EngineError::Usage`] when their sizes differ or are too small; when the device fails.
    pub fn distance(&self, a: &Frame, b: &Frame) -> Result<LpipsScore, EngineError> {
        let size = size_of_frame(a);
        let mut pass = self.pass(size, 1)?;
        self.distance_with(&mut pass, a, b)
    }

    /// The same with working memory for one frame of this size.
    ///
    /// # Errors
    /// As [`Lpips::distance`].
    pub fn distance_with(&self, pass: &mut LpipsPass, a: &Frame, b: &Frame) -> Result<LpipsScore, EngineError> {
        let expected = format!("{} x {} px", a.width(), a.height());
        if size_of_frame(a) != size_of_frame(b) {
            let got = format!("{} x {} px", b.width(), b.height());
            return Err(EngineError::Usage { what: "pictures to compare".to_owned(), got, expected });
        }
        let image = self.device.buffer_from("lpips.image", &a.to_rgba32f())?;
        let reference = self.device.buffer_from("lpips.reference", &b.to_rgba32f())?;
        let mut rec = self.device.recorder()?;
        let pair = Pair { image: &image, reference: &reference, full: size_of_frame(a), corner: [0, 0] };
        self.step(&mut rec, pass, &pair, None)?;
        rec.submit()?;
        Ok(pass.score(&pass.values().read()?))
    }
}

/// Height and width of a frame.
#[must_use]
pub fn size_of_frame(frame: &Frame) -> ImageSize {
    ImageSize { height: frame.height() as usize, width: frame.width() as usize }
}
