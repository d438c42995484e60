//! What fitting an extractor takes.

use guard4d_kernels::Device;

use super::buffers::TrainingBuffers;
use super::config::EmbedConfig;
use super::pool::ClipPool;
use crate::base::prf::Prf;

/// What fitting reads unmarked clips with, on the way to an extractor.
pub(super) struct FitContext<'a> {
    pub(super) device: &'a Device,
    pub(super) config: &'a EmbedConfig,
    pub(super) prf: &'a Prf,
    pub(super) pool: &'a mut ClipPool,
    /// Its offsets are zero before and after.
    pub(super) buffers: &'a mut TrainingBuffers,
}
