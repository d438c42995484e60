//! The passes of a step that are the same in every step, recorded once: everything from the clips as R shows them, through
//! tower, decoder and losses, back to the gradient of the marked clip and of R's weights. What comes before and after takes
//! plans, noise, rates and step counts that change.

use std::time::Duration;

use guard4d_kernels::{Device, KernelError, Recorder, Section};

use super::config::EmbedConfig;
use super::step::{Critic, Rates};
use super::terms::Control;
use crate::watermark::extractor::Training;

/// How those passes come to the device. The results are the same to the bit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Repetition {
    /// From a recording, as long as what they depend on stays.
    #[default]
    Replayed,
    /// Recorded in every step.
    RecordedAnew,
}

/// What they depend on, beside the buffers and weights that the critic owns.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Constants {
    recomputes: bool,
    training: Training,
    control: Control,
    lambda_msg: f32,
    lambda_control: f32,
    control_every: u32,
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
}

impl Critic {
    /// Records the repeated passes, or replays them.
    pub(super) fn read_and_return(
        &mut self,
        rec: &mut Recorder,
        device: &Device,
        config: &EmbedConfig,
        rates: Rates,
    ) -> Result<(), KernelError> {
        if self.repeated.how == Repetition::RecordedAnew {
            return self.record_repeated(rec, config, rates);
        }
        let constants = Constants {
            recomputes: self.features.recomputes(),
            training: self.training_in(rates),
            control: config.control,
            lambda_msg: config.lambda_msg,
            lambda_control: config.lambda_control,
            control_every: config.control_every,
        };
        let index = self.pass_index(rates);
        let known = self.repeated.sections[index].take().filter(|(of, _)| *of == constants);
        let section = match known {
            Some((_, section)) => section,
            None => device.section(|rec| self.record_repeated(rec, config, rates))?,
        };
        rec.replay(&section)?;
        self.repeated.sections[index] = Some((constants, section));
        Ok(())
    }

    fn record_repeated(&mut self, rec: &mut Recorder, config: &EmbedConfig, rates: Rates) -> Result<(), KernelError> {
        self.features.read(rec)?;
        let (training, pass) = (self.training_in(rates), self.pass_index(rates));
        self.decoder.forward(rec, self.features.features(), &mut self.passes[pass])?;
        self.message_losses(rec, config, rates)?;
        let pass = &mut self.passes[pass];
        self.decoder.backward(rec, pass)?;
        self.features.backward(rec, &pass.v_features, training)
    }
}
