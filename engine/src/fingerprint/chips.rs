//! Chips: what has one sign in a copy, at several scales.
//!
//! Small chips are many and say most where a film is good; large ones outlive a codec, a smaller picture and cameras
//! that are a little off. A splat belongs to one chip of each octave, and its offset is the sum of theirs.

use std::collections::HashMap;

use crate::scene::Gaussians;

/// A scale of chips.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Octave {
    /// Cells along the longest extent of the canonical positions; `None` for a chip of each splat's own.
    pub cells: Option<u32>,
    /// How far a chip moves a colour, in units of 1, as a plain sign would.
    pub amplitude: f64,
}

/// The octaves that copies are stamped with: each splat, and two grids. Those of a first measurement on films
/// through H.264 (robot and biker, 8 frames): 49 to 52 dB.
pub const OCTAVES: [Octave; 3] = [
    Octave { cells: None, amplitude: 0.012 },
    Octave { cells: Some(48), amplitude: 0.008 },
    Octave { cells: Some(24), amplitude: 0.006 },
];

/// Percent of the positions that are left out of the extent on either side: a few splats far away would make all of the
/// asset one cell.
const LEFT_OUT: usize = 1;

/// The chips of an asset, counted through all octaves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChipMap {
    /// For each splat its chip of each octave.
    of_splat: Vec<[usize; OCTAVES.len()]>,
    num_chips: usize,
}

impl ChipMap {
    /// The chips of these splats, which follow from their canonical positions alone.
    #[must_use]
    pub fn new(gaussians: &Gaussians) -> Self {
        let mut of_splat = vec![[0; OCTAVES.len()]; gaussians.len()];
        let (low, longest) = extent(&gaussians.means);
        let mut num_chips = 0;
        for (o, octave) in OCTAVES.iter().enumerate() {
            let Some(cells) = octave.cells else {
                of_splat.iter_mut().enumerate().for_each(|(splat, chips)| chips[o] = num_chips + splat);
                num_chips += gaussians.len();
                continue;
            };
            let side = longest / f64::from(cells);
            // In the order in which splats come, so that the same file has the same chips everywhere.
            let mut known: HashMap<[u64; 3], usize> = HashMap::new();
            for (chips, mean) in of_splat.iter_mut().zip(&gaussians.means) {
                let next = num_chips + known.len();
                chips[o] = *known.entry(cell(*mean, low, side)).or_insert(next);
            }
            num_chips += known.len();
        }
        Self { of_splat, num_chips }
    }

    /// How many chips there are.
    #[must_use]
    pub fn num_chips(&self) -> usize {
        self.num_chips
    }

    /// For each splat its chip of each of [`OCTAVES`].
    #[must_use]
    pub fn of_splats(&self) -> &[[usize; OCTAVES.len()]] {
        &self.of_splat
    }
}

/// The lower corner of most positions, and the longest side of what they fill; a side of 1 where they fill none.
fn extent(means: &[[f32; 3]]) -> ([f64; 3], f64) {
    let (mut low, mut longest) = ([0.0; 3], 0.0f64);
    for (axis, low) in low.iter_mut().enumerate() {
        let mut along: Vec<f32> = means.iter().map(|mean| mean[axis]).filter(|x| x.is_finite()).collect();
        along.sort_by(f32::total_cmp);
        let Some(last) = along.len().checked_sub(1) else { continue };
        let at = |percent: usize| f64::from(along[last * percent / 100]);
        *low = at(LEFT_OUT);
        longest = longest.max(at(100 - LEFT_OUT) - *low);
    }
    (low, if longest > 0.0 { longest } else { 1.0 })
}

/// The cell of a position, by the bits of its number along each axis; what lies nowhere has one of its own.
fn cell(mean: [f32; 3], low: [f64; 3], side: f64) -> [u64; 3] {
    // Zero of either sign is one number.
    std::array::from_fn(|axis| (((f64::from(mean[axis]) - low[axis]) / side).floor() + 0.0).to_bits())
}
