//! SOG archives, version 2 (`PlayCanvas`, "The SOG Format"): lossless WebP textures, codebooks, and a palette for SH.

use std::io::Cursor;
use std::path::Path;

use image::codecs::webp::WebPDecoder;
use image::{ImageDecoder as _, RgbaImage};
use serde::Deserialize;

use super::archive::Archive;
use super::values::{logit_of_byte, rest_floats, with_capacity, with_largest};
use crate::base::files::bad_data;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, Gaussians, MAX_SH_DEGREE, SH_FLOATS, sh_bases};
use crate::scene::limits::{MAX_JSON_BYTES, MAX_PIXELS_PER_SPLAT, MIN_BYTES_PER_SPLAT, MIN_MAX_PIXELS, check_splats};

const META: &str = "meta.json";
const VERSION: u32 = 2;
/// Entries of a codebook: one for each value of a byte.
const CODES: usize = 256;
/// Palette entries in a row of the palette's texture.
const PALETTE_COLUMNS: usize = 64;
/// Most entries of the palette, whose numbers have 16 bits.
const MAX_PALETTE: usize = 1 << 16;
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

/// Reads the splats.
///
/// # Errors
/// [`EngineError::BadData`] for another version, a texture that is missing, undecodable or too small, and codes or
/// palette entries that do not exist.
pub fn decode(path: &Path, bytes: &[u8]) -> Result<Gaussians, EngineError> {
    let mut reader = Reader { path, archive: Archive::open(path, bytes)?, file_bytes: bytes.len(), splats: 0 };
    let json = reader.archive.read(META, MAX_JSON_BYTES)?;
    let meta: Meta = crate::base::json::parse(path, META, &json, "a SOG description of version 2")?;
    if meta.version != Some(VERSION) {
        let got = meta.version.map_or_else(|| "none".to_owned(), |version| version.to_string());
        return Err(bad_data(path, format!("{META}, `version`"), got, VERSION));
    }
    check_splats(path, "`count`", meta.count, MIN_BYTES_PER_SPLAT, bytes.len())?;
    reader.splats = meta.count;
    let sh_degree = meta.rest.as_ref().map_or(0, |palette| palette.bands);
    if sh_degree > MAX_SH_DEGREE {
        return Err(bad_data(path, "`shN.bands`", sh_degree, format!("0 to {MAX_SH_DEGREE}")));
    }
    let mut gaussians = with_capacity(meta.count, sh_degree);
    reader.means(&meta.means, &mut gaussians)?;
    reader.quats(&meta.quats, &mut gaussians)?;
    reader.scales(&meta.scales, &mut gaussians)?;
    reader.colours(&meta.sh0, &mut gaussians)?;
    if let Some(palette) = meta.rest.filter(|palette| palette.bands > 0) {
        reader.rest(&palette, &mut gaussians)?;
    }
    Ok(gaussians)
}

struct Reader<'a> {
    path: &'a Path,
    archive: Archive<'a>,
    file_bytes: usize,
    splats: usize,
}

impl Reader<'_> {
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
        let codes = self.codebook("`sh0.codebook`", &sh0.codebook)?;
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
