//! The code: a chip of +1 or −1 for each position of each copy, biased so that copies which are mixed cannot hide.
//!
//! Tardos (J. ACM 55, 2008) with discrete biases (Nuida et al., DCC 52, 2009): the nodes of a Gauss–Legendre rule of
//! three points, for which up to six copies, mixed by whatever rule, leave the same trace of all together. Chips follow
//! from the key and the number of a copy, so that a copy can be scored of which no record is left.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::base::digest::Digest;
use crate::base::prf::{Prf, Purpose};
use crate::error::EngineError;
use crate::evidence::score_tail::{ScoreTail, TwoValued};

/// Steps in which probabilities are told: a chip is +1 where 16 random bits lie below its bias.
const STEPS: f64 = 65536.0;

/// The share of copies that have +1 at a position, in steps of 2^-16; never 0 nor 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Bias(u16);

impl Bias {
    /// The three biases that are drawn from, smallest first: ½ and ½ ± √(3/20), rounded.
    pub const NODES: [Self; 3] = [Self(7386), Self(32768), Self(58150)];

    /// As a number between 0 and 1.
    #[must_use]
    pub fn probability(self) -> f64 {
        f64::from(self.0) / STEPS
    }

    /// As the bound that 16 random bits stay below.
    #[must_use]
    pub fn steps(self) -> u16 {
        self.0
    }

    /// What a chip of +1 and one of −1 count, of mean 0 and variance 1 by chance: √((1−p)/p) and −√(p/(1−p)).
    #[must_use]
    pub fn symbols(self) -> [f64; 2] {
        let p = self.probability();
        [((1.0 - p) / p).sqrt(), -(p / (1.0 - p)).sqrt()]
    }

    /// How far a chip of +1 and one of −1 move the colour, in units of its amplitude: g(x − μ) with μ = 2p − 1, centred
    /// so that the mean of all copies is the original.
    #[must_use]
    pub fn offsets(self) -> [f64; 2] {
        let mean = 2.0 * self.probability() - 1.0;
        [GAIN * (1.0 - mean), GAIN * (-1.0 - mean)]
    }
}

/// 1/√E[4p(1−p)], with which centred chips have the mean square of plain ones.
const GAIN: f64 = 1.289_294;
/// The part of 2^32 that the outer nodes are drawn with each: q ∝ w/√(p(1−p)), 0.332 013.
const OUTER: u32 = 1_425_985_642;

/// The secret of one copy, which its chips follow from.
#[derive(Clone, PartialEq, Eq)]
pub struct CopyKey([u8; 32]);

impl std::fmt::Debug for CopyKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("CopyKey(hidden)")
    }
}

impl CopyKey {
    /// Of copy number `copy` of the asset whose hash is `original`.
    #[must_use]
    pub fn new(prf: &Prf, original: Digest, copy: u64) -> Self {
        let data = [original.as_bytes().as_slice(), &copy.to_le_bytes()].concat();
        Self(*prf.mac(Purpose::CopyChips, &data).as_bytes())
    }

    /// The key as the words of a block cipher.
    #[must_use]
    pub fn words(&self) -> [u32; 8] {
        std::array::from_fn(|i| u32::from_le_bytes(std::array::from_fn(|b| self.0[4 * i + b])))
    }
}

/// The biases of all positions of an asset: the same for all of its copies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Code {
    biases: Vec<Bias>,
}

impl Code {
    /// Draws `positions` biases.
    ///
    /// # Determinism
    /// The same on every platform: whole numbers alone decide.
    #[must_use]
    pub fn draw(prf: &Prf, positions: usize) -> Self {
        let mut rng = prf.stream(Purpose::CodeBiases, 0);
        let node = |word: u32| match word {
            0..OUTER => Bias::NODES[0],
            word if word > u32::MAX - OUTER => Bias::NODES[2],
            _ => Bias::NODES[1],
        };
        Self { biases: (0..positions).map(|_| node(rng.next_u32())).collect() }
    }

    /// The bias of each position.
    #[must_use]
    pub fn biases(&self) -> &[Bias] {
        &self.biases
    }

    /// The chips of a copy: whether each is +1.
    ///
    /// # Equation
    /// Position i takes 16 bits of `ChaCha8` (Bernstein 2008) under the copy's key: the low half of word i/2 where i is
    /// even, else the high one. The chip is +1 where they lie below the bias.
    pub fn chips(&self, copy: &CopyKey) -> impl Iterator<Item = bool> {
        let mut rng = ChaCha8Rng::from_seed(copy.0);
        let mut word = 0;
        self.biases.iter().enumerate().map(move |(i, bias)| {
            word = if i % 2 == 0 { rng.next_u32() } else { word >> 16 };
            word & 0xffff < u32::from(bias.0)
        })
    }

    /// What each chip of a copy amounts to, by a pair of numbers for +1 and −1 of each bias, such as [`Bias::symbols`].
    pub fn values(&self, copy: &CopyKey, pair: fn(Bias) -> [f64; 2]) -> impl Iterator<Item = f64> {
        self.biases.iter().zip(self.chips(copy)).map(move |(bias, is_plus)| pair(*bias)[usize::from(!is_plus)])
    }

    /// The score of a copy: how well its chips agree with what was found at each position.
    ///
    /// # Equation
    /// S = Σ c u, with the [symbols](Bias::symbols) u.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless there is one number for each position.
    pub fn score(&self, evidence: &[f64], copy: &CopyKey) -> Result<f64, EngineError> {
        self.check(evidence)?;
        Ok(self.values(copy, Bias::symbols).zip(evidence).map(|(u, c)| c * u).sum())
    }

    /// How such scores are distributed for copies that have nothing to do with the evidence: exactly, whatever it is.
    ///
    /// # Errors
    /// As [`score`](Self::score).
    pub fn by_chance(&self, evidence: &[f64]) -> Result<ScoreTail, EngineError> {
        self.check(evidence)?;
        let term = |(bias, c): (&Bias, &f64)| {
            let [plus, minus] = bias.symbols();
            TwoValued { high: c * plus, low: c * minus, probability: bias.probability() }
        };
        Ok(ScoreTail::new(self.biases.iter().zip(evidence).map(term).collect()))
    }

    fn check(&self, evidence: &[f64]) -> Result<(), EngineError> {
        if evidence.len() == self.biases.len() {
            return Ok(());
        }
        Err(EngineError::Usage {
            what: "evidence".to_owned(),
            got: format!("{} numbers", evidence.len()),
            expected: format!("one for each of {} positions", self.biases.len()),
        })
    }
}
