//! Cooperative matrices: whether a device has the kind that the `_coop` kernels are written for, and when they run.

use ash::vk;

// `SHARED_BYTES`, the workgroup memory that the `_coop` kernels take at most, as the build script holds them to it.
include!(concat!(env!("OUT_DIR"), "/coop_shared_bytes.rs"));

/// Rows and columns of the tile of one workgroup: `TILE` of the `_coop` shaders.
pub(crate) const TILE: u32 = 64;
/// Invocations of a workgroup: `GROUP` of the `_coop` shaders.
const GROUP: u32 = 128;
/// Elements of K that lie in workgroup memory at a time: `DEPTH` of the `_coop` shaders.
const DEPTH: u32 = 32;
/// Elements of the results that do so: `PATCH` of the `_coop` shaders.
const PATCH: u32 = 1024;

/// The matrices that a subgroup multiplies: f16 `[m, k]` by f16 `[k, n]`, added to f32 `[m, n]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cooperation {
    /// Rows of the result.
    pub m: u32,
    /// Columns of the result.
    pub n: u32,
    /// Terms of each of its sums.
    pub k: u32,
    /// Subgroups in one workgroup of the `_coop` shaders.
    pub subgroups: u32,
    /// How many of them divide the rows of a tile among them; the others divide its columns.
    pub row_blocks: u32,
}

impl Cooperation {
    /// How subgroups of this size share a tile in matrices of this shape, if they can.
    #[must_use]
    pub fn new([m, n, k]: [u32; 3], subgroup_size: u32) -> Option<Self> {
        let divides = |part: u32, whole: u32| part > 0 && whole.is_multiple_of(part);
        let fits = divides(m, TILE) && divides(n, TILE) && divides(k, DEPTH) && divides(subgroup_size, GROUP);
        if !fits || !divides(4, n) || !divides(4, k) {
            return None;
        }
        let subgroups = GROUP / subgroup_size;
        if subgroups * m * n > PATCH {
            return None;
        }
        // The squarer a subgroup's block, the fewer loads per product.
        let shares = |r: &u32| divides(*r, subgroups) && divides(*r, TILE / m) && divides(subgroups / *r, TILE / n);
        let row_blocks = (1..=subgroups).filter(shares).min_by_key(|r| (TILE / r).abs_diff(TILE / (subgroups / r)))?;
        Some(Self { m, n, k, subgroups, row_blocks })
    }
}

/// What a device with the extension has of use for the `_coop` kernels. `None` where it lacks what else these need:
/// 16-bit floats in arithmetic, the Vulkan memory model, and their workgroup memory.
pub(super) fn of_device(
    entry: &ash::Entry,
    instance: &ash::Instance,
    device: vk::PhysicalDevice,
    subgroup_size: u32,
) -> Option<Cooperation> {
    // A compiler that does not know the extension leaves nothing to run.
    if cfg!(without_cooperative_matrices) {
        return None;
    }
    let mut matrices = vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default();
    let mut core = vk::PhysicalDeviceVulkan12Features::default();
    let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut matrices).push_next(&mut core);
    let mut stages = vk::PhysicalDeviceCooperativeMatrixPropertiesKHR::default();
    let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut stages);
    // SAFETY: the chains hold only structures of Vulkan 1.2 and of an extension of the device.
    unsafe {
        instance.get_physical_device_features2(device, &mut features);
        instance.get_physical_device_properties2(device, &mut properties);
    }
    let shared_bytes = properties.properties.limits.max_compute_shared_memory_size;
    // With that model other kernels' atomics, which name no scope, need its device scope.
    let model = [core.vulkan_memory_model, core.vulkan_memory_model_device_scope];
    let enough = shared_bytes >= SHARED_BYTES
        && [matrices.cooperative_matrix, core.shader_float16] == [vk::TRUE; 2]
        && model == [vk::TRUE; 2]
        && stages.cooperative_matrix_supported_stages.contains(vk::ShaderStageFlags::COMPUTE);
    if !enough {
        return None;
    }
    let loader = ash::khr::cooperative_matrix::Instance::new(entry, instance);
    // SAFETY: the device belongs to this instance and has the extension.
    let kinds = unsafe { loader.get_physical_device_cooperative_matrix_properties(device) }.unwrap_or_default();
    let (half, full) = (vk::ComponentTypeKHR::FLOAT16, vk::ComponentTypeKHR::FLOAT32);
    kinds
        .iter()
        .filter(|kind| [kind.a_type, kind.b_type, kind.c_type, kind.result_type] == [half, half, full, full])
        .filter(|kind| kind.scope == vk::ScopeKHR::SUBGROUP)
        .filter_map(|kind| Cooperation::new([kind.m_size, kind.n_size, kind.k_size], subgroup_size))
        .max_by_key(|shape| shape.m * shape.n * shape.k)
}
