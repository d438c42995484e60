//! Whether a checkpoint's text features can carry a message: spectrum and held-out reading.

use std::path::Path;

use guard4d_kernels::Device;

use super::decoder::{Decoder, DecoderWeights};
use crate::error::EngineError;
use crate::evidence::message::Message;

/// Smallest L-th singular value of usable message features. A tower whose features collapse has
/// .0004 at the 16th (first measurements, method notes); the mini CLIP stays above .01 at the 48th.
const MIN_SINGULAR_VALUE: f32 = 0.002;
/// Share of held-out bits that must be read up to 32 bits, and above.
const MIN_ACCURACY: [f64; 2] = [1.0, 0.9999];
/// Messages whose spectrum stands for all.
pub const SPECTRUM_ROWS: usize = 4_096;
/// Held-out features per batch.
const BATCH: usize = 512;

/// Singular values of centred features, divided by √rows, largest first.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(transparent)]
pub struct Spectrum(pub Vec<f32>);

/// How held-out messages are read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutReading {
    /// Share of bits read right.
    pub bit_accuracy: f64,
    /// Share of messages without an error.
    pub exact: f64,
}

/// Mean of the rows of `features` `[n, width]`.
#[must_use]
#[allow(clippy::cast_possible_truncation, reason = "a mean of single-precision values")]
pub fn mean_row(features: &[f32], width: usize) -> Vec<f32> {
    let rows = (features.len() / width).max(1) as f64;
    let mut sum = vec![0.0f64; width];
    for row in features.chunks_exact(width) {
        for (s, v) in sum.iter_mut().zip(row) {
            *s += f64::from(*v);
        }
    }
    sum.into_iter().map(|s| (s / rows) as f32).collect()
}

/// Spectrum of features `[n, width]` around their mean.
///
/// # Errors
/// [`EngineError::BadData`] for features that are no numbers, on which no eigenvalue iteration would end.
pub fn spectrum(features: &[f32], width: usize, clip: &Path) -> Result<Spectrum, EngineError> {
    if let Some(value) = features.iter().find(|v| !v.is_finite()) {
        return Err(EngineError::BadData {
            path: clip.to_owned(),
            field: "message features".to_owned(),
            got: value.to_string(),
            expected: "finite numbers: this checkpoint cannot carry a message".to_owned(),
        });
    }
    let mean = mean_row(features, width);
    let rows = features.len() / width;
    let centred = nalgebra::DMatrix::from_fn(rows, width, |i, j| features[i * width + j] - mean[j]);
    let gram = centred.tr_mul(&centred) / rows.max(1) as f32;
    let mut values: Vec<f32> = gram.symmetric_eigenvalues().iter().map(|v| v.max(0.0).sqrt()).collect();
    values.sort_by(|a, b| b.total_cmp(a));
    Ok(Spectrum(values))
}

/// Refuses features whose L-th direction is too weak.
///
/// # Errors
/// [`EngineError::BadData`] naming the value found and needed.
pub fn check_spectrum(spectrum: &Spectrum, bits: usize, clip: &Path) -> Result<(), EngineError> {
    let value = spectrum.0.get(bits - 1).copied().unwrap_or(0.0);
    if value >= MIN_SINGULAR_VALUE {
        return Ok(());
    }
    Err(EngineError::BadData {
        path: clip.to_owned(),
        field: format!("singular value {bits} of the message features"),
        got: format!("{value:.5}"),
        expected: format!("at least {MIN_SINGULAR_VALUE}: this checkpoint cannot carry {bits} bits"),
    })
}

/// Decodes held-out features `[n, width]`.
///
/// # Errors
/// When the device fails.
pub fn read_held_out(
    device: &Device,
    weights: &DecoderWeights,
    features: &[f32],
    messages: &[Message],
) -> Result<HeldOutReading, EngineError> {
    let decoder = Decoder::new(device, weights)?;
    let mut pass = decoder.pass(device, BATCH)?;
    let width = weights.width();
    let (mut right, mut exact) = (0u64, 0u64);
    for (rows, expected) in features.chunks_exact(BATCH * width).zip(messages.chunks_exact(BATCH)) {
        let input = device.buffer_from("held_out", rows)?;
        let mut rec = device.recorder()?;
        decoder.forward(&mut rec, &input, &mut pass)?;
        rec.submit()?;
        let logits = pass.logits.read()?;
        for (row, message) in logits.chunks_exact(weights.bits()).zip(expected) {
            let hits = row.iter().zip(message.bits()).filter(|(o, bit)| (**o > 0.0) == *bit).count();
            right += hits as u64;
            exact += u64::from(hits == weights.bits());
        }
    }
    let read = (messages.len() / BATCH * BATCH) as f64;
    Ok(HeldOutReading { bit_accuracy: right as f64 / (read * weights.bits() as f64), exact: exact as f64 / read })
}

/// Share of `messages` in which a decoder reads each bit right from their `features` `[n, width]`: `[L]`.
///
/// # Errors
/// When the device fails.
pub fn read_bits(
    device: &Device,
    weights: &DecoderWeights,
    features: &[f32],
    messages: &[Message],
) -> Result<Vec<f64>, EngineError> {
    let decoder = Decoder::new(device, weights)?;
    let mut pass = decoder.pass(device, messages.len())?;
    let input = device.buffer_from("code_messages", features)?;
    let mut rec = device.recorder()?;
    decoder.forward(&mut rec, &input, &mut pass)?;
    rec.submit()?;
    let logits = pass.logits.read()?;
    let mut right = vec![0.0; weights.bits()];
    for (row, message) in logits.chunks_exact(weights.bits()).zip(messages) {
        for ((count, logit), bit) in right.iter_mut().zip(row).zip(message.bits()) {
            *count += f64::from(u8::from((*logit > 0.0) == bit));
        }
    }
    right.iter_mut().for_each(|count| *count /= messages.len() as f64);
    Ok(right)
}

/// Refuses a decoder that does not read messages it never saw.
///
/// # Errors
/// [`EngineError::BadData`] naming the accuracy found and needed.
pub fn check_reading(reading: &HeldOutReading, bits: usize, clip: &Path) -> Result<(), EngineError> {
    let needed = MIN_ACCURACY[usize::from(bits > 32)];
    if reading.bit_accuracy >= needed {
        return Ok(());
    }
    Err(EngineError::BadData {
        path: clip.to_owned(),
        field: format!("{bits}-bit decoder on held-out messages"),
        got: format!("{:.5} of bits right", reading.bit_accuracy),
        expected: format!("at least {needed}: this checkpoint cannot carry {bits} bits"),
    })
}
