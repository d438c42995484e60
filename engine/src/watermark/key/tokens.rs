//! Bit-to-token table: how a message becomes a sentence for CLIP's text tower.

use crate::base::digest::Digest;
use crate::base::prf::{Prf, Purpose, uniform_below};
use crate::error::EngineError;
use crate::evidence::message::{MAX_MESSAGE_BITS, Message};

/// A text tower's vocabulary, from its configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Vocabulary {
    /// Number of token ids. The last two are the begin and the end token.
    pub size: u32,
    /// Longest sequence in tokens.
    pub context: u32,
}

impl Vocabulary {
    /// Token that opens every sequence.
    #[must_use]
    pub const fn begin(&self) -> u32 {
        self.size - 2
    }

    /// Token that closes every sequence; the text feature is read there.
    #[must_use]
    pub const fn end(&self) -> u32 {
        self.size - 1
    }

    /// Ids that may stand for bits: 1 to size − 3 (0 pads).
    const fn num_usable(&self) -> u32 {
        self.size.saturating_sub(3)
    }

    /// Longest message that a sequence can hold beside its begin and end token, with two distinct ids per bit.
    #[must_use]
    pub fn max_bits(&self) -> u32 {
        self.context.saturating_sub(2).min(self.num_usable() / 2).min(MAX_MESSAGE_BITS)
    }

    /// Whether a sequence can hold a message of `num_bits` bits.
    #[must_use]
    pub fn holds(&self, num_bits: u32) -> bool {
        (1..=self.max_bits()).contains(&num_bits)
    }

    /// The refusal of a message length; `also` is what is asked of it beside the range, with a comma after it.
    pub(super) fn refusal(&self, num_bits: u32, also: &str) -> EngineError {
        let Self { size, context } = self;
        let most = self.max_bits();
        EngineError::Usage {
            what: "message length".to_owned(),
            got: format!("{num_bits} bits"),
            expected: format!("{also}1 to {most} bits with this CLIP (context {context} tokens, vocabulary {size})"),
        }
    }
}

/// For each bit position the token of a 0 and the token of a 1; all `2L` ids differ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenTable {
    vocabulary: Vocabulary,
    ids: Vec<[u32; 2]>,
}

impl TokenTable {
    /// Derives the owner's table: the first `2L` entries of a keyed random permutation of the usable ids.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the vocabulary cannot hold `num_bits` bits.
    /// # Determinism
    /// The same secret, vocabulary and length give the same table on every platform.
    pub fn derive(prf: &Prf, vocabulary: Vocabulary, num_bits: u32) -> Result<Self, EngineError> {
        if !vocabulary.holds(num_bits) {
            return Err(vocabulary.refusal(num_bits, ""));
        }
        let rng = &mut prf.stream(Purpose::TokenTable, 0);
        let mut usable: Vec<u32> = (1..=vocabulary.num_usable()).collect();
        for drawn in 0..2 * num_bits {
            let other = drawn + uniform_below(rng, vocabulary.num_usable() - drawn);
            usable.swap(drawn as usize, other as usize);
        }
        let ids = usable[..2 * num_bits as usize].chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect();
        Ok(Self { vocabulary, ids })
    }

    /// Number of message bits, `L`.
    #[must_use]
    pub fn num_bits(&self) -> usize {
        self.ids.len()
    }

    /// The table `[L, 2]`: row = bit position, column = bit value.
    #[must_use]
    pub fn ids(&self) -> &[[u32; 2]] {
        &self.ids
    }

    /// The sequence of `L + 2` tokens for a message: begin, one token per bit, end. Positions after the
    /// end token cannot reach the feature (the text tower is causal), so none are produced.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the message's length is not the table's.
    pub fn sequence(&self, message: &Message) -> Result<Vec<u32>, EngineError> {
        if message.num_bits() as usize != self.num_bits() {
            return Err(EngineError::Usage {
                what: "message".to_owned(),
                got: format!("{} bits", message.num_bits()),
                expected: format!("{} bits, the key's length", self.num_bits()),
            });
        }
        let body = self.ids.iter().zip(message.bits());
        Ok(std::iter::once(self.vocabulary.begin())
            .chain(body.map(|(row, bit)| row[usize::from(bit)]))
            .chain(std::iter::once(self.vocabulary.end()))
            .collect())
    }

    /// Hash of vocabulary and table, for receipts.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let words = [self.vocabulary.size, self.vocabulary.context];
        let bytes: Vec<u8> = words.iter().chain(self.ids.as_flattened()).flat_map(|word| word.to_le_bytes()).collect();
        Digest::of(&bytes)
    }
}
