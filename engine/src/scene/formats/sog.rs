//! SOG archives, version 2 (`PlayCanvas`, "The SOG Format"): lossless WebP textures, codebooks, and a palette for SH.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::codecs::webp::{WebPDecoder, WebPEncoder};
use image::{ExtendedColorType, ImageDecoder as _, RgbaImage};
use serde::Deserialize;

use super::archive::Archive;
use super::values::{coeffs_of_rows, logit_of_byte, rest_floats, with_capacity, with_largest};
use crate::base::files::bad_data;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, Gaussians, MAX_SH_DEGREE, SH_FLOATS, check_coeffs, sh_bases};
use crate::scene::limits::{MAX_JSON_BYTES, MAX_PIXELS_PER_SPLAT, MIN_BYTES_PER_SPLAT, MIN_MAX_PIXELS, check_splats};

const META: &str = "meta.json";
const VERSION: u32 = 2;
const SH0_CODES: &str = "`sh0.codebook`";
/// Entries of a codebook: one for each value of a byte.
const CODES: usize = 256;
/// Palette entries in a row of the palette's texture.
const PALETTE_COLUMNS: usize = 64;
/// Most entries of the palette, whose numbers have 16 bits.
const MAX_PALETTE: usize = 1 << 16;
/// Most columns or rows of a WebP image that can be written.
const MAX_SIDE: u32 = 1 << 14;
/// Value of a rotation's fourth byte that means that w was left out; x, y and z follow.
const FIRST_TAG: u8 = 252;

#[derive(Deserialize)]
struct Meta {
    version: Option<u32>,
    count: usize,
    means: Means,
    scales: Coded,
    quats: Plain,
    sh0: Coded,
    #[serde(rename = "shN")]
    rest: Option<Palette>,
}

impl Meta {
    /// All files but that of the base colours.
    fn other_files(&self) -> impl Iterator<Item = &String> {
        let rest = self.rest.iter().flat_map(|palette| &palette.files);
        self.means.files.iter().chain(&self.quats.files).chain(&self.scales.files).chain(rest)
    }
}

#[derive(Deserialize)]
struct Means {
    mins: [f64; 3],
    maxs: [f64; 3],
    /// Low bytes, high bytes.
    files: [String; 2],
}

#[derive(Deserialize)]
struct Plain {
    files: [String; 1],
}

#[derive(Deserialize)]
struct Coded {
    codebook: Vec<f64>,
    files: [String; 1],
}

#[derive(Deserialize)]
struct Palette {
    count: usize,
    bands: u32,
    codebook: Vec<f64>,
    /// Palette, and its entry for each splat.
    files: [String; 2],
}

/// A file whose base colours can be replaced by the nearest of its codebook. All other files of the archive stay as
/// they are packed. The texture of the colours is compressed anew: a copy that is given the colours of the original
/// again holds what that held, but not in the same bytes.
#[derive(Clone, Debug)]
pub struct SogFile {
    path: PathBuf,
    bytes: Vec<u8>,
    gaussians: Gaussians,
    /// The texture of colours and opacities, and what it is called.
    texture: RgbaImage,
    name: String,
    codebook: Codebook,
}

impl SogFile {
    /// Takes over `bytes`, which came from `path`.
    ///
    /// # Errors
    /// Those of [`decode`]; [`EngineError::BadData`] for archives that cannot be written again, and where another
    /// texture is that of the colours.
    pub fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, EngineError> {
        let (mut reader, meta) = Reader::open(path, &bytes)?;
        let gaussians = reader.gaussians(&meta)?;
        let [name] = meta.sh0.files.clone();
        if meta.other_files().any(|other| *other == name) {
            return Err(bad_data(path, "`sh0.files`", format!("`{name}`, as elsewhere"), "a texture of its own"));
        }
        let codebook = Codebook::new(reader.codebook(SH0_CODES, &meta.sh0.codebook)?);
        let texture = reader.texture(&name)?;
        let side = texture.width().max(texture.height());
        if side > MAX_SIDE {
            return Err(bad_data(path, format!("side of `{name}`"), side, format!("at most {MAX_SIDE}")));
        }
        reader.archive.check_packed(bytes.len())?;
        // What cannot be written is told now and not when it is marked.
        reader.archive.with_entry(&name, &[])?;
        Ok(Self { path: path.to_path_buf(), bytes, gaussians, texture, name, codebook })
    }

    /// The splats, those with values that are not finite among them.
    #[must_use]
    pub fn decode(&self) -> Gaussians {
        self.gaussians.clone()
    }

    /// Where the bytes came from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file's bytes as read.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Number of splats.
    #[must_use]
    pub fn splats(&self) -> usize {
        self.gaussians.len()
    }

    /// The codes of the base colours of the splats `rows`, or of all, as words.
    #[must_use]
    pub fn words(&self, rows: Option<&[u32]>) -> Vec<u32> {
        let codes = (0..self.count(rows)).flat_map(|index| &self.texture.as_raw()[place(rows, index)..][..CHANNELS]);
        codes.map(|code| u32::from(*code)).collect()
    }

    /// The words that DC terms are stored as: the nearest codes. Other coefficients have no place here.
    ///
    /// # Shapes
    /// in `sh_coeffs` \[rows,16,3\] coefficient-major
    ///
    /// # Errors
    /// [`EngineError::Usage`] for coefficients that do not fit.
    pub fn words_of(&self, rows: Option<&[u32]>, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        check_coeffs(self.count(rows), self.gaussians.sh_degree, sh_coeffs)?;
        let coeffs = sh_coeffs.chunks_exact(SH_FLOATS).flat_map(|splat| &splat[..CHANNELS]);
        let stored = self.words(rows);
        Ok(coeffs.zip(stored).map(|(dc, stored)| self.codebook.nearest(*dc, stored.to_le_bytes()[0]).into()).collect())
    }

    /// The coefficients that words are read as, with those behind the DC terms as they are in the file.
    ///
    /// # Shapes
    /// out \[rows,16,3\] coefficient-major
    #[must_use]
    pub fn coeffs_of(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<f32> {
        let mut coeffs = coeffs_of_rows(&self.gaussians.sh_coeffs, rows);
        for (splat, words) in coeffs.chunks_exact_mut(SH_FLOATS).zip(words.chunks_exact(CHANNELS)) {
            for (coeff, word) in splat.iter_mut().zip(words) {
                *coeff = self.codebook.values[usize::from(word.to_le_bytes()[0])];
            }
        }
        coeffs
    }

    /// The file with other words in the places of [`SogFile::words`]; as read when they are the same.
    #[must_use]
    pub fn with_words(&self, rows: Option<&[u32]>, words: &[u32]) -> Vec<u8> {
        let mut texels = self.texture.as_raw().clone();
        for (index, splat) in words.chunks_exact(CHANNELS).enumerate() {
            for (code, word) in texels[place(rows, index)..].iter_mut().zip(splat) {
                *code = word.to_le_bytes()[0];
            }
        }
        if texels == *self.texture.as_raw() {
            return self.bytes.clone();
        }
        let (width, height) = self.texture.dimensions();
        let mut packed = Vec::new();
        WebPEncoder::new_lossless(&mut packed)
            .encode(&texels, width, height, ExtendedColorType::Rgba8)
            .expect("the sides were checked, and memory takes any number of bytes");
        let archive = Archive::open(&self.path, &self.bytes);
        let written = archive.and_then(|mut archive| archive.with_entry(&self.name, &packed));
        written.expect("the archive was written when it was parsed")
    }

    fn count(&self, rows: Option<&[u32]>) -> usize {
        rows.map_or(self.splats(), <[u32]>::len)
    }
}

/// Where the texel of the `index`-th of `rows` is.
fn place(rows: Option<&[u32]>, index: usize) -> usize {
    4 * rows.map_or(index, |rows| rows[index] as usize)
}

/// What codes mean.
#[derive(Clone, Debug)]
struct Codebook {
    values: [f32; CODES],
    /// The codes that mean numbers, by these.
    ascending: Vec<u8>,
}

impl Codebook {
    fn new(values: [f32; CODES]) -> Self {
        let value = |code: &u8| values[usize::from(*code)];
        let mut ascending: Vec<u8> = (0..=u8::MAX).filter(|code| value(code).is_finite()).collect();
        ascending.sort_by(|a, b| value(a).total_cmp(&value(b)));
        Self { values, ascending }
    }

    fn value(&self, code: u8) -> f32 {
        self.values[usize::from(code)]
    }

    /// The code whose value is nearest; the stored one where that means this value, as another might too.
    fn nearest(&self, value: f32, stored: u8) -> u8 {
        if self.value(stored) == value {
            return stored;
        }
        let above = self.ascending.partition_point(|&code| self.value(code) < value);
        let around = &self.ascending[above.saturating_sub(1)..(above + 1).min(self.ascending.len())];
        let distance = |code: u8| (self.value(code) - value).abs();
        around.iter().copied().min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(stored)
    }
}

/// Reads the splats.
///
/// # Errors
/// [`EngineError::BadData`] for another version, a texture that is missing, undecodable or too small, and codes or
/// palette entries that do not exist.
pub fn decode(path: &Path, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    let (mut reader, meta) = Reader::open(path, bytes)?;
    reader.gaussians(&meta)
}

struct Reader<'a> {
    path: &'a Path,
    archive: Archive<'a>,
    file_bytes: usize,
    splats: usize,
}

impl<'a> Reader<'a> {
    /// Also what the archive says of itself.
    fn open(path: &'a Path, bytes: &'a [u8]) -> Result<(Self, Meta), EngineError> {
        let mut archive = Archive::open(path, bytes)?;
        let json = archive.read(META, MAX_JSON_BYTES)?;
        let meta: Meta = crate::base::json::parse(path, META, &json, "a SOG description of version 2")?;
        if meta.version != Some(VERSION) {
            let got = meta.version.map_or_else(|| "none".to_owned(), |version| version.to_string());
            return Err(bad_data(path, format!("{META}, `version`"), got, VERSION));
        }
        check_splats(path, "`count`", meta.count, MIN_BYTES_PER_SPLAT, bytes.len())?;
        Ok((Self { path, archive, file_bytes: bytes.len(), splats: meta.count }, meta))
    }

    fn gaussians(&mut self, meta: &Meta) -> Result<Gaussians, EngineError> {
        let sh_degree = meta.rest.as_ref().map_or(0, |palette| palette.bands);
        if sh_degree > MAX_SH_DEGREE {
            return Err(bad_data(self.path, "`shN.bands`", sh_degree, format!("0 to {MAX_SH_DEGREE}")));
        }
        let mut gaussians = with_capacity(meta.count, sh_degree);
        self.means(&meta.means, &mut gaussians)?;
        self.quats(&meta.quats, &mut gaussians)?;
        self.scales(&meta.scales, &mut gaussians)?;
        self.colours(&meta.sh0, &mut gaussians)?;
        if let Some(palette) = meta.rest.as_ref().filter(|palette| palette.bands > 0) {
            self.rest(palette, &mut gaussians)?;
        }
        Ok(gaussians)
    }

    /// The pixels of a texture, as many rows of four bytes as there are splats.
    fn texels(&mut self, name: &str) -> Result<Vec<u8>, EngineError> {
        let image = self.texture(name)?;
        let pixels = image.width() as usize * image.height() as usize;
        if pixels < self.splats {
            let expected = format!("at least {}, one for each splat", self.splats);
            return Err(bad_data(self.path, format!("pixels of `{name}`"), pixels, expected));
        }
        let mut texels = image.into_raw();
        texels.truncate(4 * self.splats);
        Ok(texels)
    }

    fn texture(&mut self, name: &str) -> Result<RgbaImage, EngineError> {
        let bytes = self.archive.read(name, self.file_bytes)?;
        let path = self.path;
        let undecodable = |error: image::ImageError| bad_data(path, format!("`{name}`"), error, "a WebP image");
        let decoder = WebPDecoder::new(Cursor::new(&bytes)).map_err(undecodable)?;
        let (width, height) = decoder.dimensions();
        let pixels = width as usize * height as usize;
        let most = (MAX_PIXELS_PER_SPLAT * self.splats.max(self.file_bytes)).max(MIN_MAX_PIXELS);
        if pixels > most {
            return Err(bad_data(path, format!("pixels of `{name}`"), pixels, format!("at most {most}")));
        }
        let image = image::DynamicImage::from_decoder(decoder).map_err(undecodable)?;
        Ok(image.into_rgba8())
    }

    fn means(&mut self, means: &Means, gaussians: &mut Gaussians) -> Result<(), EngineError> {
        let [low, high] = &means.files;
        let (low, high) = (self.texels(low)?, self.texels(high)?);
        for (low, high) in low.chunks_exact(4).zip(high.chunks_exact(4)) {
            gaussians.means.push(std::array::from_fn(|axis| {
                let unit = f64::from(u16::from_le_bytes([low[axis], high[axis]])) / f64::from(u16::MAX);
                let log = means.mins[axis] + (means.maxs[axis] - means.mins[axis]) * unit;
                narrow(log.abs().exp_m1().copysign(log))
            }));
        }
        Ok(())
    }

    fn quats(&mut self, quats: &Plain, gaussians: &mut Gaussians) -> Result<(), EngineError> {
        let [name] = &quats.files;
        for (row, texel) in self.texels(name)?.chunks_exact(4).enumerate() {
            let Some(largest) = texel[3].checked_sub(FIRST_TAG) else {
                let field = format!("`{name}`, rotation of splat {row}");
                return Err(bad_data(self.path, field, format!("tag {}", texel[3]), "252 to 255"));
            };
            let part = |i: usize| (f32::from(texel[i]) / 255.0 - 0.5) * std::f32::consts::SQRT_2;
            gaussians.quats.push(with_largest(usize::from(largest), [part(0), part(1), part(2)]));
        }
        Ok(())
    }

    fn scales(&mut self, scales: &Coded, gaussians: &mut Gaussians) -> Result<(), EngineError> {
        let codes = self.codebook("`scales.codebook`", &scales.codebook)?;
        let [name] = &scales.files;
        let texels = self.texels(name)?;
        let coded = |texel: &[u8]| std::array::from_fn(|axis| codes[usize::from(texel[axis])]);
        gaussians.scales.extend(texels.chunks_exact(4).map(coded));
        Ok(())
    }

    fn colours(&mut self, sh0: &Coded, gaussians: &mut Gaussians) -> Result<(), EngineError> {
        let codes = self.codebook(SH0_CODES, &sh0.codebook)?;
        let [name] = &sh0.files;
        let texels = self.texels(name)?;
        for (texel, sh_coeffs) in texels.chunks_exact(4).zip(gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS)) {
            for (coeff, code) in sh_coeffs.iter_mut().zip(&texel[..CHANNELS]) {
                *coeff = codes[usize::from(*code)];
            }
            gaussians.opacities.push(logit_of_byte(texel[CHANNELS]));
        }
        Ok(())
    }

    /// SH behind the DC terms: each splat has an entry of the palette, each value of an entry a code.
    fn rest(&mut self, palette: &Palette, gaussians: &mut Gaussians) -> Result<(), EngineError> {
        let codes = self.codebook("`shN.codebook`", &palette.codebook)?;
        let [entries, labels] = &palette.files;
        if !(1..=MAX_PALETTE).contains(&palette.count) {
            return Err(bad_data(self.path, "`shN.count`", palette.count, format!("1 to {MAX_PALETTE}")));
        }
        let image = self.texture(entries)?;
        let bases = sh_bases(palette.bands) - 1;
        let (width, height) = (image.width() as usize, image.height() as usize);
        let rows = palette.count.div_ceil(PALETTE_COLUMNS);
        if width != PALETTE_COLUMNS * bases || height < rows {
            let expected = format!("{} x {rows} or higher, for {} entries", PALETTE_COLUMNS * bases, palette.count);
            return Err(bad_data(self.path, format!("size of `{entries}`"), format!("{width} x {height}"), expected));
        }
        // An entry's bases lie side by side, and the entries of a row too.
        let values: Vec<f32> = image
            .as_raw()
            .chunks_exact(4)
            .flat_map(|texel| &texel[..CHANNELS])
            .map(|code| codes[usize::from(*code)])
            .collect();
        let floats = rest_floats(palette.bands);
        let texels = self.texels(labels)?;
        let splats = texels.chunks_exact(4).zip(gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS));
        for (row, (texel, sh_coeffs)) in splats.enumerate() {
            let entry = usize::from(u16::from_le_bytes([texel[0], texel[1]]));
            if entry >= palette.count {
                let field = format!("`{labels}`, entry of splat {row}");
                return Err(bad_data(self.path, field, entry, format!("less than {}", palette.count)));
            }
            sh_coeffs[CHANNELS..CHANNELS + floats].copy_from_slice(&values[floats * entry..floats * (entry + 1)]);
        }
        Ok(())
    }

    fn codebook(&self, field: &str, codes: &[f64]) -> Result<[f32; CODES], EngineError> {
        let codes: Vec<f32> = codes.iter().copied().map(narrow).collect();
        let wrong = |codes: Vec<f32>| bad_data(self.path, field, format!("{} values", codes.len()), CODES);
        codes.try_into().map_err(wrong)
    }
}
