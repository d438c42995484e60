//! The passes of a step that are the same in every step, recorded once: everything from the clips as R shows them,
//! through tower, decoder and losses, back to the gradient of the marked clip and of R's weights. What comes before and
//! after takes plans, noise, rates and step counts that change.

use std::time::Duration;

use guard4d_kernels::{Device, KernelError, Recorder, Section};

use super::config::Control;
use crate::watermark::extractor::features::Training;

/// How those passes come to the device. The results are the same to the bit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Repetition {
    /// From a recording, as long as what they depend on stays.
    #[default]
    Replayed,
    /// Recorded in every step.
    RecordedAnew,
}

/// What they depend on, beside buffers and weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Constants {
    /// Which of the decoder's passes they go through.
    pub(super) pass: usize,
    pub(super) recomputes: bool,
    pub(super) training: Training,
    /// The control loss, where there is one.
    pub(super) control: Option<Control>,
    pub(super) lambda_msg: f32,
    pub(super) lambda_control: f32,
    pub(super) control_every: u32,
}

/// Recordings, one for each number of clips that a step reads, and what recording takes.
#[derive(Default)]
pub(super) struct Repeated {
    pub(super) how: Repetition,
    /// Host time of recording the last step.
    pub(super) last_step: Duration,
    sections: [Option<(Constants, Section)>; 2],
}

impl Repeated {
    /// Lets go of the recordings, and so of the buffers that they keep alive.
    pub(super) fn forget(&mut self) {
        self.sections = Default::default();
    }

    /// Records the repeated passes, or replays them.
    pub(super) fn play(
        &mut self,
        rec: &mut Recorder,
        device: &Device,
        constants: Constants,
        mut record: impl FnMut(&mut Recorder) -> Result<(), KernelError>,
    ) -> Result<(), KernelError> {
        if self.how == Repetition::RecordedAnew {
            return record(rec);
        }
        let slot = &mut self.sections[constants.pass];
        let section = match slot.take().filter(|(of, _)| *of == constants) {
            Some((_, section)) => section,
            None => device.section(record)?,
        };
        rec.replay(&section)?;
        *slot = Some((constants, section));
        Ok(())
    }
}
