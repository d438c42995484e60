//! Compute pipelines, one per kernel and set of specialisation constants, created on first use.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use ash::vk;

use super::family::KernelFamily;
use super::info::DeviceInfo;
use super::result::check;
use crate::error::KernelError;

/// What a shader declares, and so how a descriptor is bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BindingKind {
    /// Shader storage buffer.
    Storage,
    /// Texels of four floats: a storage texel buffer in the lane kernels, a storage buffer in the tile kernels.
    TexelF32,
    /// Texels of four unsigned integers, likewise.
    TexelU32,
}

impl BindingKind {
    pub(super) fn descriptor_type(self, family: KernelFamily) -> vk::DescriptorType {
        match (self, family) {
            (Self::Storage, _) | (_, KernelFamily::Tiles) => vk::DescriptorType::STORAGE_BUFFER,
            (Self::TexelF32 | Self::TexelU32, KernelFamily::Lanes) => vk::DescriptorType::STORAGE_TEXEL_BUFFER,
        }
    }
}

/// One reflected descriptor.
#[derive(Debug)]
pub struct BindingDef {
    /// Field name in the generated `Bind`.
    pub name: &'static str,
    /// Binding number in set 0.
    pub number: u32,
    /// How it is bound.
    pub kind: BindingKind,
}

/// One reflected kernel.
#[derive(Debug)]
pub struct KernelDef {
    /// `family/stem`.
    pub name: &'static str,
    /// SPIR-V bytes for devices that run lanes; none where only tiles have such a kernel.
    pub lanes: Option<&'static [u8]>,
    /// SPIR-V bytes for devices that run tiles; none where a wrapper takes another kernel there.
    pub tiles: Option<&'static [u8]>,
    /// Descriptors by binding number.
    pub bindings: &'static [BindingDef],
    /// Size of the push-constant block.
    pub params_bytes: u32,
    /// Ids of the specialisation constants, in the order of the generated `Spec`.
    pub spec_ids: &'static [u32],
    /// Workgroup size.
    pub local_size: [u32; 3],
    /// Whether it is written for cooperative matrices.
    pub is_coop: bool,
}

impl KernelDef {
    /// Its SPIR-V for devices of a family; `None` where they take another kernel.
    #[must_use]
    pub fn program(&self, family: KernelFamily) -> Option<&'static [u8]> {
        match family {
            KernelFamily::Lanes => self.lanes,
            KernelFamily::Tiles => self.tiles,
        }
    }

    /// Whether a device can come to run it.
    #[must_use]
    pub fn runs_on(&self, family: KernelFamily, device: &DeviceInfo) -> bool {
        self.program(family).is_some() && (!self.is_coop || device.cooperation.is_some())
    }

    fn spirv(&self, family: KernelFamily) -> &'static [u8] {
        self.program(family).expect("a wrapper asks the recorder's family where a kernel has a program for one only")
    }
}

pub(super) struct Pipeline {
    pub(super) handle: vk::Pipeline,
    pub(super) layout: vk::PipelineLayout,
    pub(super) set_layout: vk::DescriptorSetLayout,
}

/// Kernel name and bytes of its specialisation constants.
type Key = (&'static str, Vec<u8>);

/// The pipelines of one device.
pub(super) struct PipelineCache {
    family: KernelFamily,
    made: Mutex<HashMap<Key, Arc<Pipeline>>>,
    remembered: Mutex<Option<Remembered>>,
}

/// Takes what a driver remembers, when the device goes.
pub(super) type Keep = Box<dyn FnOnce(&[u8]) + Send>;

/// What a driver remembers of pipelines beyond this process.
struct Remembered {
    cache: vk::PipelineCache,
    keep: Keep,
}

impl PipelineCache {
    pub(super) fn new(family: KernelFamily) -> Self {
        Self { family, made: Mutex::default(), remembered: Mutex::default() }
    }

    /// Has the driver begin with what `keep` was given before. What it does not take for its own it leaves aside.
    pub(super) fn remember(&self, device: &ash::Device, known: &[u8], keep: Keep) -> Result<(), KernelError> {
        let info = vk::PipelineCacheCreateInfo::default().initial_data(known);
        // SAFETY: the data outlives the call, and says itself for which device it is.
        let cache = check("vkCreatePipelineCache", unsafe { device.create_pipeline_cache(&info, None) })?;
        let mut remembered = self.remembered.lock().expect("no panic happens while the cache is locked");
        if let Some(before) = remembered.replace(Remembered { cache, keep }) {
            // SAFETY: whoever makes a pipeline holds the lock.
            unsafe { device.destroy_pipeline_cache(before.cache, None) };
        }
        Ok(())
    }

    pub(super) fn get(
        &self,
        device: &ash::Device,
        kernel: &'static KernelDef,
        spec: &[u8],
    ) -> Result<Arc<Pipeline>, KernelError> {
        let mut made = self.made.lock().expect("no panic happens while the cache is locked");
        if let Some(pipeline) = made.get(&(kernel.name, spec.to_vec())) {
            return Ok(Arc::clone(pipeline));
        }
        let remembered = self.remembered.lock().expect("no panic happens while the cache is locked");
        let cache = remembered.as_ref().map_or(vk::PipelineCache::null(), |remembered| remembered.cache);
        let (flags, program) = (vk::PipelineCreateFlags::empty(), Program { family: self.family, kernel, spec });
        let pipeline = Arc::new(create(device, program, flags, cache)?);
        made.insert((kernel.name, spec.to_vec()), Arc::clone(&pipeline));
        Ok(pipeline)
    }

    /// Destroys every pipeline; called once, when the device goes. If some were made, what the driver remembers of them
    /// is kept.
    pub(super) fn destroy(&self, device: &ash::Device) {
        let remembered = self.remembered.lock().expect("no panic happens while the cache is locked").take();
        let mut made = self.made.lock().expect("no panic happens while the cache is locked");
        for (_, pipeline) in made.drain() {
            // SAFETY: the device is going down, so no recorder (each holds the device alive) can
            // still use these handles.
            unsafe { pipeline.destroy(device) };
        }
        if let Some(Remembered { cache, keep }) = remembered {
            // SAFETY: the cache is of this device, and nobody makes pipelines any more.
            let data = unsafe {
                let data = device.get_pipeline_cache_data(cache);
                device.destroy_pipeline_cache(cache, None);
                data
            };
            match data {
                Ok(data) => keep(&data),
                Err(code) => tracing::debug!("the driver does not tell what it remembers of pipelines: {code}"),
            }
        }
    }
}

/// A kernel as it is compiled.
#[derive(Clone, Copy)]
pub(super) struct Program<'a> {
    pub(super) family: KernelFamily,
    pub(super) kernel: &'static KernelDef,
    /// Bytes of its specialisation constants; without them they are what the shader says.
    pub(super) spec: &'a [u8],
}

impl Pipeline {
    /// Gives back what was made.
    ///
    /// # Safety
    /// It is of this device, nothing that uses it runs, and nobody uses it afterwards.
    pub(super) unsafe fn destroy(&self, device: &ash::Device) {
        // SAFETY: as the caller says.
        unsafe {
            device.destroy_pipeline(self.handle, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

/// Compiles a kernel, or takes from `cache` what was compiled before.
pub(super) fn create(
    device: &ash::Device,
    program: Program<'_>,
    flags: vk::PipelineCreateFlags,
    cache: vk::PipelineCache,
) -> Result<Pipeline, KernelError> {
    let Program { family, kernel, spec } = program;
    let bindings: Vec<_> = kernel
        .bindings
        .iter()
        .map(|b| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(b.number)
                .descriptor_type(b.kind.descriptor_type(family))
                .descriptor_count(1)
                .stage_flags(vk::ShaderStageFlags::COMPUTE)
        })
        .collect();
    let entries: Vec<_> = kernel
        .spec_ids
        .iter()
        .zip(0u32..)
        .filter(|_| !spec.is_empty())
        .map(|(&id, i)| vk::SpecializationMapEntry { constant_id: id, offset: i * 4, size: 4 })
        .collect();
    let specialization = vk::SpecializationInfo::default().map_entries(&entries).data(spec);
    let words: Vec<u32> = kernel.spirv(family).as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
    // SAFETY: the create infos live through each call; partially created objects leak only when
    // the device is already unusable.
    unsafe {
        let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        let set_layout = check("vkCreateDescriptorSetLayout", device.create_descriptor_set_layout(&info, None))?;
        let ranges =
            [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::COMPUTE).size(kernel.params_bytes)];
        let set_layouts = [set_layout];
        let mut info = vk::PipelineLayoutCreateInfo::default().set_layouts(&set_layouts);
        if kernel.params_bytes > 0 {
            info = info.push_constant_ranges(&ranges);
        }
        let layout = check("vkCreatePipelineLayout", device.create_pipeline_layout(&info, None))?;
        let info = vk::ShaderModuleCreateInfo::default().code(&words);
        let module = check("vkCreateShaderModule", device.create_shader_module(&info, None))?;
        let stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(module)
            .name(c"main")
            .specialization_info(&specialization);
        let info = [vk::ComputePipelineCreateInfo::default().flags(flags).stage(stage).layout(layout)];
        let made = device.create_compute_pipelines(cache, &info, None);
        device.destroy_shader_module(module, None);
        let handle = check("vkCreateComputePipelines", made.map_err(|(_, code)| code))?[0];
        Ok(Pipeline { handle, layout, set_layout })
    }
}
