//! INRIA 3DGS/4DGS PLY files: read by property name, written back byte for byte except the SH values.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::body::{self, Body};
use super::header::{Element, Encoding, Header, Scalar, VERTEX, degree_of, find_float};
use super::paths::PathLayout;
use crate::base::files::{bad_data, read_file};
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, Gaussians, SH_FLOATS, Y0, check_coeffs, dc_of_colour, sh_bases};
use crate::scene::limits::check_splats;
use crate::scene::trajectories::Trajectories;

/// A PLY file: its bytes as read, and where the splats' properties lie in them.
#[derive(Clone, Debug)]
pub struct PlyFile {
    path: PathBuf,
    bytes: Vec<u8>,
    header: Header,
    layout: Layout,
}

/// Property indices of the `vertex` element that a splat is made of.
#[derive(Clone, Debug)]
struct Layout {
    vertex: usize,
    means: [usize; 3],
    quats: [usize; 4],
    scales: [usize; 3],
    opacity: usize,
    /// Indexed like one splat of [`Gaussians::sh_coeffs`]; `None` above the stored degree.
    sh_coeffs: [Option<usize>; SH_FLOATS],
    sh_degree: u32,
    /// Of splats on paths, whose `f_dc_*` are plain colours.
    paths: Option<PathLayout>,
}

impl PlyFile {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], and those of [`PlyFile::parse`].
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        Self::parse(path, read_file(path, "a Gaussian splat PLY file")?)
    }

    /// Takes over `bytes`, which came from `path`, and checks head, properties and length.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the header line, property or body length that is wrong.
    pub fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, EngineError> {
        let header = Header::parse(path, &bytes)?;
        let layout = Layout::find(path, &header)?;
        if header.encoding != Encoding::Ascii {
            body::check_length(path, &header, bytes.len())?;
        }
        // In text, a value takes a digit and a blank at least.
        let element = &header.elements[layout.vertex];
        let row_bytes = if header.encoding == Encoding::Ascii { 2 * element.properties.len() } else { element.stride };
        check_splats(path, "element `vertex`", element.count, row_bytes, bytes.len())?;
        Ok(Self { path: path.to_path_buf(), bytes, header, layout })
    }

    /// Number of splats.
    #[must_use]
    pub fn len(&self) -> usize {
        self.vertex().count
    }

    /// Whether there are no splats; [`PlyFile::parse`] refuses such files, so this is `false`.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The file's bytes as read.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Comments of the head, line by line.
    #[must_use]
    pub fn comments(&self) -> &[String] {
        &self.header.comments
    }

    /// Where the bytes came from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether colours are plain RGB instead of SH coefficients.
    #[must_use]
    pub fn is_rgb(&self) -> bool {
        self.layout.paths.is_some()
    }

    /// Decodes the splats, those with values that are not finite among them.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for ASCII bodies with malformed numbers.
    pub fn decode(&self) -> Result<Gaussians, EngineError> {
        let body = Body::new(&self.path, &self.header, self.layout.vertex, &self.bytes)?;
        let count = self.len();
        let mut gaussians = Gaussians {
            means: vec![[0.0; 3]; count],
            quats: vec![[0.0; 4]; count],
            scales: vec![[0.0; 3]; count],
            opacities: vec![0.0; count],
            sh_coeffs: vec![0.0; count * SH_FLOATS],
            sh_degree: self.layout.sh_degree,
        };
        let stored = &self.layout.sh_coeffs[..sh_bases(self.layout.sh_degree) * CHANNELS];
        let geometry = (&mut gaussians.means, &mut gaussians.quats, &mut gaussians.scales, &mut gaussians.opacities);
        let rows = geometry.into_par_iter().zip(gaussians.sh_coeffs.par_chunks_exact_mut(SH_FLOATS));
        rows.enumerate().for_each(|(row, ((mean, quat, scale, opacity), splat))| {
            let record = body.record(row);
            let value = |property| record.value(property);
            *mean = self.layout.means.map(value);
            *quat = self.layout.quats.map(value);
            *scale = self.layout.scales.map(value);
            *opacity = value(self.layout.opacity);
            for (coeff, property) in splat.iter_mut().zip(stored.iter().flatten()) {
                *coeff = value(*property);
            }
        });
        if self.is_rgb() {
            let splats = gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS);
            splats.flat_map(|splat| &mut splat[..CHANNELS]).for_each(|value| *value = dc_of_colour(*value));
        }
        Ok(gaussians)
    }

    /// How the splats move, in files of splats on paths.
    ///
    /// # Errors
    /// As [`PlyFile::decode`].
    pub fn trajectories(&self) -> Result<Option<Trajectories>, EngineError> {
        let Some(paths) = &self.layout.paths else { return Ok(None) };
        let body = Body::new(&self.path, &self.header, self.layout.vertex, &self.bytes)?;
        Ok(Some(paths.decode(&body, self.len())))
    }

    /// The file with the SH values of the splats `rows`, or of all, replaced; every byte outside `f_dc_*` and
    /// `f_rest_*` stays as read.
    ///
    /// # Shapes
    /// in `sh_coeffs` \[rows,16,3\] coefficient-major, finite, zero above the stored degree
    ///
    /// # Errors
    /// [`EngineError::Usage`] if `sh_coeffs` does not fit the splats; [`EngineError::BadData`] if the file is
    /// ASCII or its SH properties are not 32-bit floats, which cannot be replaced in place.
    ///
    /// # Determinism
    /// bitwise; the values that [`PlyFile::decode`] returned give back the same bytes
    pub fn with_sh(&self, rows: Option<&[u32]>, sh_coeffs: &[f32]) -> Result<Vec<u8>, EngineError> {
        Ok(self.with_words(rows, &self.words_of(rows, sh_coeffs)?))
    }

    /// The stored words of all colours of the splats `rows`, or of all.
    ///
    /// # Errors
    /// As [`PlyFile::with_sh`] for files that cannot be written.
    pub fn words(&self, rows: Option<&[u32]>) -> Result<Vec<u32>, EngineError> {
        let places = self.colour_places()?;
        let start = body::start_of(&self.header, self.layout.vertex);
        let stride = self.vertex().stride;
        let count = rows.map_or(self.len(), <[u32]>::len);
        let word = |(index, place): (usize, usize)| {
            let row = rows.map_or(index, |rows| rows[index] as usize);
            let bytes =
                *self.bytes[start + stride * row + place..].first_chunk().expect("the body's length was checked");
            if self.is_big_endian() { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
        };
        Ok((0..count).flat_map(|index| places.iter().map(move |place| (index, *place))).map(word).collect())
    }

    /// How many words [`PlyFile::words`] has for a splat.
    ///
    /// # Errors
    /// As [`PlyFile::with_sh`] for files that cannot be written.
    pub fn words_per_splat(&self) -> Result<usize, EngineError> {
        Ok(self.colour_places()?.len())
    }

    /// The words that coefficients are stored as. A plain colour stays as it is where the coefficient is the one that
    /// it was read as: the way there and back rounds.
    ///
    /// # Errors
    /// As [`PlyFile::with_sh`].
    pub fn words_of(&self, rows: Option<&[u32]>, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        let stored = self.words(rows)?;
        check_coeffs(rows.map_or(self.len(), <[u32]>::len), self.layout.sh_degree, sh_coeffs)?;
        let floats = sh_bases(self.layout.sh_degree) * CHANNELS;
        let coeffs = sh_coeffs.chunks_exact(SH_FLOATS).flat_map(|splat| &splat[..floats]);
        Ok(coeffs.zip(stored).map(|(coeff, word)| self.word_of(*coeff, word)).collect())
    }

    fn word_of(&self, coeff: f32, stored: u32) -> u32 {
        match self.is_rgb() {
            false => coeff.to_bits(),
            true if dc_of_colour(f32::from_bits(stored)) == coeff => stored,
            true => narrow(0.5 + Y0 * f64::from(coeff)).to_bits(),
        }
    }

    /// The coefficients `[rows,16,3]` that words are read as.
    #[must_use]
    pub fn coeffs_of(&self, words: &[u32]) -> Vec<f32> {
        let floats = sh_bases(self.layout.sh_degree) * CHANNELS;
        let mut coeffs = vec![0.0; words.len() / floats * SH_FLOATS];
        for (splat, words) in coeffs.chunks_exact_mut(SH_FLOATS).zip(words.chunks_exact(floats)) {
            for (coeff, word) in splat.iter_mut().zip(words) {
                let value = f32::from_bits(*word);
                *coeff = if self.is_rgb() { dc_of_colour(value) } else { value };
            }
        }
        coeffs
    }

    /// The file with other words in the places of [`PlyFile::words`].
    ///
    /// # Panics
    /// For a file whose words cannot be read.
    #[must_use]
    pub fn with_words(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<u8> {
        let places = self.colour_places().expect("words come from a file that can be written");
        let start = body::start_of(&self.header, self.layout.vertex);
        let stride = self.vertex().stride;
        let mut bytes = self.bytes.clone();
        for (index, splat) in words.chunks_exact(places.len()).enumerate() {
            let row = rows.map_or(index, |rows| rows[index] as usize);
            for (word, place) in splat.iter().zip(&places) {
                let stored = if self.is_big_endian() { word.to_be_bytes() } else { word.to_le_bytes() };
                bytes[start + stride * row + place..][..stored.len()].copy_from_slice(&stored);
            }
        }
        bytes
    }

    fn is_big_endian(&self) -> bool {
        self.header.encoding == Encoding::BigEndian
    }

    /// Offsets of the colours in a record, coefficient by coefficient.
    fn colour_places(&self) -> Result<Vec<usize>, EngineError> {
        let expected = "a binary PLY with float SH properties, whose values can be replaced in place";
        if self.header.encoding == Encoding::Ascii {
            return Err(bad_data(&self.path, "format", "ascii", expected));
        }
        let places = self.layout.sh_coeffs.iter().flatten().map(|property| {
            let property = &self.vertex().properties[*property];
            match property.scalar {
                Scalar::F32 => Ok(property.offset),
                _ => Err(bad_data(&self.path, format!("property `{}`", property.name), "double", expected)),
            }
        });
        places.collect()
    }

    fn vertex(&self) -> &Element {
        &self.header.elements[self.layout.vertex]
    }
}

impl Layout {
    fn find(path: &Path, header: &Header) -> Result<Self, EngineError> {
        let vertex = header.elements.iter().position(|e| e.name == VERTEX);
        let vertex = vertex.ok_or_else(|| bad_data(path, "header", "no `vertex` element", "one"))?;
        let element = &header.elements[vertex];
        if element.count == 0 {
            return Err(bad_data(path, "element `vertex`", "0 splats", "at least one"));
        }
        let property = |name: &str| find_float(path, element, name);
        let (sh_coeffs, sh_degree) = find_sh(path, element)?;
        let paths = PathLayout::find(path, element)?;
        Ok(Self {
            vertex,
            means: [property("x")?, property("y")?, property("z")?],
            quats: [property("rot_0")?, property("rot_1")?, property("rot_2")?, property("rot_3")?],
            scales: [property("scale_0")?, property("scale_1")?, property("scale_2")?],
            opacity: property("opacity")?,
            sh_coeffs,
            sh_degree,
            paths,
        })
    }
}

/// Maps the channel-major `f_dc_*`, `f_rest_*` to coefficient-major places, and tells the degree.
fn find_sh(path: &Path, element: &Element) -> Result<([Option<usize>; SH_FLOATS], u32), EngineError> {
    let degree = degree_of(path, element)?;
    let per_channel = sh_bases(degree) - 1;
    let mut places = [None; SH_FLOATS];
    for channel in 0..CHANNELS {
        places[channel] = Some(find_float(path, element, &format!("f_dc_{channel}"))?);
        for basis in 0..per_channel {
            let name = format!("f_rest_{}", channel * per_channel + basis);
            places[(basis + 1) * CHANNELS + channel] = Some(find_float(path, element, &name)?);
        }
    }
    Ok((places, degree))
}

/// Writes `gaussians` as a binary little-endian INRIA PLY: float properties in upstream order, zero normals.
///
/// # Determinism
/// bitwise; [`PlyFile::decode`] returns the same values
#[must_use]
pub fn encode(gaussians: &Gaussians) -> Vec<u8> {
    let per_channel = sh_bases(gaussians.sh_degree) - 1;
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(String::from).into();
    let numbered = |stem: &str, count: usize| -> Vec<String> { (0..count).map(|i| format!("{stem}_{i}")).collect() };
    names.extend(numbered("f_dc", CHANNELS));
    names.extend(numbered("f_rest", per_channel * CHANNELS));
    names.push("opacity".to_owned());
    names.extend(numbered("scale", 3));
    names.extend(numbered("rot", 4));
    let mut head = format!("ply\nformat binary_little_endian 1.0\nelement {VERTEX} {}\n", gaussians.len());
    for name in &names {
        head.push_str(&format!("property float {name}\n"));
    }
    head.push_str("end_header\n");
    let mut bytes = head.into_bytes();
    bytes.reserve(gaussians.len() * names.len() * Scalar::F32.size_bytes());
    for (row, sh_coeffs) in gaussians.sh_coeffs.chunks_exact(SH_FLOATS).enumerate() {
        let rest =
            (0..CHANNELS).flat_map(|channel| (1..=per_channel).map(move |basis| sh_coeffs[basis * CHANNELS + channel]));
        let values = gaussians.means[row].into_iter().chain([0.0; 3]);
        let values = values.chain(sh_coeffs[..CHANNELS].iter().copied()).chain(rest);
        let values = values.chain([gaussians.opacities[row]]).chain(gaussians.scales[row]).chain(gaussians.quats[row]);
        bytes.extend(values.flat_map(f32::to_le_bytes));
    }
    bytes
}
