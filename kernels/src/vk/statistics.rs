//! What a driver's compiler makes of every kernel. Nothing runs, so a driver without its hardware can be asked, too.

use ash::{khr, vk};

use super::family::{FamilySelect, KernelFamily};
use super::info::DeviceInfo;
use super::instance::{Instance, Uses};
use super::pipeline::{self, KernelDef, Program};
use super::result::check;
use super::select::DeviceSelect;
use crate::error::KernelError;
use crate::registry;

/// What became of one kernel, with the specialisation constants that its shader names by itself.
#[derive(Clone, Debug, PartialEq)]
pub struct ProgramStatistics {
    /// `family/stem`.
    pub kernel: &'static str,
    /// Invocations in a subgroup.
    pub subgroup_size: u32,
    /// Numbers by the driver's own names, in its order.
    pub numbers: Vec<(String, f64)>,
}

/// What was asked, and what it said.
#[derive(Clone, Debug)]
pub struct DriverStatistics {
    /// The device.
    pub device: DeviceInfo,
    /// Which of a kernel's programs were compiled.
    pub family: KernelFamily,
    /// All kernels that the device can come to run, by name.
    pub programs: Vec<ProgramStatistics>,
}

/// Compiles every kernel that the device can come to run, and asks the driver about the result
/// (VK_KHR_pipeline_executable_properties).
///
/// # Errors
/// [`KernelError::NoDriver`], [`KernelError::NoDevice`]; [`KernelError::Unsuitable`] for a driver that does not tell;
/// when a kernel does not compile.
pub fn statistics(select: &DeviceSelect, kernels: FamilySelect) -> Result<DriverStatistics, KernelError> {
    let instance = Instance::new(true)?;
    let (physical, info) = instance.choose(select)?;
    let family = kernels.choose(&info)?;
    let raw = instance.create_device(physical, &info, instance.compute_family(physical, &info)?, Uses::Statistics)?;
    let loader = khr::pipeline_executable_properties::Device::new(&instance.raw, &raw);
    let known = registry::ALL.iter().filter(|kernel| kernel.runs_on(family, &info));
    let programs: Result<_, _> = known.map(|kernel| of_kernel(&raw, &loader, family, kernel)).collect();
    // SAFETY: all that was made on the device is destroyed, and nothing was submitted.
    unsafe { raw.destroy_device(None) };
    Ok(DriverStatistics { device: info, family, programs: programs? })
}

fn of_kernel(
    device: &ash::Device,
    loader: &khr::pipeline_executable_properties::Device,
    family: KernelFamily,
    kernel: &'static KernelDef,
) -> Result<ProgramStatistics, KernelError> {
    let program = Program { family, kernel, spec: &[] };
    let flags = vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR;
    let pipeline = pipeline::create(device, program, flags, vk::PipelineCache::null())?;
    // A compute pipeline is one executable.
    let of = vk::PipelineExecutableInfoKHR::default().pipeline(pipeline.handle).executable_index(0);
    // SAFETY: the extension is enabled, and the pipeline was made to be asked.
    let told = unsafe {
        let properties =
            loader.get_pipeline_executable_properties(&vk::PipelineInfoKHR::default().pipeline(pipeline.handle));
        let numbers = loader.get_pipeline_executable_statistics(&of);
        pipeline.destroy(device);
        check("vkGetPipelineExecutablePropertiesKHR", properties)
            .and_then(|properties| Ok((properties, check("vkGetPipelineExecutableStatisticsKHR", numbers)?)))
    };
    let (properties, numbers) = told?;
    let number = |statistic: &vk::PipelineExecutableStatisticKHR<'_>| {
        let name = statistic.name_as_c_str().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        (name, value(statistic))
    };
    Ok(ProgramStatistics {
        kernel: kernel.name,
        subgroup_size: properties.first().map_or(0, |executable| executable.subgroup_size),
        numbers: numbers.iter().map(number).collect(),
    })
}

#[allow(clippy::cast_precision_loss, reason = "counts of registers, bytes and instructions")]
fn value(statistic: &vk::PipelineExecutableStatisticKHR<'_>) -> f64 {
    use vk::PipelineExecutableStatisticFormatKHR as Format;
    // SAFETY: the format says which member of the union the driver wrote.
    unsafe {
        match statistic.format {
            Format::BOOL32 => f64::from(statistic.value.b32),
            Format::INT64 => statistic.value.i64 as f64,
            Format::FLOAT64 => statistic.value.f64,
            _ => statistic.value.u64 as f64,
        }
    }
}
