//! Small integer ids in the bits of a message: fixed linear block codes, and their exhaustive soft decoding.
//!
//! An id of 12 or 16 bits is spread over all `L` bits of a key, so that the right one is found although some bits are
//! read wrongly. There are so few ids that a clip's logits are compared with the codeword of every one: that is
//! maximum-likelihood decoding, and no code that is easier to decode could do better.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::message::{Message, pad};
use super::reading::Reading;
use super::statistics::{SoftScoreNull, after_search, match_p_value};
use super::thresholds::DecisionStatistic;
use crate::base::prf::Prf;
use crate::error::EngineError;

/// Length of an id.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum IdBits {
    /// Ids 0 to 4095.
    #[serde(rename = "id:12")]
    Twelve,
    /// Ids 0 to 65535.
    #[serde(rename = "id:16")]
    Sixteen,
}

impl IdBits {
    /// Both lengths.
    pub const ALL: [Self; 2] = [Self::Twelve, Self::Sixteen];

    /// Bits of an id, `k`.
    #[must_use]
    pub const fn count(self) -> u32 {
        match self {
            Self::Twelve => 12,
            Self::Sixteen => 16,
        }
    }

    /// Number of ids, 2^k.
    #[must_use]
    pub const fn num_ids(self) -> u32 {
        1 << self.count()
    }

    /// Reads `id:12` or `id:16`; nothing for anything else.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|bits| bits.to_string() == text)
    }
}

/// The name that receipts and the command line use.
impl fmt::Display for IdBits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// One code of the table.
#[derive(Debug, PartialEq, Eq)]
struct Row {
    num_bits: u32,
    /// Fewest bits in which two codewords differ; `tests/evidence/id_code.rs` counts it over all of them.
    distance: u32,
    /// First rows of the circulants beside the identity.
    circulants: &'static [u32],
}

const fn row(num_bits: u32, distance: u32, circulants: &'static [u32]) -> Row {
    Row { num_bits, distance, circulants }
}

/// Codes of 12-bit ids, by length.
const TWELVE: [Row; 15] = [
    row(16, 2, &[0xcd7]),
    row(24, 8, &[0xc5e]),
    row(32, 9, &[0xd88, 0x536]),
    row(40, 14, &[0xbc9, 0x82e, 0xeee]),
    row(48, 17, &[0xe3b, 0x8c6, 0xb22]),
    row(56, 20, &[0x695, 0x765, 0x62d, 0x8e0]),
    row(64, 24, &[0x40f, 0xb77, 0x09c, 0x564, 0xecb]),
    row(72, 28, &[0x91f, 0x2d5, 0x73b, 0x768, 0xd28]),
    row(80, 30, &[0xd82, 0xd45, 0x908, 0x5f9, 0xb22, 0xc2e]),
    row(88, 35, &[0x68c, 0x8f8, 0x309, 0xd29, 0xf38, 0xfb3, 0x444]),
    row(96, 40, &[0x6fa, 0x7a0, 0x2a1, 0x3db, 0xe92, 0xadc, 0x2b8]),
    row(104, 41, &[0x216, 0xd17, 0xa21, 0x116, 0x9d5, 0x0fe, 0x77c, 0x332]),
    row(112, 46, &[0x1b2, 0xa1c, 0xaea, 0x9b7, 0x33f, 0x679, 0x1cc, 0x0a9, 0x222]),
    row(120, 50, &[0xc2b, 0xb55, 0x7d2, 0x90c, 0xf3d, 0xb61, 0x277, 0xbc1, 0x3c0]),
    row(128, 52, &[0xa94, 0x5c0, 0x8cd, 0xd93, 0x0ad, 0x563, 0x6d9, 0xc69, 0xa98, 0xe32]),
];

/// Codes of 16-bit ids, by length.
const SIXTEEN: [Row; 14] = [
    row(24, 4, &[0x7e5a]),
    row(32, 8, &[0xc84f]),
    row(40, 10, &[0x204f, 0x58d7]),
    row(48, 14, &[0xf610, 0x5391]),
    row(56, 16, &[0x8559, 0x29ad, 0x8497]),
    row(64, 22, &[0xd622, 0xda4b, 0x4283]),
    row(72, 24, &[0x9c53, 0xd103, 0xc1af, 0x5b5b]),
    row(80, 28, &[0x59df, 0x697a, 0x25f6, 0x2bd9]),
    row(88, 30, &[0x9730, 0x9ea2, 0x80d2, 0xfc9f, 0x88db]),
    row(96, 34, &[0x13aa, 0x0fe7, 0x420e, 0x42e4, 0x71e4]),
    row(104, 37, &[0x3bf4, 0x681d, 0x312a, 0x33ec, 0x123f, 0xe968]),
    row(112, 42, &[0x5a62, 0x6d2b, 0x116a, 0xa021, 0xb8fd, 0xa4f8]),
    row(120, 44, &[0x70fa, 0x396b, 0x44e4, 0xed76, 0x76ae, 0x168e, 0x82b5]),
    row(128, 48, &[0x5527, 0x67e0, 0x6d2a, 0xe6a6, 0xb640, 0xc419, 0xa52f]),
];

/// A systematic quasi-cyclic code of length `L` for ids of `k` bits.
///
/// # Equation
/// codeword(u) = first `L` bits of u ‖ u·C₁ ‖ u·C₂ ‖ …, with k×k circulants Cⱼ over GF(2), first bit most significant:
/// u·C(a) is the exclusive or of a, rotated left by i, over the bits i that are set in u. Such codes were chosen
/// because random ones of their kind come close to the best distances known (Chen, Peterson and Weldon 1969: circulant
/// codes; Gulliver and Bhargava 1991: rate 1/p quasi-cyclic codes found by search). The table's rows were found so,
/// over about a million random choices each or more, by largest distance, then fewest codewords at that distance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IdCode {
    id_bits: IdBits,
    row: &'static Row,
}

impl IdCode {
    /// The code of `id_bits` for a key of `num_bits` bits.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless `num_bits` is a multiple of 8, greater than the id's bits, at most 128: with no
    /// bit to spare, every reading would be some id.
    pub fn new(id_bits: IdBits, num_bits: u32) -> Result<Self, EngineError> {
        let rows: &[Row] = match id_bits {
            IdBits::Twelve => &TWELVE,
            IdBits::Sixteen => &SIXTEEN,
        };
        let (shortest, longest) = (rows[0].num_bits, rows[rows.len() - 1].num_bits);
        let row = rows.iter().find(|row| row.num_bits == num_bits).ok_or_else(|| EngineError::Usage {
            what: format!("key for a message {id_bits}"),
            got: format!("{num_bits} bits"),
            expected: format!("a multiple of 8, {shortest} to {longest} bits"),
        })?;
        Ok(Self { id_bits, row })
    }

    /// Length of the ids.
    #[must_use]
    pub const fn id_bits(&self) -> IdBits {
        self.id_bits
    }

    /// Length of the codewords, `L`.
    #[must_use]
    pub const fn num_bits(&self) -> u32 {
        self.row.num_bits
    }

    /// Fewest bits in which two codewords differ.
    #[must_use]
    pub const fn distance(&self) -> u32 {
        self.row.distance
    }

    /// The codeword of an id, before the key's pad.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for an id that these bits cannot hold.
    pub fn codeword(&self, id: u32) -> Result<Message, EngineError> {
        let k = self.id_bits.count();
        if id >= self.id_bits.num_ids() {
            return Err(EngineError::Usage {
                what: format!("message {}", self.id_bits),
                got: format!("id {id}"),
                expected: format!("0 to {}", self.id_bits.num_ids() - 1),
            });
        }
        let (mut word, mut left) = (u128::from(id), self.num_bits() - k);
        for &first in self.row.circulants {
            let taken = left.min(k);
            word = word << taken | u128::from(times_circulant(id, first, k) >> (k - taken));
            left -= taken;
        }
        Message::from_value(word, self.num_bits())
    }

    /// The message that carries an id under a key: its codeword, made uniform by the key's pad.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for an id that these bits cannot hold, or a pad of another length.
    pub fn message(&self, id: u32, pad: &Message) -> Result<Message, EngineError> {
        self.codeword(id)?.xor(pad)
    }

    /// The pad of a key for messages of this length.
    ///
    /// # Errors
    /// Never: all rows have lengths that messages have.
    pub fn pad(&self, prf: &Prf) -> Result<Message, EngineError> {
        pad(prf, self.num_bits())
    }

    /// The id whose message agrees best with a clip's mean logits `[L]`, among all 2^k; the smallest of equals.
    ///
    /// # Equation
    /// S(u) = Σ (2mⱼ(u) − 1) oⱼ for all u at once: mⱼ is linear in u, so S is a Walsh–Hadamard transform (k·2^k sums).
    ///
    /// # Errors
    /// [`EngineError::Usage`] for another number of logits or another pad; [`EngineError::NotFinite`].
    pub fn decode(&self, mean_logits: &[f64], pad: &Message) -> Result<IdReading, EngineError> {
        if let Some(&got) = mean_logits.iter().find(|o| !o.is_finite()) {
            return Err(EngineError::NotFinite { what: "mean logit".to_owned(), got });
        }
        if mean_logits.len() != self.num_bits() as usize || pad.num_bits() != self.num_bits() {
            return Err(EngineError::Usage {
                what: "reading of an id".to_owned(),
                got: format!("{} logits, a pad of {} bits", mean_logits.len(), pad.num_bits()),
                expected: format!("{} of both", self.num_bits()),
            });
        }
        let mut scores = vec![0.0; self.id_bits.num_ids() as usize];
        for ((column, flipped), &logit) in self.columns()?.into_iter().zip(pad.bits()).zip(mean_logits) {
            scores[column] += if flipped { logit } else { -logit };
        }
        walsh_hadamard(&mut scores);
        let (mut best, mut second) = ((0, f64::NEG_INFINITY), (0, f64::NEG_INFINITY));
        for (id, &score) in (0_u32..).zip(&scores) {
            if score > best.1 {
                (second, best) = (best, (id, score));
            } else if score > second.1 {
                second = (id, score);
            }
        }
        let per_bit = |score: f64| score / f64::from(self.num_bits());
        Ok(IdReading { id: best.0, score: per_bit(best.1), runner_up: second.0, runner_up_score: per_bit(second.1) })
    }

    /// What a clip says about ids under a key, with the chance that any of them all would agree with it so well.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a reading of another length.
    pub fn read(&self, reading: &Reading, prf: &Prf) -> Result<(IdReading, SearchedP), EngineError> {
        let pad = self.pad(prf)?;
        let found = self.decode(reading.mean_logits(), &pad)?;
        let p = SearchedP::of(reading, &self.message(found.id, &pad)?, self.id_bits.num_ids())?;
        Ok((found, p))
    }

    /// For each bit of a codeword the bits of the id that it is the exclusive or of `[L]`.
    fn columns(&self) -> Result<Vec<usize>, EngineError> {
        let mut columns = vec![0; self.num_bits() as usize];
        for i in 0..self.id_bits.count() {
            for (column, bit) in columns.iter_mut().zip(self.codeword(1 << i)?.bits()) {
                *column |= usize::from(bit) << i;
            }
        }
        Ok(columns)
    }
}

/// The best id of a clip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct IdReading {
    /// The id whose message agrees best.
    pub id: u32,
    /// Its mean over bits of the logits signed by the message.
    pub score: f64,
    /// The next best id.
    pub runner_up: u32,
    /// The same mean for that one.
    pub runner_up_score: f64,
}

impl IdReading {
    /// How far the best id is ahead, in logits per bit; 0 when two agree equally well.
    #[must_use]
    pub fn margin(&self) -> f64 {
        self.score - self.runner_up_score
    }
}

/// Chance that the best of all ids agrees so well with a clip that holds none.
///
/// The pad is uniform and independent of clip and extractor, so for every single id the p-value of a fixed message is
/// exact, and by the union bound their sum bounds the chance that any id does so well. Of the matches it is the exact
/// probability as long as fewer than half of the code's distance are wrong: then no two ids can both do so well.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SearchedP {
    /// Of the number of matches.
    pub matches: f64,
    /// Of the soft score.
    pub soft_score: f64,
    /// Claims that it was chosen from: messages, times the rotations that the mark could be written through.
    pub searched: u32,
}

impl SearchedP {
    /// The one that decides.
    #[must_use]
    pub fn by(&self, statistic: DecisionStatistic) -> f64 {
        match statistic {
            DecisionStatistic::Matches => self.matches,
            DecisionStatistic::SoftScore => self.soft_score,
        }
    }

    /// For a message that was chosen from `searched` after reading; with 1 these are the exact p-values of a fixed one.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the lengths differ.
    pub fn of(reading: &Reading, message: &Message, searched: u32) -> Result<Self, EngineError> {
        let soft = SoftScoreNull::new(reading.mean_logits())?.p_value(message)?;
        let matches = match_p_value(reading.matches(message)?, message.num_bits());
        Ok(Self { matches: after_search(matches, searched), soft_score: after_search(soft, searched), searched })
    }

    /// The same where the extractor, too, was chosen from several, each fixed beforehand.
    #[must_use]
    pub fn among(self, extractors: u32) -> Self {
        Self {
            matches: after_search(self.matches, extractors),
            soft_score: after_search(self.soft_score, extractors),
            searched: self.searched.saturating_mul(extractors),
        }
    }
}

/// u·C for the circulant whose first row is `first`.
fn times_circulant(u: u32, first: u32, k: u32) -> u32 {
    let rotated = |i: u32| (first << i | first >> (k - i)) & ((1 << k) - 1);
    (0..k).filter(|i| u >> i & 1 == 1).fold(0, |sum, i| sum ^ rotated(i))
}

/// In-place transform of a power of two of numbers: y(u) = Σ (−1)^⟨u,v⟩ x(v).
fn walsh_hadamard(values: &mut [f64]) {
    let mut half = 1;
    while half < values.len() {
        for block in values.chunks_exact_mut(2 * half) {
            let (low, high) = block.split_at_mut(half);
            for (a, b) in low.iter_mut().zip(high) {
                (*a, *b) = (*a + *b, *a - *b);
            }
        }
        half *= 2;
    }
}
