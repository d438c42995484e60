//! What a bit does to CLIP's text feature: measured on messages that follow from the secret, so that anyone who has it
//! can measure again.
//!
//! The messages are a two-level orthogonal array with its complement (a folded-over Sylvester–Hadamard design; Plackett
//! and Burman 1946, Box and Wilson 1951). In its sums no bit leaks into another one's code, and no pair of bits does,
//! so that a thousand messages are worth more than many thousand random ones.

use super::capacity::mean_row;
use super::tokens::TokenTable;
use crate::base::matrix::{row_major, rows, share_apart};
use crate::base::prf::{Prf, Purpose, uniform_below};
use crate::error::EngineError;
use crate::evidence::message::Message;
use crate::networks::clip::ClipModel;

/// Rows of the array before it is folded over, as a power of two: more than a message has bits.
const ARRAY_BITS: u32 = 9;
/// Messages up to this length are taken all.
const ALL_UP_TO_BITS: u32 = ARRAY_BITS + 1;

/// Where text features of messages lie, and how a bit moves them.
#[derive(Clone, Debug, PartialEq)]
pub struct TextCodes {
    /// Mean text feature `[D]`, towards which image features are moved.
    pub mean: Vec<f32>,
    /// Half the change of the text feature when a bit flips from 0 to 1 `[L, D]`.
    pub codes: Vec<f32>,
}

/// The messages that codes are measured on, with their features.
#[derive(Clone, Debug)]
pub struct CodeMessages {
    /// Each message once.
    pub messages: Vec<Message>,
    /// Their text features `[n, D]`.
    pub features: Vec<f32>,
}

impl CodeMessages {
    /// Draws the messages by `prf` and embeds them by CLIP's text tower.
    ///
    /// # Errors
    /// When the device fails.
    pub fn embed(clip: &ClipModel, table: &TokenTable, prf: &Prf) -> Result<Self, EngineError> {
        let messages = draw(prf, u32::try_from(table.num_bits()).unwrap_or(u32::MAX))?;
        let mut sequences = Vec::new();
        for message in &messages {
            sequences.extend(table.sequence(message)?);
        }
        let features = clip.text()?.embed(&sequences, table.num_bits() + 2)?.features;
        Ok(Self { messages, features })
    }

    /// The codes of these messages' bits.
    #[must_use]
    pub fn codes(&self) -> TextCodes {
        let (messages, bits) = (self.messages.len().max(1), self.messages.first().map_or(1, Message::num_bits));
        let width = self.features.len() / messages;
        let mean = mean_row(&self.features, width);
        let sign = |bit: bool| if bit { 1.0 } else { -1.0 };
        let signs: Vec<f32> = self.messages.iter().flat_map(Message::bits).map(sign).collect();
        let centred: Vec<f32> =
            self.features.chunks_exact(width).flat_map(|row| row.iter().zip(&mean).map(|(f, m)| f - m)).collect();
        let sums = rows(&signs, bits as usize).tr_mul(&rows(&centred, width));
        TextCodes { codes: row_major(&(sums / messages as f64)), mean }
    }
}

impl TextCodes {
    /// How far these are from others, as a share of those: the larger of mean and codes. NaN if either has one.
    #[must_use]
    pub fn deviation(&self, other: &Self) -> f64 {
        let (mean, codes) = (share_apart(&self.mean, &other.mean), share_apart(&self.codes, &other.codes));
        if mean.is_nan() || codes.is_nan() { f64::NAN } else { mean.max(codes) }
    }
}

/// A balanced set of messages: each pair of bits takes all four values equally often.
fn draw(prf: &Prf, num_bits: u32) -> Result<Vec<Message>, EngineError> {
    if num_bits <= ALL_UP_TO_BITS {
        return (0..1u128 << num_bits).map(|value| Message::from_value(value, num_bits)).collect();
    }
    let rng = &mut prf.stream(Purpose::CodeMessages, u64::from(num_bits));
    let turned = Message::random(num_bits, rng)?;
    // A bit is a column of the array: the parity of some of the row's binary digits.
    let mut columns: Vec<u32> = (1..1 << ARRAY_BITS).collect();
    for drawn in 0..num_bits {
        let left = (1 << ARRAY_BITS) - 1 - drawn;
        columns.swap(drawn as usize, (drawn + uniform_below(rng, left)) as usize);
    }
    let row = |row: u32| {
        let parity = |column: &u32| (row & column).count_ones() % 2 == 1;
        let bits: Vec<bool> =
            columns[..num_bits as usize].iter().map(parity).zip(turned.bits()).map(|(a, b)| a != b).collect();
        Message::from_bits(&bits)
    };
    let half = (0..1 << ARRAY_BITS).map(row).collect::<Result<Vec<_>, _>>()?;
    Ok(half.iter().copied().chain(half.iter().map(Message::inverted)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::prf::MasterSecret;

    #[test]
    fn every_pair_of_bits_takes_all_four_values_equally_often() {
        for num_bits in [8, 10, 11, 32, 128] {
            let messages = draw(&Prf::new(&MasterSecret::from_bytes([5; 32])), num_bits).expect("a length of messages");
            let rows: Vec<Vec<bool>> = messages.iter().map(|message| message.bits().collect()).collect();
            assert_eq!(rows.len(), 1 << num_bits.min(ALL_UP_TO_BITS), "{num_bits} bits");
            for (a, b) in [(0, 1), (1, 2), (3, 7), (2, num_bits as usize - 1)] {
                let both = |x: bool, y: bool| rows.iter().filter(|row| (row[a], row[b]) == (x, y)).count();
                let counts = [both(false, false), both(false, true), both(true, false), both(true, true)];
                assert_eq!(counts, [rows.len() / 4; 4], "bits {a} and {b} of {num_bits}");
            }
        }
    }

    #[test]
    fn a_bits_code_is_half_of_what_it_changes_whatever_the_others_do() {
        let messages = draw(&Prf::new(&MasterSecret::from_bytes([5; 32])), 16).expect("16 bits");
        // Bit b moves coordinate b by ±(b + 1), and the first two bits together move coordinate 0.
        let feature = |message: &Message| {
            let signs: Vec<f32> = message.bits().map(|bit| if bit { 1.0 } else { -1.0 }).collect();
            let mut row: Vec<f32> = signs.iter().zip(1u8..).map(|(sign, by)| sign * f32::from(by) + 3.0).collect();
            row[0] += 5.0 * signs[0] * signs[1];
            row
        };
        let features = messages.iter().flat_map(feature).collect();
        let codes = CodeMessages { messages, features }.codes();
        assert_eq!(codes.mean, vec![3.0; 16], "the middle of a balanced set");
        for (bit, code) in codes.codes.chunks_exact(16).enumerate() {
            for (at, value) in code.iter().enumerate() {
                let expected = if at == bit { bit as f32 + 1.0 } else { 0.0 };
                assert_eq!(*value, expected, "coordinate {at} of bit {bit}");
            }
        }
    }
}
