//! Writes `registry.rs`: per kernel a `Params`, a `Spec` and a `Bind`, and the list `ALL`.

use std::collections::BTreeMap;
use std::fmt::Write;

use crate::Programs;
use crate::reflect::{Binding, Kernel, Kind, MAX_COOP_SHARED_BYTES, Scalar};

/// The registry's source text, families and kernels sorted by name. The text depends on the shaders' interfaces alone,
/// so that two compilers that agree on them yield the same bytes.
pub(crate) fn registry(kernels: &[Programs]) -> String {
    let mut families: BTreeMap<&str, Vec<(&str, &Programs)>> = BTreeMap::new();
    for programs in kernels {
        let (family, stem) = programs.kernel.name.split_once('/').expect("names are family/stem");
        families.entry(family).or_default().push((stem, programs));
    }
    let mut out = String::new();
    let mut all = String::new();
    for (family, list) in families {
        let _ = writeln!(out, "/// Kernels of `glsl/{family}`.\npub mod {family} {{");
        for (stem, programs) in list {
            module(&mut out, stem, programs);
            let _ = writeln!(all, "    &{family}::{stem}::KERNEL,");
        }
        out.push_str("}\n");
    }
    let _ = writeln!(out, "/// Every kernel, sorted by name.\npub static ALL: &[&crate::vk::KernelDef] = &[\n{all}];");
    out
}

/// Source text of `SHARED_BYTES`, for the device layer: that much workgroup memory a device needs for the `_coop`
/// kernels.
pub(crate) fn coop_shared_bytes() -> String {
    format!(
        "/// Bytes of workgroup memory that kernels over cooperative matrices take at most.\n\
         const SHARED_BYTES: u32 = {MAX_COOP_SHARED_BYTES};\n"
    )
}

fn module(out: &mut String, stem: &str, Programs { kernel, lanes, tiles, is_coop }: &Programs) {
    let _ = writeln!(out, "/// `glsl/{}.comp`.\npub mod {stem} {{", kernel.name);
    params(out, kernel);
    spec(out, kernel);
    bind(out, kernel);
    let bindings: String = kernel.bindings.iter().map(binding_def).collect();
    let [x, y, z] = kernel.local_size;
    let spirv = |file: &Option<String>| match file {
        Some(file) => format!("Some(include_bytes!(concat!(env!(\"OUT_DIR\"), \"/{file}\")))"),
        None => "None".to_owned(),
    };
    let _ = writeln!(
        out,
        "/// Reflected description.\npub static KERNEL: crate::vk::KernelDef = crate::vk::KernelDef {{ \
         name: {name:?}, lanes: {lanes}, tiles: {tiles}, bindings: &[{bindings}], \
         params_bytes: {bytes}, spec_ids: &{ids:?}, local_size: [{x}, {y}, {z}], is_coop: {is_coop} }};\n}}",
        name = kernel.name,
        lanes = spirv(lanes),
        tiles = spirv(tiles),
        bytes = kernel.params.len() * 4,
        ids = kernel.spec.iter().map(|s| s.0).collect::<Vec<_>>(),
    );
}

fn scalar(s: Scalar) -> &'static str {
    match s {
        Scalar::F32 => "f32",
        Scalar::U32 => "u32",
        Scalar::I32 => "i32",
    }
}

fn params(out: &mut String, kernel: &Kernel) {
    let fields: String = kernel
        .params
        .iter()
        .map(|(name, ty)| format!("/// Push constant `{name}`.\npub {name}: {},\n", scalar(*ty)))
        .collect();
    let bytes = kernel.params.len() * 4;
    let _ = writeln!(
        out,
        "/// Push constants.\n#[repr(C)]\n#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]\n\
         pub struct Params {{\n{fields}}}\n\
         const _: () = assert!(size_of::<Params>() == {bytes} && size_of::<Params>() <= 128, \"tightly packed\");"
    );
}

fn spec(out: &mut String, kernel: &Kernel) {
    if kernel.spec.is_empty() {
        out.push_str("/// No specialisation constants.\npub type Spec = ();\n");
        return;
    }
    let fields: String = kernel
        .spec
        .iter()
        .map(|(_, name, ty, _)| format!("/// Specialisation constant `{name}`.\npub {name}: {},\n", scalar(*ty)))
        .collect();
    let _ = writeln!(
        out,
        "/// Specialisation constants.\n#[repr(C)]\n#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]\n\
         pub struct Spec {{\n{fields}}}"
    );
}

fn bind(out: &mut String, kernel: &Kernel) {
    let mut fields = String::new();
    let mut list = String::new();
    for b in &kernel.bindings {
        let (mutability, access) = if b.readonly { ("", "read") } else { ("mut ", "write") };
        let _ = writeln!(
            fields,
            "/// Binding {} of the shader.\npub {}: &'a {mutability}crate::vk::Buffer<{}>,",
            b.number,
            b.name,
            scalar(b.scalar)
        );
        let _ = write!(list, "crate::vk::Bound::{access}(self.{}),", b.name);
    }
    let count = kernel.bindings.len();
    let _ = writeln!(
        out,
        "/// Buffers by shader name.\npub struct Bind<'a> {{\n{fields}}}\n\
         impl crate::vk::Bindings for Bind<'_> {{\n\
         type Params = Params;\ntype Spec = Spec;\ntype List = [crate::vk::Bound; {count}];\n\
         fn kernel(&self) -> &'static crate::vk::KernelDef {{ &KERNEL }}\n\
         fn list(self) -> Self::List {{ [{list}] }}\n}}"
    );
}

fn binding_def(b: &Binding) -> String {
    let kind = match (b.kind, b.scalar) {
        (Kind::Storage, _) => "Storage",
        (Kind::Texel, Scalar::F32) => "TexelF32",
        (Kind::Texel, _) => "TexelU32",
    };
    format!(
        "crate::vk::BindingDef {{ name: {:?}, number: {}, kind: crate::vk::BindingKind::{kind} }},",
        b.name, b.number
    )
}
