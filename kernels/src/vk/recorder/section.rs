//! Passes that are recorded once and run as part of many submissions.

use std::collections::HashMap;
use std::sync::Arc;

use ash::vk;

use super::bound::Bound;
use super::record::{Recorder, misused};
use super::recording::Recording;
use crate::error::KernelError;
use crate::vk::device::Device;
use crate::vk::result::check;
use crate::vk::slot::Slot;

/// Recorded passes, to be run by [`Recorder::replay`]; clones are the same recording.
///
/// It keeps every buffer that its passes touch alive, so it belongs with the code that owns them: a recording does not
/// follow when they are replaced.
#[derive(Clone)]
pub struct Section {
    /// A secondary command buffer that has been ended. Its `bounds` name each buffer once, written if any pass writes
    /// it.
    recording: Arc<Recording>,
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
        let slot = Slot::new(&self.inner().raw, self.inner().queue_family, vk::CommandBufferLevel::SECONDARY)?;
        let mut recorder = Recorder::begin(self.inner(), slot)?;
        record(&mut recorder)?;
        recorder.expect_level(vk::CommandBufferLevel::SECONDARY)?;
        let mut recording = recorder.recording;
        close(&recording)?;
        let mut touched = HashMap::<vk::Buffer, Bound>::new();
        for bound in recording.bounds.drain(..) {
            let writes = bound.writes;
            touched.entry(bound.buffer.handle).or_insert(bound).writes |= writes;
        }
        recording.bounds.extend(touched.into_values());
        Ok(Section { recording: Arc::new(recording) })
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
        let theirs = &section.recording;
        if !Arc::ptr_eq(&self.recording.device, &theirs.device) {
            return Err(misused("a section of another device", "one of the recorder's"));
        }
        self.synchronise(&theirs.bounds);
        let (own, slot) = (self.recording.slot().commands, theirs.slot());
        let queries = u32::try_from(theirs.timed() + 1).expect("no more than there are queries");
        // SAFETY: recording is open, and `slot` holds commands that were ended and may run any number of times. The
        // section is kept alive until the fence by the pass below.
        unsafe {
            self.recording.device.raw.cmd_reset_query_pool(own, slot.queries, 0, queries);
            self.recording.device.raw.cmd_execute_commands(own, &[slot.commands]);
        }
        self.end_section(theirs);
        Ok(())
    }
}

fn close(recording: &Recording) -> Result<(), KernelError> {
    // SAFETY: recording is open; what was recorded is kept alive by it.
    check("vkEndCommandBuffer", unsafe { recording.device.raw.end_command_buffer(recording.slot().commands) })
}
