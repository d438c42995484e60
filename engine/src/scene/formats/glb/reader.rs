//! Where a document says that the values of its splats are.

use std::ops::Range;
use std::path::Path;

use super::document::{
    Accessor, Document, EXTENSION, F32, I8, I16, Node, OPACITY, POSITION, Primitive, ROTATION, SCALE, U8, U16,
};
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::gaussians::MAX_SH_DEGREE;

/// Where the values of an attribute are in the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slot {
    pub(super) start: usize,
    pub(super) stride: usize,
    pub(super) component_type: u32,
    pub(super) normalized: bool,
}

/// One primitive of splats.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub(super) splats: usize,
    pub(super) position: Slot,
    pub(super) rotation: Slot,
    pub(super) scale: Slot,
    pub(super) opacity: Slot,
    /// By basis.
    pub(super) sh_coeffs: Vec<Slot>,
}

/// A document beside its binary chunk.
pub(super) struct Reader<'a> {
    pub(super) path: &'a Path,
    pub(super) document: &'a Document,
    pub(super) binary: Range<usize>,
}

impl Reader<'_> {
    pub(super) fn part(&self, field: &str, primitive: &Primitive) -> Result<Part, EngineError> {
        let of = |name: &str| primitive.attributes.get(name).copied();
        let find = |name: &str, kind: &str, types: &[u32]| {
            let index = of(name).ok_or_else(|| bad_data(self.path, field, format!("no `{name}`"), "one"))?;
            self.slot(&format!("{field}, `{name}`"), index, kind, types)
        };
        let (position, splats) = find(POSITION, "VEC3", &[F32])?;
        let coefficient = |degree: u32, index: u32| format!("{EXTENSION}:SH_DEGREE_{degree}_COEF_{index}");
        let degree = (0..=MAX_SH_DEGREE).take_while(|&degree| of(&coefficient(degree, 0)).is_some()).last();
        let degree = degree.ok_or_else(|| bad_data(self.path, field, "no colours", coefficient(0, 0)))?;
        let names = (0..=degree).flat_map(|degree| (0..=2 * degree).map(move |index| (degree, index)));
        let mut all = vec![find(ROTATION, "VEC4", &[F32, I8, I16])?, find(SCALE, "VEC3", &[F32, I8, I16])?];
        all.push(find(OPACITY, "SCALAR", &[F32, U8, U16])?);
        for (degree, index) in names {
            all.push(find(&coefficient(degree, index), "VEC3", &[F32])?);
        }
        if let Some((_, count)) = all.iter().find(|(_, count)| *count != splats) {
            return Err(bad_data(
                self.path,
                field,
                format!("{splats} positions, {count} values beside them"),
                "as many",
            ));
        }
        let slots: Vec<Slot> = all.into_iter().map(|(slot, _)| slot).collect();
        let (rotation, scale, opacity) = (slots[0], slots[1], slots[2]);
        Ok(Part { splats, position, rotation, scale, opacity, sh_coeffs: slots[3..].to_vec() })
    }

    /// Where the values of an accessor are, and how many.
    fn slot(&self, field: &str, index: usize, kind: &str, types: &[u32]) -> Result<(Slot, usize), EngineError> {
        let bad = |got: String, expected: String| bad_data(self.path, field, got, expected);
        let missing = |what: &str, index: usize| bad(format!("no {what}[{index}]"), "one".to_owned());
        let accessor = self.document.accessors.get(index).ok_or_else(|| missing("accessors", index))?;
        if accessor.kind != kind || !types.contains(&accessor.component_type) {
            let got = format!("{} of component type {}", accessor.kind, accessor.component_type);
            return Err(bad(got, format!("{kind} of one of {types:?}")));
        }
        if accessor.sparse.is_some() {
            return Err(bad("a sparse accessor".to_owned(), "values side by side".to_owned()));
        }
        let view = accessor.buffer_view.ok_or_else(|| bad("no buffer view".to_owned(), "one".to_owned()))?;
        let view = self.document.buffer_views.get(view).ok_or_else(|| missing("bufferViews", view))?;
        if view.buffer != 0 {
            return Err(bad(format!("buffer {}", view.buffer), "the file's own buffer, 0".to_owned()));
        }
        let components = match kind {
            "SCALAR" => 1,
            "VEC3" => 3,
            _ => 4,
        };
        let component_bytes = match accessor.component_type {
            I8 | U8 => 1,
            I16 | U16 => 2,
            _ => 4,
        };
        let record = components * component_bytes;
        let stride = view.byte_stride.unwrap_or(record);
        let last = accessor.count.checked_sub(1).and_then(|last| last.checked_mul(stride));
        let end = last.and_then(|last| last.checked_add(record)?.checked_add(accessor.byte_offset));
        let inside_view = end.is_some_and(|end| end <= view.byte_length) && stride >= record;
        let view_end = view.byte_offset.checked_add(view.byte_length);
        if !inside_view || view_end.is_none_or(|end| end > self.binary.len()) {
            let got = format!("{} values from byte {} on", accessor.count, accessor.byte_offset);
            return Err(bad(got, "at least one, all inside buffer view and file".to_owned()));
        }
        let start = self.binary.start + view.byte_offset + accessor.byte_offset;
        let Accessor { component_type, normalized, count, .. } = *accessor;
        Ok((Slot { start, stride, component_type, normalized }, count))
    }

    /// Refuses meshes that their nodes move apart; a note when they move all of them alike.
    pub(super) fn transforms(&self, used: &[usize]) -> Result<Option<String>, EngineError> {
        let moves = |node: &Node| (node.matrix, node.translation, node.rotation, node.scale);
        let holds_splats = |node: &&Node| node.mesh.is_some_and(|mesh| used.contains(&mesh));
        let mut nodes = self.document.nodes.iter().filter(holds_splats).map(moves);
        let Some(first) = nodes.next() else { return Ok(None) };
        if nodes.any(|other| other != first) {
            let expected = "one transform for all splats; export them as one mesh";
            return Err(bad_data(self.path, "nodes", "splats that are moved apart", expected));
        }
        let is_moved = first != (None, None, None, None);
        Ok(is_moved.then(|| {
            format!("{}: its node is moved or turned; cameras are in the axes of the mesh", self.path.display())
        }))
    }
}
