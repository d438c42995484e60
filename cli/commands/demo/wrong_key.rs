//! What somebody with another key reads.

use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;
use guard4d_engine::release::evaluate::{mean_accuracy, read_clips};
use guard4d_engine::watermark::embed::{Embedded, Subject};
use guard4d_engine::watermark::extractor::reader::Reader;
use guard4d_engine::watermark::key::owner_key::Key;
use serde::Serialize;

/// Shares of bits right when the marked clips are read with another key and the owner's extractor.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct WrongKey {
    /// Of the other key's own message: chance, unless any key fires on any clip.
    pub(super) own_message: f64,
    /// Of the owner's message. The extractor knows where in CLIP's space each bit lies, so this is what it gives away.
    pub(super) owners_message: f64,
}

/// What someone with another key reads from the marked clips when the owner's extractor is lent to them.
pub(super) fn read_with(
    other: &Key,
    subject: Subject<'_>,
    embedded: &Embedded,
    marked: &[Vec<Frame>],
) -> Result<WrongKey, EngineError> {
    let other = &other.for_asset(subject.model.digest())?;
    let mut reader = Reader::new(subject.device, subject.clip, other, &embedded.extractor)?;
    let readings = read_clips(&mut reader, marked, other.bits())?;
    Ok(WrongKey {
        own_message: mean_accuracy(&readings, &other.own_message())?,
        owners_message: mean_accuracy(&readings, subject.message)?,
    })
}
