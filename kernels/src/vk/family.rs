//! The two sets of kernels, and which of them a device runs.

use std::str::FromStr;

use super::info::{DeviceInfo, DeviceKind};
use crate::error::KernelError;

/// Lanes that the lane kernels need in one subgroup; their workgroups are this wide.
const MIN_SUBGROUP: u32 = 8;
/// Texels that a texel buffer must be able to hold for the lane kernels: 2 GiB of them, which lavapipe and all GPU
/// drivers grant. Less, such as the 65,536 that Vulkan promises, is no picture.
const MIN_TEXELS: u32 = 1 << 27;

/// A set of kernels. Every shader is compiled for both, with the same bindings, parameters and workgroups, so that a
/// host wrapper needs to know of it only where it has two programs to choose from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KernelFamily {
    /// Reads texel buffers and passes values through shuffles of eight lanes: the fastest way on processors, whose
    /// drivers run storage-buffer loads and barriers lane by lane.
    Lanes,
    /// Reads storage buffers and passes values through at most 16 KiB of workgroup memory, in workgroups of at most 128
    /// invocations: runs on every driver, and is what suits GPUs.
    Tiles,
}

impl std::fmt::Display for KernelFamily {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Lanes => "lanes",
            Self::Tiles => "tiles",
        })
    }
}

/// `auto`, `lanes` or `tiles`: which set of kernels a user asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FamilySelect {
    /// Lanes on processors that can run them, tiles on everything else.
    #[default]
    Auto,
    /// This one, or an error.
    Only(KernelFamily),
}

impl FromStr for FamilySelect {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "lanes" => Ok(Self::Only(KernelFamily::Lanes)),
            "tiles" => Ok(Self::Only(KernelFamily::Tiles)),
            _ => Err(format!("`{text}`: expected auto, lanes or tiles")),
        }
    }
}

impl std::fmt::Display for FamilySelect {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Only(family) => family.fmt(f),
        }
    }
}

impl FamilySelect {
    /// The kernels that this device would run.
    ///
    /// # Errors
    /// [`KernelError::Unsuitable`] when it cannot run those that were asked for.
    pub fn choose(self, device: &DeviceInfo) -> Result<KernelFamily, KernelError> {
        let lack = missing_for_lanes(device);
        match (self, lack) {
            (Self::Auto, None) if device.kind == DeviceKind::Cpu => Ok(KernelFamily::Lanes),
            (Self::Auto | Self::Only(KernelFamily::Tiles), _) => Ok(KernelFamily::Tiles),
            (Self::Only(KernelFamily::Lanes), None) => Ok(KernelFamily::Lanes),
            (Self::Only(KernelFamily::Lanes), Some(what)) => Err(KernelError::Unsuitable {
                device: device.name.clone(),
                what: format!("{what}, which the lane kernels need; `--kernels tiles` runs on it"),
            }),
        }
    }
}

/// What keeps a device from running the lane kernels.
fn missing_for_lanes(device: &DeviceInfo) -> Option<String> {
    if device.subgroup_size < MIN_SUBGROUP || !device.has_shuffles {
        return Some(format!(
            "subgroups of {MIN_SUBGROUP} or more lanes with shuffles in compute shaders (its subgroups have {})",
            device.subgroup_size
        ));
    }
    if device.max_texel_elements < MIN_TEXELS {
        return Some(format!("texel buffers of {MIN_TEXELS} texels (it has {})", device.max_texel_elements));
    }
    (!device.has_robust_loads).then(|| "loads that give zeros out of range (robustBufferAccess2)".to_owned())
}
