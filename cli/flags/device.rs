//! Which device a command runs on, and how.

use bytesize::ByteSize;
use clap::Args;
use guard4d_engine::device::{DeviceSelect, FamilySelect};
use guard4d_engine::networks::clip::Precision;

/// Which device a command runs on, and how.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Device")]
pub(crate) struct DeviceFlags {
    /// Vulkan device: auto, cpu, a number of `guard4d devices`, name:…, uuid:… or pci:…
    ///
    /// `auto` takes the GPU that a scheduler assigned (CUDA_VISIBLE_DEVICES, ROCR_VISIBLE_DEVICES, HIP_VISIBLE_DEVICES,
    /// GPU_DEVICE_ORDINAL, SLURM_JOB_GPUS, CUE_GPU_CORES, PARALLEL_JOBSLOT: numbers in PCI order, or a UUID), else the
    /// only GPU, else the processor. `guard4d devices` marks the one that it takes.
    #[arg(long, global = true, default_value = "auto", env = "GUARD4D_DEVICE")]
    pub(crate) device: DeviceSelect,
    /// Kernels to run on it: auto, lanes (for processors) or tiles (for GPUs)
    ///
    /// `auto` takes lanes on a processor whose driver can run them, tiles elsewhere. tiles run everywhere. Both compute
    /// the same up to rounding.
    #[arg(long, global = true, default_value = "auto", env = "GUARD4D_KERNELS")]
    pub(crate) kernels: FamilySelect,
    /// How CLIP's image tower is kept: f32, or fixed16 or f16, which take half the memory
    ///
    /// fixed16 and f16 are faster, too. An element of a fixed16 row is off by at most 2⁻¹⁶ of the row's largest. f16 is
    /// for GPUs with cooperative matrices (`guard4d devices` says which): all factors of a product are off by up to
    /// 2⁻¹¹ of themselves. Keys do not depend on either.
    #[arg(long, global = true, default_value_t, value_name = "PRECISION")]
    pub(crate) precision: Precision,
    /// Most device memory to take, such as 512MiB or 4GB
    ///
    /// `embed` then keeps fewer clips at hand, to the same result.
    #[arg(long, global = true, value_name = "SIZE", env = "GUARD4D_VRAM_BUDGET")]
    pub(crate) vram_budget: Option<ByteSize>,
}
