//! Device times of what ran.

use std::time::Duration;

/// Device time of one pass.
#[derive(Clone, Debug)]
pub struct PassTime {
    /// Kernel name `family/stem`, or `copy` / `fill`.
    pub name: &'static str,
    /// The part of the work that it was recorded in, by [`Recorder::part`](crate::Recorder::part); `None` outside any.
    pub part: Option<&'static str>,
    /// Device time.
    pub time: Duration,
}

/// Device time of a submission, pass by pass.
#[derive(Clone, Debug, Default)]
pub struct Timings {
    /// Passes in order of execution.
    pub passes: Vec<PassTime>,
}

impl Timings {
    /// Sum over all passes.
    #[must_use]
    pub fn total(&self) -> Duration {
        self.passes.iter().map(|p| p.time).sum()
    }

    /// Sum over the passes of one kernel.
    #[must_use]
    pub fn of(&self, name: &str) -> Duration {
        self.passes.iter().filter(|p| p.name == name).map(|p| p.time).sum()
    }

    /// Sum over the passes of one part; `None` for those outside any.
    #[must_use]
    pub fn of_part(&self, part: Option<&str>) -> Duration {
        self.passes.iter().filter(|p| p.part == part).map(|p| p.time).sum()
    }
}

/// The last of `passes` that finished, by the availability words of the timestamps: one from before the first pass,
/// then one from after each pass that is timed. Passes run in order, so the first word that is zero ends the search.
#[must_use]
pub fn last_finished(available: &[u64], passes: &[&str]) -> String {
    let timed = available.len().saturating_sub(1);
    let finished = available.iter().skip(1).take_while(|word| **word != 0).count();
    let Some(name) = finished.checked_sub(1).and_then(|last| passes.get(last)) else { return "none".to_owned() };
    let place = format!("`{name}`, pass {finished} of {}", passes.len());
    if finished == timed && timed < passes.len() {
        return format!("{place}, or one after it: later passes have no timestamp");
    }
    place
}
