//! How many rows share a device, where nobody said: as many as measures faster, and as its memory holds.

use std::collections::BTreeMap;
use std::thread::available_parallelism;

use super::manifest::Row;

/// Most rows that are tried at once. A device that four of them leave idle waits for something else.
const MOST: usize = 4;
/// How much faster one row more has to be before another one is tried. Less than that is noise.
const FASTER: f64 = 0.97;

/// Memory of the device that rows are done on, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceMemory {
    /// What the driver would still give.
    pub free: u64,
    /// What rows hold of it between them now.
    pub held: u64,
    /// The most that one row held.
    pub row_peak: u64,
}

/// What rows took, by how many of them were done at once.
#[derive(Debug, Default)]
pub(super) struct Crowd {
    /// By job; the first is of rows that were done alone.
    paces: BTreeMap<String, Vec<Pace>>,
}

/// Costs of the manifest and the seconds that they took.
#[derive(Clone, Copy, Debug, Default)]
struct Pace {
    seconds: f64,
    cost: f64,
}

impl Pace {
    /// Seconds of a cost of one; `None` before anything was measured.
    fn rate(&self) -> Option<f64> {
        (self.cost > 0.0).then(|| self.seconds / self.cost)
    }
}

impl Crowd {
    /// Learns what rows of one job took together.
    pub(super) fn learn(&mut self, rows: &[&Row], seconds: f64) {
        let Some(first) = rows.first() else { return };
        let paces = self.paces.entry(first.job.clone()).or_default();
        paces.resize(paces.len().max(rows.len()), Pace::default());
        let pace = &mut paces[rows.len() - 1];
        pace.seconds += seconds;
        pace.cost += rows.iter().map(|row| row.cost).sum::<f64>();
    }

    /// How many rows of a job to do at once: one, until that is measured and the memory of the device is known.
    pub(super) fn most(&self, job: &str, memory: Option<DeviceMemory>) -> usize {
        let (Some(memory), Some(paces)) = (memory, self.paces.get(job)) else { return 1 };
        let held = (memory.free + memory.held).checked_div(memory.row_peak).unwrap_or(u64::MAX);
        let processors = available_parallelism().map_or(1, usize::from);
        let most = processors.min(MOST).min(usize::try_from(held).unwrap_or(MOST)).max(1);
        fastest(&paces.iter().map(Pace::rate).collect::<Vec<_>>(), most)
    }
}

/// The number of rows at once, up to `most`, whose rate is the lowest; the first one that was not tried yet, if each
/// number below it was faster than the one before.
fn fastest(rates: &[Option<f64>], most: usize) -> usize {
    let Some(Some(mut best)) = rates.first().copied() else { return 1 };
    for at_once in 2..=most {
        match rates.get(at_once - 1).copied().flatten() {
            None => return at_once,
            Some(rate) if rate < best * FASTER => best = rate,
            Some(_) => return at_once - 1,
        }
    }
    most
}

#[cfg(test)]
mod tests {
    use super::fastest;

    #[test]
    fn one_more_is_tried_as_long_as_it_is_faster() {
        assert_eq!(fastest(&[], 4), 1, "nothing is known");
        assert_eq!(fastest(&[None, Some(1.0)], 4), 1, "of rows alone nothing is known");
        assert_eq!(fastest(&[Some(10.0)], 4), 2);
        assert_eq!(fastest(&[Some(10.0)], 1), 1, "memory for one");
        assert_eq!(fastest(&[Some(10.0), Some(8.0)], 4), 3);
        assert_eq!(fastest(&[Some(10.0), Some(8.0)], 2), 2);
        assert_eq!(fastest(&[Some(10.0), Some(9.9)], 4), 1, "no faster but for noise");
        assert_eq!(fastest(&[Some(10.0), Some(8.0), Some(9.0)], 4), 2);
        assert_eq!(fastest(&[Some(10.0), Some(8.0), Some(7.0), Some(6.0)], 4), 4);
    }
}
