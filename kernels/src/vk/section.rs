//! Passes that are recorded once and run as part of many submissions.

use std::collections::HashMap;
use std::sync::Arc;

use ash::vk;

use super::check;
use super::device::Device;
use super::recorder::{Bound, Pass, Recorder, Slot};
use crate::error::KernelError;

/// Recorded passes, to be run by [`Recorder::replay`]; clones are the same recording.
///
/// It keeps every buffer that its passes touch alive, so it belongs with the code that owns them: a recording does not
/// follow when they are replaced.
#[derive(Clone)]
pub struct Section {
    inner: Arc<Recorded>,
}

struct Recorded {
    /// A secondary command buffer that has been ended, with all that it needs.
    recorder: Recorder,
    /// Each buffer once, written if any pass writes it.
    touched: Vec<Bound>,
}

impl Device {
    /// Records passes to be replayed. None of them runs yet.
    ///
    /// # Errors
    /// Those of `record`; [`KernelError::Shape`] when it leaves another recorder in place of its own; when the device
    /// refuses a command buffer.
    pub fn section<E: From<KernelError>>(
        &self,
        record: impl FnOnce(&mut Recorder) -> Result<(), E>,
    ) -> Result<Section, E> {
        let slot = Slot::new(self.inner(), vk::CommandBufferLevel::SECONDARY)?;
        let mut recorder = Recorder::begin(self.inner(), slot)?;
        record(&mut recorder)?;
        recorder.expect_level(vk::CommandBufferLevel::SECONDARY)?;
        recorder.end()?;
        let mut touched = HashMap::<vk::Buffer, Bound>::new();
        for bound in recorder.bounds.drain(..) {
            let writes = bound.writes;
            touched.entry(bound.buffer.handle).or_insert(bound).writes |= writes;
        }
        let touched = touched.into_values().collect();
        Ok(Section { inner: Arc::new(Recorded { recorder, touched }) })
    }
}

impl Section {
    pub(super) fn recorder(&self) -> &Recorder {
        &self.inner.recorder
    }
}

impl Recorder {
    /// Runs the passes of a section here, as if they had been recorded here; to passes before and after it is one pass
    /// that touches all that they touch. A section that runs twice in one submission reports the times of its last run
    /// for both.
    ///
    /// Recorders of two threads that replay one section are for the caller to order, as any that write one buffer.
    ///
    /// # Errors
    /// [`KernelError::Shape`] in the recording of a section, which holds no other, and for a section of another device.
    pub fn replay(&mut self, section: &Section) -> Result<(), KernelError> {
        self.expect_level(vk::CommandBufferLevel::PRIMARY)?;
        let theirs = section.recorder();
        if !Arc::ptr_eq(&self.device, &theirs.device) {
            return Err(misused("a section of another device", "one of the recorder's"));
        }
        self.synchronise(&section.inner.touched);
        let (own, slot) = (self.slot().commands, theirs.slot());
        let queries = u32::try_from(theirs.timed() + 1).expect("no more than there are queries");
        // SAFETY: recording is open, and `slot` holds commands that were ended and may run any number of times. The
        // section is kept alive until the fence by the pass below.
        unsafe {
            self.device.raw.cmd_reset_query_pool(own, slot.queries, 0, queries);
            self.device.raw.cmd_execute_commands(own, &[slot.commands]);
        }
        self.end_pass(Pass::Section(section.clone()));
        Ok(())
    }

    fn end(&self) -> Result<(), KernelError> {
        // SAFETY: recording is open; what was recorded is kept alive by `self`.
        check("vkEndCommandBuffer", unsafe { self.device.raw.end_command_buffer(self.slot().commands) })
    }

    /// Refuses what the recorder's command buffer cannot do: a section's is not submitted and runs no other.
    pub(super) fn expect_level(&self, level: vk::CommandBufferLevel) -> Result<(), KernelError> {
        match (self.slot().level, level) {
            (got, expected) if got == expected => Ok(()),
            (vk::CommandBufferLevel::SECONDARY, _) => Err(misused("that of a section", "one of its own")),
            _ => Err(misused("one of its own", "that of a section")),
        }
    }
}

fn misused(got: &str, expected: &str) -> KernelError {
    KernelError::Shape { kernel: "section", buffer: "recorder", got: got.to_owned(), expected: expected.to_owned() }
}
