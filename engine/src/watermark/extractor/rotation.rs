//! Which of a key's rotations mixes the directions that an extractor reads along.
//!
//! A message asks for other movements under each rotation, and what a scene answers to differs between directions by
//! far: of two rotations of one key and one message, one can be read 20 points better than the other. So marking may
//! try several and keep one. Whoever does so has as many chances as there were rotations, which every p-value counts
//! (union bound).

use serde::Serialize;

use crate::base::prf::{Prf, Purpose};
use crate::base::tensor_file::TensorFile;
use crate::error::EngineError;

/// Most rotations that an embedding can choose from: each doubling takes a bit of what a message can prove.
pub const MAX_ROTATIONS: u32 = 256;

/// Entries of an extractor's file; older than the word rotation, and kept so that those files are read.
const NUMBER: &str = "mixing";
const OF: &str = "mixings";

/// One of the rotations that a key has, by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct KeyRotation {
    /// From 0; less than `of`.
    pub number: u32,
    /// How many it was chosen from with the message known; 1 if it was fixed beforehand.
    pub of: u32,
}

impl KeyRotation {
    /// The first one, without a choice.
    pub const FIXED: Self = Self { number: 0, of: 1 };

    /// The random numbers that the rotation is made of.
    pub(crate) fn stream(self, prf: &Prf) -> rand_chacha::ChaCha20Rng {
        prf.stream(Purpose::Calibration, u64::from(self.number))
    }

    /// Adds the entries `mixing` and `mixings` to a file; without a choice there are none.
    pub(super) fn store(self, file: &mut TensorFile) {
        if self != Self::FIXED {
            file.meta.insert(NUMBER.to_owned(), self.number.to_string());
            file.meta.insert(OF.to_owned(), self.of.to_string());
        }
    }

    /// Reads what [`KeyRotation::store`] wrote.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the entry.
    pub(super) fn load(file: &TensorFile) -> Result<Self, EngineError> {
        if !file.meta.contains_key(NUMBER) && !file.meta.contains_key(OF) {
            return Ok(Self::FIXED);
        }
        let whole = |name: &str, least: u32, most: u32| {
            let text = file.text(name)?;
            let number: Option<u32> = text.parse().ok().filter(|number| (least..=most).contains(number));
            number.ok_or_else(|| file.bad(name, text, &format!("a whole number from {least} to {most}")))
        };
        let of = whole(OF, 1, MAX_ROTATIONS)?;
        Ok(Self { number: whole(NUMBER, 0, of - 1)?, of })
    }
}
