//! The raw message: 1 to 128 bits, first bit most significant.

use std::fmt;

use rand_chacha::rand_core::Rng;

use crate::base::digest::Digest;
use crate::base::prf::{Prf, Purpose};
use crate::error::EngineError;

/// Longest raw message in bits.
pub const MAX_MESSAGE_BITS: u32 = 128;

/// A raw message of `L` bits. Bit 0 is the most significant digit of the message as an integer.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Message {
    value: u128,
    num_bits: u32,
}

impl Message {
    /// Takes the low `num_bits` bits of `value`.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless `num_bits` is in 1..=[`MAX_MESSAGE_BITS`] and `value` fits.
    pub fn from_value(value: u128, num_bits: u32) -> Result<Self, EngineError> {
        check_length(num_bits)?;
        if value & !mask(num_bits) != 0 {
            return Err(EngineError::Usage {
                what: "message".to_owned(),
                got: format!("{} bits", 128 - value.leading_zeros()),
                expected: format!("at most {num_bits} bits"),
            });
        }
        Ok(Self { value, num_bits })
    }

    /// Collects bits, first bit first.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if there are none or more than [`MAX_MESSAGE_BITS`].
    pub fn from_bits(bits: &[bool]) -> Result<Self, EngineError> {
        let num_bits = u32::try_from(bits.len()).unwrap_or(u32::MAX);
        check_length(num_bits)?;
        let value = bits.iter().fold(0, |v, &bit| v << 1 | u128::from(bit));
        Ok(Self { value, num_bits })
    }

    /// Draws a uniformly distributed message.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless `num_bits` is in 1..=[`MAX_MESSAGE_BITS`].
    pub fn random(num_bits: u32, rng: &mut impl Rng) -> Result<Self, EngineError> {
        check_length(num_bits)?;
        let draw = u128::from(rng.next_u64()) << 64 | u128::from(rng.next_u64());
        Ok(Self { value: draw & mask(num_bits), num_bits })
    }

    /// Number of bits, `L`.
    #[must_use]
    pub const fn num_bits(&self) -> u32 {
        self.num_bits
    }

    /// The message as an integer.
    #[must_use]
    pub const fn value(&self) -> u128 {
        self.value
    }

    /// Bits, first bit first.
    pub fn bits(&self) -> impl ExactSizeIterator<Item = bool> + use<> {
        let Self { value, num_bits } = *self;
        (0..num_bits).map(move |i| value >> (num_bits - 1 - i) & 1 == 1)
    }

    /// Every bit flipped.
    #[must_use]
    pub const fn inverted(&self) -> Self {
        Self { value: !self.value & mask(self.num_bits), num_bits: self.num_bits }
    }

    /// A message that differs in half of the bits (rounded down), chosen at random: whoever reads one of the two
    /// messages perfectly reads the other at chance.
    #[must_use]
    pub fn half_flipped(&self, rng: &mut impl Rng) -> Self {
        let mut value = self.value;
        let mut left = self.num_bits / 2;
        for bit in 0..self.num_bits {
            // Each remaining bit is as likely as the others to be among those left to flip.
            if u64::from(left) * (1 << 32) > (rng.next_u64() >> 32) * u64::from(self.num_bits - bit) {
                value ^= 1 << bit;
                left -= 1;
            }
        }
        Self { value, num_bits: self.num_bits }
    }

    /// Number of differing bits.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the lengths differ.
    pub fn hamming(&self, other: &Self) -> Result<u32, EngineError> {
        if self.num_bits != other.num_bits {
            return Err(EngineError::Usage {
                what: "message to compare".to_owned(),
                got: format!("{} bits", other.num_bits),
                expected: format!("{} bits", self.num_bits),
            });
        }
        Ok((self.value ^ other.value).count_ones())
    }

    /// Share of equal bits, 0 to 1.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the lengths differ.
    pub fn bit_accuracy(&self, other: &Self) -> Result<f64, EngineError> {
        Ok(1.0 - f64::from(self.hamming(other)?) / f64::from(self.num_bits))
    }

    /// MAC by which a receipt commits to this message without showing it.
    #[must_use]
    pub fn commitment(&self, prf: &Prf) -> Digest {
        let mut data = [0; 20];
        data[..4].copy_from_slice(&self.num_bits.to_le_bytes());
        data[4..].copy_from_slice(&self.value.to_le_bytes());
        prf.mac(Purpose::MessageMac, &data)
    }

    /// Bits that differ between this and `pad`.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the lengths differ.
    pub(super) fn xor(&self, pad: &Self) -> Result<Self, EngineError> {
        self.hamming(pad)?;
        Ok(Self { value: self.value ^ pad.value, num_bits: self.num_bits })
    }
}

/// `hex:` and the digits, most significant first, as [`super::payload::Payload::parse`] reads it.
impl fmt::Display for Message {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = self.num_bits.div_ceil(4) as usize;
        write!(f, "hex:{:0digits$x}", self.value)
    }
}

impl fmt::Debug for Message {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Message({self}, {} bits)", self.num_bits)
    }
}

/// What makes a chosen payload uniformly distributed.
///
/// # Errors
/// [`EngineError::Usage`] if the number of bits is out of range.
pub(super) fn pad(prf: &Prf, num_bits: u32) -> Result<Message, EngineError> {
    Message::random(num_bits, &mut prf.stream(Purpose::PayloadPad, u64::from(num_bits)))
}

const fn mask(num_bits: u32) -> u128 {
    u128::MAX >> (128 - num_bits)
}

pub(super) fn check_length(num_bits: u32) -> Result<(), EngineError> {
    if (1..=MAX_MESSAGE_BITS).contains(&num_bits) {
        return Ok(());
    }
    Err(EngineError::Usage {
        what: "message length".to_owned(),
        got: format!("{num_bits} bits"),
        expected: format!("1 to {MAX_MESSAGE_BITS} bits"),
    })
}

pub(super) fn unreadable(text: &str, expected: String) -> EngineError {
    let shown: String = text.chars().take(80).collect();
    EngineError::Usage { what: "message".to_owned(), got: format!("`{shown}`"), expected }
}
