//! The device that tests share, and the check that no validation message went unseen.

use std::ops::Deref;
use std::sync::OnceLock;

use guard4d_kernels::vk::{HostAccess, take_validation_errors};
use guard4d_kernels::{Device, DeviceOptions, DeviceSelect, FamilySelect, KernelFamily};

/// Derefs to the device; fails the test when it caused a validation error.
pub(crate) struct Gpu(Device);

impl Deref for Gpu {
    type Target = Device;
    fn deref(&self) -> &Device {
        &self.0
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        let errors = take_validation_errors();
        if !std::thread::panicking() {
            assert!(errors.is_empty(), "validation errors:\n{}", errors.join("\n"));
        }
    }
}

/// The shared device (`GUARD4D_DEVICE` selects another than the default, `GUARD4D_KERNELS` its kernels). `None`, with
/// the reason printed, without a driver; with `GUARD4D_REQUIRE_VULKAN` set that fails the test.
pub(crate) fn device() -> Option<Gpu> {
    static DEVICE: OnceLock<Result<Device, String>> = OnceLock::new();
    // What an earlier test on this thread left, before the device is opened: errors of opening it count.
    let _ = take_validation_errors();
    let opened = DEVICE.get_or_init(|| open(DeviceOptions::default()));
    let required = is_required();
    match opened {
        Ok(device) => {
            assert!(!required || device.is_validated(), "the Vulkan validation layers are missing");
            Some(Gpu(device.clone()))
        }
        Err(why) => {
            assert!(!required, "no Vulkan device: {why}");
            super::skipped(&format!("no Vulkan device: {why}"));
            None
        }
    }
}

/// The shared device without validation layers, for tests that train for minutes: other tests have the layers watch
/// what these do over and over. `None` as for [`device`].
pub(crate) fn unwatched_device() -> Option<Gpu> {
    static DEVICE: OnceLock<Device> = OnceLock::new();
    drop(device()?);
    let options = DeviceOptions { unwatched: true, ..DeviceOptions::default() };
    Some(Gpu(DEVICE.get_or_init(|| open(options).expect("it opened a moment ago")).clone()))
}

/// A device that no other test uses, for tests that look at the device itself. `None` as for [`device`].
pub(crate) fn own_device() -> Option<Gpu> {
    own(DeviceOptions::default())
}

/// The same with a device whose memory the host reaches as it would that of a card it cannot see into.
pub(crate) fn staged_device() -> Option<Gpu> {
    own(DeviceOptions { host_access: HostAccess::Staged, ..DeviceOptions::default() })
}

/// The same of a machine that has as many bytes free.
pub(crate) fn device_with_free(bytes: u64) -> Option<Gpu> {
    own(DeviceOptions { free_memory: Some(bytes), ..DeviceOptions::default() })
}

fn own(options: DeviceOptions) -> Option<Gpu> {
    drop(device()?);
    Some(Gpu(open(options).expect("it opened a moment ago")))
}

/// The shared device where validation layers watch it, for tests of the feature_stream. `None`, with the reason
/// printed, where none does.
pub(crate) fn watched_device() -> Option<Gpu> {
    let gpu = device()?;
    if !gpu.is_validated() {
        super::skipped("the Vulkan validation layers are missing");
        return None;
    }
    Some(gpu)
}

/// Whether a test that finds no device, or not all that it needs of one, has failed.
pub(crate) fn is_required() -> bool {
    std::env::var_os("GUARD4D_REQUIRE_VULKAN").is_some()
}

/// The device once for each kernel family. `None`, with the reason printed, without a driver or where the device runs
/// the tile kernels only.
pub(crate) fn each_family() -> Option<[Gpu; 2]> {
    each_family_with(DeviceOptions::default())
}

/// The same opened in some way.
pub(crate) fn each_family_with(options: DeviceOptions) -> Option<[Gpu; 2]> {
    drop(device()?);
    let open = |family| open_with(DeviceOptions { kernels: FamilySelect::Only(family), ..options });
    match open(KernelFamily::Lanes) {
        Ok(lanes) => Some([Gpu(lanes), Gpu(open(KernelFamily::Tiles).expect("every device runs the tile kernels"))]),
        Err(why) => {
            super::skipped(&why);
            None
        }
    }
}

/// The shared device where it has cooperative matrices for 16-bit floats. `None`, with the reason printed, where it
/// lacks them; with `GUARD4D_REQUIRE_F16` set that fails the test.
pub(crate) fn half_device() -> Option<Gpu> {
    let gpu = device()?;
    if let Err(why) = gpu.cooperation() {
        assert!(std::env::var_os("GUARD4D_REQUIRE_F16").is_none(), "{why}");
        super::skipped(&why.to_string());
        return None;
    }
    Some(gpu)
}

fn open(options: DeviceOptions) -> Result<Device, String> {
    let kernels: FamilySelect = std::env::var("GUARD4D_KERNELS").unwrap_or_else(|_| "auto".to_owned()).parse()?;
    open_with(DeviceOptions { kernels, ..options })
}

fn open_with(options: DeviceOptions) -> Result<Device, String> {
    let wanted = std::env::var("GUARD4D_DEVICE").unwrap_or_else(|_| "auto".to_owned());
    let select: DeviceSelect = wanted.parse()?;
    Device::open_with(&select, options).map_err(|e| e.to_string())
}
