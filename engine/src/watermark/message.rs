//! The raw message: 1 to 128 bits, first bit most significant.

use std::fmt;

use rand_chacha::rand_core::Rng;

use super::id_code::{IdBits, IdCode};
use super::prf::{Prf, Purpose};
use crate::EngineError;

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
    pub fn commitment(&self, prf: &Prf) -> super::digest::Digest {
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

/// `hex:` and the digits, most significant first, as [`Payload::parse`] reads it.
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

/// What the user asks to be embedded.
///
/// The *message* is what is embedded and tested. A p-value needs a message that is uniformly distributed
/// and independent of clip and extractor; words people choose are not. So a chosen payload is combined
/// with a pad from the owner's key: message = payload ⊕ pad.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payload {
    /// The key's own message with this many bits.
    Random(u32),
    /// These bits.
    Chosen(Message),
    /// A small number, spread over all bits by a code that corrects errors.
    Id {
        /// The code of its length and the key's.
        code: IdCode,
        /// The number.
        id: u32,
    },
}

impl Payload {
    /// Reads `random`, `hex:…` (⌈L/4⌉ digits), `bits:…` (L digits), `id:12:N` or `id:16:N` (N in decimal) for an
    /// extractor of `num_bits` bits.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming what is accepted: unknown form, foreign digits, wrong length, a key too short.
    pub fn parse(text: &str, num_bits: u32) -> Result<Self, EngineError> {
        check_length(num_bits)?;
        if text == "random" {
            return Ok(Self::Random(num_bits));
        }
        if text.starts_with("id:") {
            return parse_id(text, num_bits);
        }
        let (digits, radix, num_digits, kind) = if let Some(digits) = text.strip_prefix("hex:") {
            (digits, 16, num_bits.div_ceil(4), "hexadecimal digits")
        } else if let Some(digits) = text.strip_prefix("bits:") {
            (digits, 2, num_bits, "digits 0 or 1")
        } else {
            return Err(unreadable(text, "`random`, `hex:…`, `bits:…`, `id:12:N` or `id:16:N`".to_owned()));
        };
        let expected = || format!("{num_digits} {kind} for a key of {num_bits} bits");
        if !digits.chars().all(|digit| digit.is_digit(radix)) {
            return Err(unreadable(text, expected()));
        }
        if digits.len() != num_digits as usize {
            return Err(EngineError::Usage {
                what: "message".to_owned(),
                got: format!("{} digits", digits.len()),
                expected: format!("{}; keys hold 1 to {MAX_MESSAGE_BITS} bits", expected()),
            });
        }
        let value = u128::from_str_radix(digits, radix).map_err(|_| unreadable(text, expected()))?;
        Ok(Self::Chosen(Message::from_value(value, num_bits)?))
    }

    /// The message that carries this payload under the owner's key.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the number of bits is out of range.
    pub fn message(&self, prf: &Prf) -> Result<Message, EngineError> {
        match self {
            Self::Random(num_bits) => {
                let index = u64::from(*num_bits);
                Message::random(*num_bits, &mut prf.stream(Purpose::Message, index))
            }
            Self::Chosen(payload) => payload.xor(&pad(prf, payload.num_bits)?),
            Self::Id { code, id } => code.message(*id, &code.pad(prf)?),
        }
    }

    /// The kind of id that this is, if it is one.
    #[must_use]
    pub fn id_bits(&self) -> Option<IdBits> {
        match self {
            Self::Id { code, .. } => Some(code.id_bits()),
            Self::Random(_) | Self::Chosen(_) => None,
        }
    }

    /// The payload that a read message stands for, if it was a chosen one.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the number of bits is out of range.
    pub fn from_message(message: &Message, prf: &Prf) -> Result<Self, EngineError> {
        Ok(Self::Chosen(message.xor(&pad(prf, message.num_bits)?)?))
    }
}

/// `id:12:N` and `id:16:N`.
fn parse_id(text: &str, num_bits: u32) -> Result<Payload, EngineError> {
    let expected = || "`id:12:N` or `id:16:N` with a decimal number N that these bits hold".to_owned();
    let (kind, digits) = text.rsplit_once(':').ok_or_else(|| unreadable(text, expected()))?;
    let id_bits = IdBits::parse(kind).ok_or_else(|| unreadable(text, expected()))?;
    if !digits.bytes().all(|digit| digit.is_ascii_digit()) {
        return Err(unreadable(text, expected()));
    }
    let id = digits.parse().map_err(|_| unreadable(text, expected()))?;
    let code = IdCode::new(id_bits, num_bits)?;
    code.codeword(id)?;
    Ok(Payload::Id { code, id })
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

fn check_length(num_bits: u32) -> Result<(), EngineError> {
    if (1..=MAX_MESSAGE_BITS).contains(&num_bits) {
        return Ok(());
    }
    Err(EngineError::Usage {
        what: "message length".to_owned(),
        got: format!("{num_bits} bits"),
        expected: format!("1 to {MAX_MESSAGE_BITS} bits"),
    })
}

fn unreadable(text: &str, expected: String) -> EngineError {
    let shown: String = text.chars().take(80).collect();
    EngineError::Usage { what: "message".to_owned(), got: format!("`{shown}`"), expected }
}
