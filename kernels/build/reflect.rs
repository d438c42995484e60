//! Reads bindings, push constants, specialisation constants and local size out of SPIR-V.

use std::collections::HashMap;

use rspirv::dr::{Instruction, Module, Operand};
use rspirv::spirv::{Capability, Decoration, ExecutionMode, Op, StorageClass};

/// What the tile kernels may need: Vulkan grants every device this much workgroup memory and these many invocations.
const MAX_SHARED_BYTES: u32 = 16 << 10;
const MAX_INVOCATIONS: u32 = 128;
/// Workgroup memory that the kernels over cooperative matrices may need, which the host asks of a device.
pub(crate) const MAX_COOP_SHARED_BYTES: u32 = 32 << 10;
/// Bytes whose multiple the place of a cooperative load is.
const COOP_ALIGNMENT: u32 = 16;

/// Scalar type shared by host and shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    /// `float`
    F32,
    /// `uint`
    U32,
    /// `int`
    I32,
}

/// How a resource is bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Shader storage buffer.
    Storage,
    /// Storage texel buffer of four-component texels.
    Texel,
}

/// One descriptor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Binding {
    /// Host field name.
    pub name: String,
    /// Binding number.
    pub number: u32,
    /// How it is bound.
    pub kind: Kind,
    /// Element type on the host.
    pub scalar: Scalar,
    /// Whether the shader never writes it.
    pub readonly: bool,
}

/// Everything the host needs to know of one kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Kernel {
    /// `family/stem`.
    pub name: String,
    /// Descriptors by binding number.
    pub bindings: Vec<Binding>,
    /// Push constants in declaration order, all four bytes wide and tightly packed.
    pub params: Vec<(String, Scalar)>,
    /// Specialisation constants: id, host name, type, default bits.
    pub spec: Vec<(u32, String, Scalar, u32)>,
    /// Workgroup size.
    pub local_size: [u32; 3],
}

/// One module: what the host sees, and what it asks of a device.
pub(crate) struct Reflected {
    /// The interface.
    pub kernel: Kernel,
    /// Capabilities it declares.
    capabilities: Vec<Capability>,
    /// Bytes of each variable in its workgroup memory with the defaults of its specialisation constants.
    shared_bytes: Vec<u32>,
}

struct Reflection<'m> {
    module: &'m Module,
    names: HashMap<u32, String>,
    members: HashMap<(u32, u32), String>,
    types: HashMap<u32, &'m Instruction>,
}

/// Reflects one module.
pub(crate) fn module(name: &str, words: &[u32]) -> Result<Reflected, String> {
    let module = rspirv::dr::load_words(words).map_err(|e| format!("reflection: {e}"))?;
    let r = Reflection::new(&module);
    let mut bindings = Vec::new();
    let mut params = Vec::new();
    let mut shared_bytes = Vec::new();
    for variable in module.types_global_values.iter().filter(|i| i.class.opcode == Op::Variable) {
        match variable.operands.first() {
            Some(Operand::StorageClass(StorageClass::StorageBuffer)) => bindings.push(r.storage(variable)?),
            Some(Operand::StorageClass(StorageClass::UniformConstant)) => bindings.push(r.texel(variable)?),
            Some(Operand::StorageClass(StorageClass::PushConstant)) => params = r.push_constants(variable)?,
            Some(Operand::StorageClass(StorageClass::Workgroup)) => shared_bytes.push(r.bytes(r.pointee(variable)?)?),
            _ => {}
        }
    }
    bindings.sort_by_key(|b| b.number);
    let spec = r.spec_constants()?;
    let local_size = r.local_size()?;
    if !local_size[0].is_multiple_of(8) {
        return Err(format!(
            "local_size_x is {}, must be a multiple of 8: lavapipe packs subgroups along x",
            local_size[0]
        ));
    }
    let capabilities = module.capabilities.iter().filter_map(|i| match i.operands.first() {
        Some(Operand::Capability(capability)) => Some(*capability),
        _ => None,
    });
    let capabilities = capabilities.collect();
    let kernel = Kernel { name: name.to_owned(), bindings, params, spec, local_size };
    Ok(Reflected { kernel, capabilities, shared_bytes })
}

/// Checks that a tile kernel runs on any device.
pub(crate) fn check_tiles(tiles: &Reflected) -> Result<(), String> {
    check_needs(tiles, &[Capability::Shader], MAX_SHARED_BYTES)?;
    if let Some(texels) = tiles.kernel.bindings.iter().find(|b| b.kind == Kind::Texel) {
        return Err(format!(
            "`{}` is a texel buffer in the tile kernel too: declare it by lib/texels.glsl",
            texels.name
        ));
    }
    Ok(())
}

/// Checks that a kernel over cooperative matrices needs no more than `Instance::cooperation` in
/// `kernels/src/vk/cooperation.rs` asks of a device, and that its matrices lie where they may be loaded.
pub(crate) fn check_coop(coop: &Reflected) -> Result<(), String> {
    let granted = [
        Capability::Shader,
        Capability::Float16,
        Capability::GroupNonUniform,
        Capability::VulkanMemoryModel,
        Capability::CooperativeMatrixKHR,
    ];
    check_needs(coop, &granted, MAX_COOP_SHARED_BYTES)?;
    // Rows of 16-bit floats must begin at a multiple of 16 bytes (SPV_KHR_cooperative_matrix), but an array of f16vec4
    // only asks for 8: on NVIDIA 580 all that stood behind a single `uint` was read wrongly.
    match coop.shared_bytes.iter().find(|bytes| !bytes.is_multiple_of(COOP_ALIGNMENT)) {
        Some(bytes) => Err(format!(
            "a shared variable of {bytes} bytes, no multiple of {COOP_ALIGNMENT}, moves what is behind it to where \
             cooperative loads may not begin"
        )),
        None => Ok(()),
    }
}

/// Checks what a module asks of a device.
fn check_needs(module: &Reflected, granted: &[Capability], max_shared_bytes: u32) -> Result<(), String> {
    if let Some(foreign) = module.capabilities.iter().find(|c| !granted.contains(c)) {
        return Err(format!("the kernel needs the capability {foreign:?}"));
    }
    let bytes: u32 = module.shared_bytes.iter().sum();
    if bytes > max_shared_bytes {
        return Err(format!("the kernel takes {bytes} bytes of workgroup memory, more than {max_shared_bytes}"));
    }
    let invocations: u32 = module.kernel.local_size.iter().product();
    if invocations > MAX_INVOCATIONS {
        return Err(format!("a workgroup of the kernel has {invocations} invocations, more than {MAX_INVOCATIONS}"));
    }
    Ok(())
}

/// Checks that the host may exchange both modules, but for how texels are bound.
pub(crate) fn check_exchangeable(lanes: &Reflected, tiles: &Reflected) -> Result<(), String> {
    let mut expected = lanes.kernel.clone();
    for binding in &mut expected.bindings {
        binding.kind = Kind::Storage;
    }
    if expected != tiles.kernel {
        return Err(format!("the interfaces differ:\nlanes {expected:?}\ntiles {:?}", tiles.kernel));
    }
    Ok(())
}

fn id(operand: &Operand) -> Result<u32, String> {
    operand.id_ref_any().ok_or_else(|| format!("expected an id, found {operand:?}"))
}

fn literal(operand: &Operand) -> Result<u32, String> {
    match operand {
        Operand::LiteralBit32(v) => Ok(*v),
        other => Err(format!("expected a literal, found {other:?}")),
    }
}

fn string(operand: &Operand) -> String {
    match operand {
        Operand::LiteralString(s) => s.clone(),
        _ => String::new(),
    }
}

impl<'m> Reflection<'m> {
    fn new(module: &'m Module) -> Self {
        let mut names = HashMap::new();
        let mut members = HashMap::new();
        for i in &module.debug_names {
            let Ok(target) = id(&i.operands[0]) else { continue };
            match i.class.opcode {
                Op::Name => {
                    names.insert(target, string(&i.operands[1]));
                }
                Op::MemberName => {
                    if let Ok(index) = literal(&i.operands[1]) {
                        members.insert((target, index), string(&i.operands[2]));
                    }
                }
                _ => {}
            }
        }
        let types = module.types_global_values.iter().filter_map(|i| Some((i.result_id?, i))).collect();
        Self { module, names, members, types }
    }

    fn type_of(&self, id: u32) -> Result<&'m Instruction, String> {
        self.types.get(&id).copied().ok_or_else(|| format!("type %{id} is missing"))
    }

    fn pointee(&self, variable: &Instruction) -> Result<&'m Instruction, String> {
        let pointer = self.type_of(variable.result_type.ok_or("variable without a type")?)?;
        self.type_of(id(&pointer.operands[1])?)
    }

    /// Decoration operands of `target` (or of member 0 when it is a struct type).
    fn decoration(&self, target: u32, wanted: Decoration) -> Option<Option<&'m Operand>> {
        self.module.annotations.iter().find_map(|i| {
            let at = match i.class.opcode {
                Op::Decorate => 1,
                Op::MemberDecorate => 2,
                _ => return None,
            };
            let hit = id(&i.operands[0]) == Ok(target) && i.operands.get(at) == Some(&Operand::Decoration(wanted));
            hit.then(|| i.operands.get(at + 1))
        })
    }

    fn binding_number(&self, variable: u32) -> Result<u32, String> {
        match self.decoration(variable, Decoration::DescriptorSet) {
            Some(Some(set)) if literal(set)? == 0 => {}
            _ => return Err(format!("`{}` is not in set 0", self.names[&variable])),
        }
        match self.decoration(variable, Decoration::Binding) {
            Some(Some(number)) => literal(number),
            _ => Err(format!("`{}` has no binding", self.names[&variable])),
        }
    }

    /// Scalar under vectors and runtime arrays.
    fn scalar(&self, ty: &Instruction) -> Result<Scalar, String> {
        match ty.class.opcode {
            Op::TypeFloat if literal(&ty.operands[0])? == 32 => Ok(Scalar::F32),
            Op::TypeInt if literal(&ty.operands[0])? == 32 => {
                Ok(if literal(&ty.operands[1])? == 1 { Scalar::I32 } else { Scalar::U32 })
            }
            Op::TypeVector if literal(&ty.operands[1])? != 3 => self.scalar(self.type_of(id(&ty.operands[0])?)?),
            Op::TypeRuntimeArray => self.scalar(self.type_of(id(&ty.operands[0])?)?),
            other => Err(format!("{other:?} is not a 32-bit scalar, vec2 or vec4")),
        }
    }

    /// Size of a type in workgroup memory.
    fn bytes(&self, ty: &Instruction) -> Result<u32, String> {
        match ty.class.opcode {
            Op::TypeFloat | Op::TypeInt => Ok(literal(&ty.operands[0])? / 8),
            Op::TypeVector => Ok(self.bytes(self.type_of(id(&ty.operands[0])?)?)? * literal(&ty.operands[1])?),
            Op::TypeArray => {
                let length = self.type_of(id(&ty.operands[1])?)?;
                let Some(length) = length.operands.first() else {
                    return Err("workgroup memory whose size is computed from specialisation constants".to_owned());
                };
                Ok(self.bytes(self.type_of(id(&ty.operands[0])?)?)? * literal(length)?)
            }
            other => Err(format!("{other:?} in workgroup memory")),
        }
    }

    fn storage(&self, variable: &Instruction) -> Result<Binding, String> {
        let block = self.pointee(variable)?;
        let block_id = block.result_id.ok_or("block without an id")?;
        if block.operands.len() != 1 {
            return Err(format!("block `{}` must hold exactly one runtime array", self.names[&block_id]));
        }
        let variable = variable.result_id.ok_or("variable without an id")?;
        Ok(Binding {
            name: self.members[&(block_id, 0)].clone(),
            number: self.binding_number(variable)?,
            kind: Kind::Storage,
            scalar: self.scalar(self.type_of(id(&block.operands[0])?)?)?,
            readonly: self.decoration(block_id, Decoration::NonWritable).is_some()
                || self.decoration(variable, Decoration::NonWritable).is_some(),
        })
    }

    fn texel(&self, variable: &Instruction) -> Result<Binding, String> {
        let image = self.pointee(variable)?;
        if image.class.opcode != Op::TypeImage {
            return Err(format!("{:?} is not an imageBuffer", image.class.opcode));
        }
        let variable = variable.result_id.ok_or("variable without an id")?;
        let readonly = self.decoration(variable, Decoration::NonWritable).is_some();
        if !readonly {
            return Err(format!("`{}`: store through an SSBO, imageStore is 7 times slower", self.names[&variable]));
        }
        Ok(Binding {
            name: self.names[&variable].clone(),
            number: self.binding_number(variable)?,
            kind: Kind::Texel,
            scalar: self.scalar(self.type_of(id(&image.operands[0])?)?)?,
            readonly,
        })
    }

    fn push_constants(&self, variable: &Instruction) -> Result<Vec<(String, Scalar)>, String> {
        let block = self.pointee(variable)?;
        let block_id = block.result_id.ok_or("block without an id")?;
        let fields = block.operands.iter().zip(0..);
        fields
            .map(|(ty, index)| {
                let name = self.members[&(block_id, index)].clone();
                let ty = self.type_of(id(ty)?)?;
                if ty.class.opcode == Op::TypeVector {
                    return Err(format!("push constant `{name}`: scalars only"));
                }
                Ok((name, self.scalar(ty)?))
            })
            .collect()
    }

    fn spec_constants(&self) -> Result<Vec<(u32, String, Scalar, u32)>, String> {
        let mut spec = Vec::new();
        for i in self.module.types_global_values.iter().filter(|i| i.class.opcode == Op::SpecConstant) {
            let target = i.result_id.ok_or("constant without an id")?;
            let Some(Some(number)) = self.decoration(target, Decoration::SpecId) else { continue };
            let scalar = self.scalar(self.type_of(i.result_type.ok_or("constant without a type")?)?)?;
            spec.push((literal(number)?, self.names[&target].to_lowercase(), scalar, literal(&i.operands[0])?));
        }
        spec.sort_by_key(|s| s.0);
        Ok(spec)
    }

    fn local_size(&self) -> Result<[u32; 3], String> {
        let mode = self
            .module
            .execution_modes
            .iter()
            .find(|i| i.operands.get(1) == Some(&Operand::ExecutionMode(ExecutionMode::LocalSize)));
        let mode = mode.ok_or("no fixed local size")?;
        Ok([literal(&mode.operands[2])?, literal(&mode.operands[3])?, literal(&mode.operands[4])?])
    }
}
