//! The latest moments that were asked for.

use std::sync::Arc;

use super::state::SplatState;

/// Moments that are kept, the least recently used first.
#[derive(Debug, Default)]
pub(super) struct Latest(Vec<(f64, Arc<SplatState>)>);

impl Latest {
    /// The moment at exactly `time` if it is kept, which is the last to go from now on.
    pub(super) fn take_up(&mut self, time: f64) -> Option<Arc<SplatState>> {
        let found = self.0.iter().position(|(known, _)| known.to_bits() == time.to_bits())?;
        self.0[found..].rotate_left(1);
        self.0.last().map(|(_, state)| Arc::clone(state))
    }

    pub(super) fn push(&mut self, time: f64, state: &Arc<SplatState>) {
        self.0.push((time, Arc::clone(state)));
    }

    /// Drops the one that was asked for longest ago.
    pub(super) fn drop_first(&mut self) {
        self.0.remove(0);
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    pub(super) fn states(&self) -> impl Iterator<Item = &Arc<SplatState>> {
        self.0.iter().map(|(_, state)| state)
    }
}
