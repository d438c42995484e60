//! GLSL to SPIR-V 1.5 behind one function; cargo feature `shaderc` swaps the compiler.

use crate::Unit;

/// Compiles one unit for Vulkan 1.2, keeping names for reflection.
#[cfg(not(feature = "shaderc"))]
pub(crate) fn to_spirv(unit: &Unit) -> Result<Vec<u32>, String> {
    use glslang::{
        Compiler, CompilerOptions, ShaderInput, ShaderMessage, ShaderSource, ShaderStage, SourceLanguage, SpirvVersion,
        Target, VulkanVersion,
    };
    let compiler = Compiler::acquire().ok_or("glslang does not initialise")?;
    let options = CompilerOptions {
        source_language: SourceLanguage::GLSL,
        target: Target::Vulkan { version: VulkanVersion::Vulkan1_2, spirv_version: SpirvVersion::SPIRV1_5 },
        version_profile: None,
        messages: ShaderMessage::DEFAULT,
    };
    let source = ShaderSource::from(unit.source.clone());
    let defines: Option<&[(&str, Option<&str>)]> = None;
    let input = ShaderInput::new(&source, ShaderStage::Compute, &options, defines, None).map_err(|e| e.to_string())?;
    let shader = compiler.create_shader(input).map_err(|e| e.to_string())?;
    shader.compile().map_err(|e| e.to_string())
}

/// The same through shaderc.
#[cfg(feature = "shaderc")]
pub(crate) fn to_spirv(unit: &Unit) -> Result<Vec<u32>, String> {
    let compiler = shaderc::Compiler::new().map_err(|e| e.to_string())?;
    let mut options = shaderc::CompileOptions::new().map_err(|e| e.to_string())?;
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_2 as u32);
    options.set_target_spirv(shaderc::SpirvVersion::V1_5);
    let name = format!("{}.comp", unit.name);
    compiler
        .compile_into_spirv(&unit.source, shaderc::ShaderKind::Compute, &name, "main", Some(&options))
        .map(|artifact| artifact.as_binary().to_vec())
        .map_err(|e| e.to_string())
}
