//! What a message is made of: its bits as given, or a number and its code.

use super::id_code::{IdBits, IdCode};
use super::message::{MAX_MESSAGE_BITS, Message, check_length, pad, unreadable};
use crate::base::prf::{Prf, Purpose};
use crate::error::EngineError;

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
            Self::Chosen(payload) => payload.xor(&pad(prf, payload.num_bits())?),
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
        Ok(Self::Chosen(message.xor(&pad(prf, message.num_bits())?)?))
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
