//! Random numbers that are the same in every run.

use std::time::Duration;

/// SplitMix64 of Steele, Lea and Flood 2014.
pub(super) struct Random(u64);

impl Random {
    pub(super) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// From 0, and below 1.
    pub(super) fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1_u64 << 24) as f32
    }

    /// Between two numbers.
    pub(super) fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// A moment before the end of something.
    pub(super) fn moment(&mut self, end: Duration) -> Duration {
        end.mul_f32(self.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_spread_and_come_again() {
        let drawn = || {
            let mut random = Random::new(26);
            (0..1000).map(|_| random.between(2.0, 4.0)).collect::<Vec<f32>>()
        };
        let numbers = drawn();
        assert_eq!(numbers, drawn(), "the same seed");
        assert!(numbers.iter().all(|x| (2.0..4.0).contains(x)), "all are between");
        let mean = numbers.iter().sum::<f32>() / 1000.0;
        assert!((mean - 3.0).abs() < 0.1, "{mean}");
    }
}
