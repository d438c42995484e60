//! A glTF binary as it was read, and the way of new colours into a copy of it.

use std::path::{Path, PathBuf};

use super::document::{Document, EXTENSION, I8, I16, OPACITY, U8, U16, chunks};
use super::reader::{Part, Reader, Slot};
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::axes::HalfTurn;
use crate::scene::formats::bytes::f32_at;
use crate::scene::formats::values::{log_scale, logit, with_capacity};
use crate::scene::gaussians::{CHANNELS, Gaussians, MAX_SH_DEGREE, SH_FLOATS, check_coeffs, sh_bases};
use crate::scene::limits::check_splats;

/// Fewest bytes of a splat: a position of floats, and the DC terms.
const MIN_SPLAT_BYTES: usize = 24;

/// A glTF binary whose coefficients can be replaced.
#[derive(Clone, Debug)]
pub struct GlbFile {
    path: PathBuf,
    bytes: Vec<u8>,
    parts: Vec<Part>,
    /// What was taken for granted.
    warnings: Vec<String>,
    /// Rights and maker.
    comments: Vec<String>,
}

impl GlbFile {
    /// Takes over `bytes`, which came from `path`. All primitives with the extension are one scene, in the axes of
    /// their meshes.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the object that is missing, points outside the file, has another type than the
    /// extension asks for, or stands beside others that a node has moved elsewhere.
    pub fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, EngineError> {
        let (json, binary) = chunks(path, &bytes)?;
        let document: Document = crate::base::json::parse(path, "JSON chunk", json, "a glTF document")?;
        let reader = Reader { path, document: &document, binary };
        let mut parts = Vec::new();
        let mut used = Vec::new();
        for (number, mesh) in document.meshes.iter().enumerate() {
            for (index, primitive) in mesh.primitives.iter().enumerate() {
                if primitive.extensions.contains_key(EXTENSION) {
                    parts.push(reader.part(&format!("meshes[{number}].primitives[{index}]"), primitive)?);
                    used.push(number);
                }
            }
        }
        if parts.is_empty() {
            return Err(bad_data(path, "meshes", "no splats", format!("a primitive with `{EXTENSION}`")));
        }
        let splats = parts.iter().map(|part| part.splats).try_fold(0_usize, usize::checked_add);
        check_splats(path, "splats", splats.unwrap_or(usize::MAX), MIN_SPLAT_BYTES, bytes.len())?;
        let warnings = reader.transforms(&used)?.into_iter().collect();
        let comments = document.asset.copyright.into_iter().chain(document.asset.generator).collect();
        Ok(Self { path: path.to_path_buf(), bytes, parts, warnings, comments })
    }

    /// The file's bytes as read.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Where the bytes came from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Rights and maker, as far as the file tells.
    #[must_use]
    pub fn comments(&self) -> &[String] {
        &self.comments
    }

    /// What was taken for granted about the file.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The splats, those with values that are not finite among them, turned into the axes of PLY files.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for opacities outside 0 to 1.
    pub fn decode(&self) -> Result<Gaussians, EngineError> {
        let splats = self.splats();
        let mut gaussians = with_capacity(splats, self.sh_degree());
        let mut scales: Vec<[f32; 3]> = Vec::with_capacity(splats);
        let mut rows = gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS);
        for part in &self.parts {
            for (row, splat) in (0..part.splats).zip(rows.by_ref()) {
                let [x, y, z, w] = self.values(part.rotation, row);
                gaussians.quats.push([w, x, y, z]);
                gaussians.means.push(self.values(part.position, row));
                scales.push(self.values(part.scale, row));
                let [opacity] = self.values(part.opacity, row);
                if !opacity.is_nan() && !(0.0..=1.0).contains(&opacity) {
                    let field = format!("{OPACITY} of splat {row}");
                    return Err(bad_data(&self.path, field, opacity, "0 to 1"));
                }
                gaussians.opacities.push(if opacity.is_nan() { opacity } else { logit(opacity) });
                for (basis, slot) in part.sh_coeffs.iter().enumerate() {
                    let colour: [f32; CHANNELS] = self.values(*slot, row);
                    splat[CHANNELS * basis..CHANNELS * (basis + 1)].copy_from_slice(&colour);
                }
            }
        }
        // Drafts of the extension stored the logarithm, which tells itself by its sign or by a signed type.
        let signed = |part: &Part| matches!(part.scale.component_type, I8 | I16);
        if !self.parts.iter().any(signed) && !scales.iter().flatten().any(|scale| *scale < 0.0) {
            scales.iter_mut().flatten().for_each(|scale| *scale = log_scale(*scale));
        }
        gaussians.scales = scales;
        HalfTurn::AboutZ.apply(&mut gaussians);
        Ok(gaussians)
    }

    /// The stored words of all coefficients of the splats `rows`, or of all.
    #[must_use]
    pub fn words(&self, rows: Option<&[u32]>) -> Vec<u32> {
        let word = |at: usize| u32::from_le_bytes(*self.bytes[at..].first_chunk().expect("slots lie in the file"));
        self.places(rows).map(|(at, _)| word(at)).collect()
    }

    /// How many words [`GlbFile::words`] has.
    #[must_use]
    pub fn num_words(&self, rows: Option<&[u32]>) -> usize {
        self.places(rows).count()
    }

    /// The words that coefficients `[rows,16,3]`, in the axes of PLY files, are stored as.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for coefficients that do not fit, also above the degree of a splat's own primitive.
    pub fn words_of(&self, rows: Option<&[u32]>, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        check_coeffs(rows.map_or(self.splats(), <[u32]>::len), self.sh_degree(), sh_coeffs)?;
        let signs = HalfTurn::AboutZ.sh_signs();
        Ok(self.places(rows).map(|(_, float)| signs[float % SH_FLOATS] * sh_coeffs[float]).map(f32::to_bits).collect())
    }

    /// The coefficients `[rows,16,3]` that words are read as.
    #[must_use]
    pub fn coeffs_of(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<f32> {
        let signs = HalfTurn::AboutZ.sh_signs();
        let mut coeffs = vec![0.0; SH_FLOATS * rows.map_or(self.splats(), <[u32]>::len)];
        for ((_, float), word) in self.places(rows).zip(words) {
            coeffs[float] = signs[float % SH_FLOATS] * f32::from_bits(*word);
        }
        coeffs
    }

    /// The file with other words in the places of [`GlbFile::words`].
    #[must_use]
    pub fn with_words(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        for ((at, _), word) in self.places(rows).zip(words) {
            bytes[at..at + size_of::<u32>()].copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }

    /// Number of splats.
    #[must_use]
    pub fn splats(&self) -> usize {
        self.parts.iter().map(|part| part.splats).sum()
    }

    fn sh_degree(&self) -> u32 {
        let bases = self.parts.iter().map(|part| part.sh_coeffs.len()).max().unwrap_or(1);
        (0..=MAX_SH_DEGREE).find(|&degree| sh_bases(degree) == bases).unwrap_or(MAX_SH_DEGREE)
    }

    /// Where each coefficient of the splats `rows`, or of all, is in the file, and which of `[rows,16,3]` it is.
    fn places<'a>(&'a self, rows: Option<&'a [u32]>) -> impl Iterator<Item = (usize, usize)> + 'a {
        let starts = self.parts.iter().scan(0, |start, part| {
            let first = *start;
            *start += part.splats;
            Some((first, part))
        });
        let of_part = move |(first, part): (usize, &'a Part)| {
            let range = first..first + part.splats;
            // Rows are in ascending order, so that those of a part are side by side.
            let used = match rows {
                None => range,
                Some(rows) => {
                    let index = |row: usize| rows.partition_point(|&other| (other as usize) < row);
                    index(range.start)..index(range.end)
                }
            };
            used.flat_map(move |index| {
                let row = rows.map_or(index, |rows| rows[index] as usize) - first;
                let bases = part.sh_coeffs.iter().enumerate();
                bases.flat_map(move |(basis, slot)| {
                    let at = slot.start + row * slot.stride;
                    (0..CHANNELS).map(move |c| (at + c * size_of::<f32>(), SH_FLOATS * index + CHANNELS * basis + c))
                })
            })
        };
        starts.flat_map(of_part)
    }

    /// The values of one splat.
    fn values<const N: usize>(&self, slot: Slot, row: usize) -> [f32; N] {
        let record = &self.bytes[slot.start + row * slot.stride..];
        std::array::from_fn(|i| {
            let signed_unit = |value: f32, most: f32| if slot.normalized { (value / most).max(-1.0) } else { value };
            match slot.component_type {
                I8 => signed_unit(f32::from(i8::from_le_bytes([record[i]])), f32::from(i8::MAX)),
                U8 => signed_unit(f32::from(record[i]), f32::from(u8::MAX)),
                I16 => {
                    signed_unit(f32::from(i16::from_le_bytes([record[2 * i], record[2 * i + 1]])), f32::from(i16::MAX))
                }
                U16 => {
                    signed_unit(f32::from(u16::from_le_bytes([record[2 * i], record[2 * i + 1]])), f32::from(u16::MAX))
                }
                _ => f32_at(record, i),
            }
        })
    }
}
