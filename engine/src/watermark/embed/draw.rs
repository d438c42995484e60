//! What steps draw.

use std::ops::Range;

use rand_chacha::ChaCha20Rng;

use crate::base::prf::{Purpose, uniform_below, uniform_unit};
use crate::watermark::key::owner_key::Key;

/// Most clips among which a step draws.
const WINDOW: usize = 96;

/// Of so many clips, those among which this one of so many steps draws: the one whose turn it is where there is one for
/// each step, and else a window. It goes over all of them once, so that each is made once and let go: what a mark has
/// to learn is many views, and few of them have room in memory.
pub(super) fn window(step: usize, steps: usize, clips: usize) -> Range<usize> {
    let width = if clips >= steps { 1 } else { clips.min(WINDOW) };
    let last = steps.saturating_sub(1).max(1);
    let first = (clips - width) * step.min(last) / last;
    first..first + width
}

/// The clip that a step is taken on, by its number, and the stream of all else that the step draws.
pub(super) fn draw(key: &Key, seed: u64, step: usize, among: Range<usize>) -> (usize, ChaCha20Rng) {
    let mut rng = key.prf().stream(Purpose::Embedding, stream_index(seed, step));
    let index = uniform_below(&mut rng, u32::try_from(among.len()).unwrap_or(u32::MAX));
    (among.start + index as usize, rng)
}

/// Every step has a random stream of its own, so that a resumed run draws what an unbroken one would.
fn stream_index(seed: u64, step: usize) -> u64 {
    (seed << 32) | step as u64
}

/// From 0 to 1.
#[allow(clippy::cast_possible_truncation, reason = "a factor between 0 and 1")]
pub(super) fn unit(rng: &mut ChaCha20Rng) -> f32 {
    uniform_unit(rng) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_go_over_all_clips_once() {
        for (steps, clips) in [(700, 432), (900, 144), (97, 96), (500, 97)] {
            let of = |step| window(step, steps, clips);
            assert_eq!((of(0).start, of(steps - 1).end), (0, clips), "from the first to the last");
            for step in 1..steps {
                let (before, now) = (of(step - 1), of(step));
                assert_eq!(now.len(), clips.min(WINDOW));
                assert!(now.start >= before.start && now.start - before.start <= 1, "{before:?}, {now:?}");
            }
        }
    }

    #[test]
    fn steps_have_a_clip_each_where_there_are_as_many() {
        for (steps, clips) in [(360, 360), (96, 96), (3, 6), (1, 4), (1, 1), (200, 540)] {
            let seen: Vec<usize> = (0..steps).map(|step| window(step, steps, clips)).map(|w| w.start).collect();
            assert!((0..steps).all(|step| window(step, steps, clips).len() == 1));
            assert!(seen.windows(2).all(|pair| pair[0] < pair[1]), "none twice: {seen:?}");
            assert!(seen.iter().all(|clip| *clip < clips), "{seen:?}");
        }
    }

    #[test]
    fn few_clips_are_all_drawn_from() {
        assert_eq!(window(0, 900, 4), 0..4);
        assert_eq!(window(899, 900, 4), 0..4);
        assert_eq!(window(5000, 900, 144), 48..144, "steps beyond the last stay there");
    }
}
