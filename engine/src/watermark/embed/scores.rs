//! How well rows of logits say a message.

use crate::error::EngineError;
use crate::evidence::message::Message;
use crate::evidence::statistics::SoftScoreNull;

/// Share of the message's bits that rows of logits show, each bit against its own `zero`.
pub(super) fn share_right(logits: &[f32], zero: &[f32], message: &Message) -> f32 {
    let rows = logits.chunks_exact(zero.len());
    let right = rows.flat_map(|row| row.iter().zip(zero).zip(message.bits())).filter(|((o, z), b)| (o > z) == *b);
    right.count() as f32 / logits.len() as f32
}

/// Share of the rows of logits that prove the message alone at a false-positive rate.
pub(super) fn share_proven(readings: &[f32], zero: &[f32], message: &Message, fpr: f64) -> Result<f32, EngineError> {
    let mut proven = 0;
    for row in readings.chunks_exact(zero.len()) {
        let moved: Vec<f64> = row.iter().zip(zero).map(|(o, z)| f64::from(o - z)).collect();
        proven += usize::from(SoftScoreNull::new(&moved)?.p_value(message)? <= fpr);
    }
    Ok(proven as f32 / (readings.len() / zero.len()) as f32)
}

/// Mean of each column; zeros without a row.
pub(super) fn column_means(rows: &[f32], columns: usize) -> Vec<f32> {
    let share = 1.0 / (rows.len() / columns).max(1) as f32;
    let mut means = vec![0.0; columns];
    for row in rows.chunks_exact(columns) {
        means.iter_mut().zip(row).for_each(|(mean, v)| *mean += share * v);
    }
    means
}
