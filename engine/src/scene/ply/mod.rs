//! INRIA 3DGS/4DGS PLY files: read by property name, written back byte for byte except the SH values.

use std::path::{Path, PathBuf};

use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, Gaussians, MAX_SH_DEGREE, SH_FLOATS, sh_bases};
use crate::scene::{bad_data, read_file};

mod body;
mod header;

use body::Body;
use header::{Element, Encoding, Header, Scalar};

/// Name of the element that holds the splats.
const VERTEX: &str = "vertex";

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

    /// Where the bytes came from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Decodes the splats.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a value that is NaN or infinite as f32, naming the first splat, its
    /// property and how many splats hold such values; for ASCII bodies also on malformed numbers.
    pub fn decode(&self) -> Result<Gaussians, EngineError> {
        let body = Body::new(&self.path, &self.header, self.layout.vertex, &self.bytes)?;
        self.check_finite(&body)?;
        let count = self.len();
        let mut gaussians = Gaussians {
            means: Vec::with_capacity(count),
            quats: Vec::with_capacity(count),
            scales: Vec::with_capacity(count),
            opacities: Vec::with_capacity(count),
            sh_coeffs: Vec::with_capacity(count * SH_FLOATS),
            sh_degree: self.layout.sh_degree,
        };
        for row in 0..count {
            let value = |property| body.value(row, property);
            gaussians.means.push(self.layout.means.map(value));
            gaussians.quats.push(self.layout.quats.map(value));
            gaussians.scales.push(self.layout.scales.map(value));
            gaussians.opacities.push(value(self.layout.opacity));
            let coeffs = self.layout.sh_coeffs.iter();
            gaussians.sh_coeffs.extend(coeffs.map(|property| property.map_or(0.0, value)));
        }
        Ok(gaussians)
    }

    /// The file with its SH values replaced; every byte outside `f_dc_*` and `f_rest_*` stays as read.
    ///
    /// # Shapes
    /// in `sh_coeffs` \[N,16,3\] coefficient-major, finite, zero above the stored degree
    ///
    /// # Errors
    /// [`EngineError::Usage`] if `sh_coeffs` does not fit the splats; [`EngineError::BadData`] if the file is
    /// ASCII or its SH properties are not 32-bit floats, which cannot be replaced in place.
    ///
    /// # Determinism
    /// bitwise; the values that [`PlyFile::decode`] returned give back the same bytes
    pub fn with_sh(&self, sh_coeffs: &[f32]) -> Result<Vec<u8>, EngineError> {
        self.check_writable()?;
        self.check_new_sh(sh_coeffs)?;
        let start = body::start_of(&self.header, self.layout.vertex);
        let vertex = self.vertex();
        let mut bytes = self.bytes.clone();
        let records = bytes[start..].chunks_exact_mut(vertex.stride);
        for (record, splat) in records.zip(sh_coeffs.chunks_exact(SH_FLOATS)) {
            for (value, property) in splat.iter().zip(&self.layout.sh_coeffs) {
                let Some(property) = *property else { continue };
                let offset = vertex.properties[property].offset;
                let stored = match self.header.encoding {
                    Encoding::BigEndian => value.to_be_bytes(),
                    Encoding::LittleEndian | Encoding::Ascii => value.to_le_bytes(),
                };
                record[offset..offset + stored.len()].copy_from_slice(&stored);
            }
        }
        Ok(bytes)
    }

    fn vertex(&self) -> &Element {
        &self.header.elements[self.layout.vertex]
    }

    /// Refuses NaN and infinities in any property that a splat is made of.
    fn check_finite(&self, body: &Body<'_>) -> Result<(), EngineError> {
        let used: Vec<usize> = self.layout.properties().collect();
        let offender = |row: usize| {
            let mut properties = used.iter().copied();
            properties.find(|&property| !body.value(row, property).is_finite())
        };
        let mut rows = (0..self.len()).filter_map(|row| Some((row, offender(row)?)));
        let Some((row, property)) = rows.next() else {
            return Ok(());
        };
        let count = 1 + rows.count();
        let field = format!("splat {row}, `{}`", self.vertex().properties[property].name);
        let value = body.value(row, property);
        let got = format!("{value} ({count} of {} splats hold such values)", self.len());
        Err(bad_data(&self.path, field, got, "finite values"))
    }

    fn check_writable(&self) -> Result<(), EngineError> {
        let expected = "a binary PLY with float SH properties, whose values can be replaced in place";
        if self.header.encoding == Encoding::Ascii {
            return Err(bad_data(&self.path, "format", "ascii", expected));
        }
        for property in self.layout.sh_coeffs.iter().flatten() {
            let property = &self.vertex().properties[*property];
            if property.scalar != Scalar::F32 {
                let field = format!("property `{}`", property.name);
                return Err(bad_data(&self.path, field, "double", expected));
            }
        }
        Ok(())
    }

    fn check_new_sh(&self, sh_coeffs: &[f32]) -> Result<(), EngineError> {
        let usage = |got: String, expected: String| EngineError::Usage {
            what: "new SH coefficients".to_owned(),
            got,
            expected,
        };
        let expected = self.len() * SH_FLOATS;
        if sh_coeffs.len() != expected {
            return Err(usage(format!("{} values", sh_coeffs.len()), format!("{expected} ({} splats)", self.len())));
        }
        let stored = sh_bases(self.layout.sh_degree) * CHANNELS;
        for (row, splat) in sh_coeffs.chunks_exact(SH_FLOATS).enumerate() {
            if let Some(value) = splat.iter().find(|value| !value.is_finite()) {
                return Err(usage(format!("{value} at splat {row}"), "finite values".to_owned()));
            }
            if splat[stored..].iter().any(|&value| value != 0.0) {
                return Err(usage(
                    format!("values above degree {} at splat {row}", self.layout.sh_degree),
                    "zeros, because the file has no place for them".to_owned(),
                ));
            }
        }
        Ok(())
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
        Ok(Self {
            vertex,
            means: [property("x")?, property("y")?, property("z")?],
            quats: [property("rot_0")?, property("rot_1")?, property("rot_2")?, property("rot_3")?],
            scales: [property("scale_0")?, property("scale_1")?, property("scale_2")?],
            opacity: property("opacity")?,
            sh_coeffs,
            sh_degree,
        })
    }

    /// Indices of all properties that are read.
    fn properties(&self) -> impl Iterator<Item = usize> {
        let geometry = self.means.into_iter().chain(self.quats).chain(self.scales);
        geometry.chain([self.opacity]).chain(self.sh_coeffs.into_iter().flatten())
    }
}

/// Index of the floating-point property `name`.
fn find_float(path: &Path, element: &Element, name: &str) -> Result<usize, EngineError> {
    let field = format!("property `{name}`");
    let expected = "a float property, as in an uncompressed INRIA 3DGS PLY";
    let (index, property) = element.find(name).ok_or_else(|| bad_data(path, &field, "missing", expected))?;
    match property.scalar {
        Scalar::F32 | Scalar::F64 => Ok(index),
        other => Err(bad_data(path, &field, format!("type {other:?}"), expected)),
    }
}

/// Maps the channel-major `f_dc_*`, `f_rest_*` to coefficient-major places, and tells the degree.
fn find_sh(path: &Path, element: &Element) -> Result<([Option<usize>; SH_FLOATS], u32), EngineError> {
    let names = element.properties.iter();
    let rest = names.filter(|p| p.name.starts_with("f_rest_")).count();
    let degree = (0..=MAX_SH_DEGREE).find(|&degree| (sh_bases(degree) - 1) * CHANNELS == rest).ok_or_else(|| {
        let got = format!("{rest} properties");
        bad_data(path, "properties `f_rest_*`", got, "0, 9, 24 or 45")
    })?;
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
