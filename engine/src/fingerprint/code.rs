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

/// What decides the chip of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Position {
    /// Each copy's own key, +1 with this bias.
    OfCopy(Bias),
    /// The key: whether it is +1 in every copy. Such chips say "a copy of this issue" however many were mixed.
    Shared(bool),
}

/// One position of so many is shared: its chips then score a quarter of what a copy's do.
const SHARED_ONE_OF: u32 = 16;

/// The positions of an asset: the same for all of its copies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Code {
    positions: Vec<Position>,
}

impl Code {
    /// Draws `positions` positions.
    ///
    /// # Determinism
    /// The same on every platform: whole numbers alone decide.
    #[must_use]
    pub fn draw(prf: &Prf, positions: usize) -> Self {
        let (mut biases, mut shared) = (prf.stream(Purpose::CodeBiases, 0), prf.stream(Purpose::SharedChips, 0));
        let node = |word: u32| match word {
            0..OUTER => Bias::NODES[0],
            word if word > u32::MAX - OUTER => Bias::NODES[2],
            _ => Bias::NODES[1],
        };
        let mut position = || {
            let (bias, word) = (node(biases.next_u32()), shared.next_u32());
            let is_shared = word.is_multiple_of(SHARED_ONE_OF);
            if is_shared { Position::Shared(word / SHARED_ONE_OF % 2 == 1) } else { Position::OfCopy(bias) }
        };
        Self { positions: (0..positions).map(|_| position()).collect() }
    }

    /// The positions of the owner's own chips, all of them shared by whatever copies there are. They follow from the
    /// original's hash, so that nobody can look for an original that fits a film.
    ///
    /// # Determinism
    /// As [`draw`](Self::draw): fair coins, bit by bit of `ChaCha8`.
    #[must_use]
    pub fn of_owner(prf: &Prf, original: Digest, positions: usize) -> Self {
        let seed = *prf.mac(Purpose::OwnerChips, original.as_bytes()).as_bytes();
        let mut rng = ChaCha8Rng::from_seed(seed);
        let mut word = 0;
        let position = |i: usize| {
            word = if i.is_multiple_of(32) { rng.next_u32() } else { word >> 1 };
            Position::Shared(word & 1 == 1)
        };
        Self { positions: (0..positions).map(position).collect() }
    }

    /// What decides each position's chip.
    #[must_use]
    pub fn positions(&self) -> &[Position] {
        &self.positions
    }

    /// The chips of a copy: whether each is +1.
    ///
    /// # Equation
    /// Position i has 16 bits of `ChaCha8` (Bernstein 2008) under the copy's key: the low half of word i/2 where i is
    /// even, else the high one. A chip of the copy's own is +1 where they lie below the bias.
    pub fn chips(&self, copy: &CopyKey) -> impl Iterator<Item = bool> {
        let mut rng = ChaCha8Rng::from_seed(copy.0);
        let mut word = 0;
        self.positions.iter().enumerate().map(move |(i, position)| {
            word = if i % 2 == 0 { rng.next_u32() } else { word >> 16 };
            match position {
                Position::OfCopy(bias) => word & 0xffff < u32::from(bias.0),
                Position::Shared(is_plus) => *is_plus,
            }
        })
    }

    /// How far each chip of a copy moves the colour, in units of its amplitude: see [`Bias::offsets`]; a shared one
    /// moves it by 1.
    pub fn offsets(&self, copy: &CopyKey) -> impl Iterator<Item = f64> {
        self.positions.iter().zip(self.chips(copy)).map(|(position, is_plus)| match position {
            Position::OfCopy(bias) => bias.offsets()[usize::from(!is_plus)],
            Position::Shared(_) => sign(is_plus),
        })
    }

    /// The score of a copy: how well its own chips agree with what was found at each position.
    ///
    /// # Equation
    /// S = Σ c u over the positions of copies, with the [symbols](Bias::symbols) u.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless there is one number for each position.
    pub fn score(&self, evidence: &[f64], copy: &CopyKey) -> Result<f64, EngineError> {
        self.check(evidence)?;
        let chips = self.positions.iter().zip(self.chips(copy)).zip(evidence);
        let term = |((position, is_plus), c): ((&Position, bool), &f64)| match position {
            Position::OfCopy(bias) => c * bias.symbols()[usize::from(!is_plus)],
            Position::Shared(_) => 0.0,
        };
        Ok(chips.map(term).sum())
    }

    /// How such scores are distributed for copies that have nothing to do with the evidence: exactly, whatever it is.
    ///
    /// # Errors
    /// As [`score`](Self::score).
    pub fn by_chance(&self, evidence: &[f64]) -> Result<ScoreTail, EngineError> {
        self.check(evidence)?;
        let term = |(position, c): (&Position, &f64)| match position {
            Position::OfCopy(bias) => {
                let [plus, minus] = bias.symbols();
                Some(TwoValued { high: c * plus, low: c * minus, probability: bias.probability() })
            }
            Position::Shared(_) => None,
        };
        Ok(ScoreTail::new(self.positions.iter().zip(evidence).filter_map(term).collect()))
    }

    /// The score of all copies together: how well the shared chips agree with what was found.
    ///
    /// # Equation
    /// S = Σ c x over the shared positions, x = ±1; by chance each x is a fair coin.
    ///
    /// # Errors
    /// As [`score`](Self::score).
    pub fn shared_score(&self, evidence: &[f64]) -> Result<SharedScore, EngineError> {
        self.check(evidence)?;
        let shared = self.positions.iter().zip(evidence).filter_map(|(position, c)| match position {
            Position::OfCopy(_) => None,
            Position::Shared(is_plus) => Some((sign(*is_plus) * c, *c)),
        });
        let (score, terms): (Vec<f64>, Vec<TwoValued>) =
            shared.map(|(signed, c)| (signed, TwoValued { high: c, low: -c, probability: 0.5 })).unzip();
        Ok(SharedScore { score: score.into_iter().sum(), chance: ScoreTail::new(terms) })
    }

    fn check(&self, evidence: &[f64]) -> Result<(), EngineError> {
        if evidence.len() == self.positions.len() {
            return Ok(());
        }
        Err(EngineError::Usage {
            what: "evidence".to_owned(),
            got: format!("{} numbers", evidence.len()),
            expected: format!("one for each of {} positions", self.positions.len()),
        })
    }
}

/// A score of the shared chips, and what it is compared with.
#[derive(Clone, Debug)]
pub struct SharedScore {
    /// The score.
    pub score: f64,
    /// How it is distributed for keys that have nothing to do with the evidence.
    pub chance: ScoreTail,
}

fn sign(is_plus: bool) -> f64 {
    if is_plus { 1.0 } else { -1.0 }
}
