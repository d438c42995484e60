//! The canonical splats of a scene, as stored: before any activation.

use crate::base::numbers::narrow;
use crate::error::EngineError;

/// Highest SH degree that a splat can store.
pub const MAX_SH_DEGREE: u32 = 3;

/// SH bases up to [`MAX_SH_DEGREE`], per colour channel.
pub const MAX_SH_BASES: usize = sh_bases(MAX_SH_DEGREE);

/// Colour channels of an SH coefficient.
pub const CHANNELS: usize = 3;

/// SH constant Y₀: colour per unit of DC coefficient.
pub const Y0: f64 = 0.282_094_79;

/// Floats of SH per splat in [`Gaussians::sh_coeffs`].
pub const SH_FLOATS: usize = MAX_SH_BASES * CHANNELS;

/// Number of SH bases up to and including `degree`.
#[must_use]
pub const fn sh_bases(degree: u32) -> usize {
    let rows = degree as usize + 1;
    rows * rows
}

/// How opaque a splat is of whose opacity this is the logit, 0 to 1.
#[must_use]
pub fn opacity_of(logit: f32) -> f64 {
    1.0 / (1.0 + f64::from(-logit).exp())
}

/// Splats as a structure of arrays; all values are raw (log scales, logit opacities, any-norm quaternions).
///
/// # Shapes
/// `means` \[N,3\] world units · `quats` \[N,4\] w,x,y,z · `scales` \[N,3\] natural log ·
/// `opacities` \[N\] logit · `sh_coeffs` \[N,16,3\] coefficient-major, zero above `sh_degree`
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// Canonical positions.
    pub means: Vec<[f32; 3]>,
    /// Rotations w,x,y,z as stored, not normalised.
    pub quats: Vec<[f32; 4]>,
    /// Natural logarithms of the standard deviations.
    pub scales: Vec<[f32; 3]>,
    /// Logits of the opacities.
    pub opacities: Vec<f32>,
    /// SH coefficients, [`SH_FLOATS`] per splat.
    pub sh_coeffs: Vec<f32>,
    /// Highest SH degree that the file stores, 0 to 3.
    pub sh_degree: u32,
}

impl Gaussians {
    /// Number of splats N.
    #[must_use]
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are no splats.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Whether the splat of row `row` can be drawn: all values are finite, and so are its standard deviations. A
    /// rotation of length zero is none, as in the renderers that such splats come from.
    #[must_use]
    pub fn is_sound(&self, row: usize) -> bool {
        let scales = self.scales[row].into_iter().chain(self.scales[row].map(f32::exp));
        let geometry = self.means[row].into_iter().chain(self.quats[row]).chain(scales);
        let colours = self.sh_coeffs[SH_FLOATS * row..SH_FLOATS * (row + 1)].iter().copied();
        geometry.chain([self.opacities[row]]).chain(colours).all(f32::is_finite)
    }

    /// Keeps the rows that `keep` holds.
    pub fn retain(&mut self, keep: &[bool]) {
        retain_rows(&mut self.means, keep);
        retain_rows(&mut self.quats, keep);
        retain_rows(&mut self.scales, keep);
        retain_rows(&mut self.opacities, keep);
        let floats: Vec<bool> = keep.iter().flat_map(|&keep| [keep; SH_FLOATS]).collect();
        retain_rows(&mut self.sh_coeffs, &floats);
    }

    /// Median of the means along each axis: the scene centre that a few stray splats cannot move.
    ///
    /// The upper median is taken for an even count; the origin is returned when there are no splats.
    #[must_use]
    pub fn median_centre(&self) -> [f32; 3] {
        std::array::from_fn(|axis| {
            let mut values: Vec<f32> = self.means.iter().map(|mean| mean[axis]).collect();
            if values.is_empty() {
                return 0.0;
            }
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        })
    }
}

/// DC coefficient of a plain colour, 0 to 1 unless it is brighter than white or darker than black.
pub(crate) fn dc_of_colour(colour: f32) -> f32 {
    narrow((f64::from(colour) - 0.5) / Y0)
}

/// Refuses coefficients that do not fit `splats` splats of this degree.
///
/// # Errors
/// [`EngineError::Usage`] for another length, values that are not finite, and values above the degree.
pub(super) fn check_coeffs(splats: usize, sh_degree: u32, sh_coeffs: &[f32]) -> Result<(), EngineError> {
    let usage =
        |got: String, expected: String| EngineError::Usage { what: "new SH coefficients".to_owned(), got, expected };
    let expected = splats * SH_FLOATS;
    if sh_coeffs.len() != expected {
        return Err(usage(format!("{} values", sh_coeffs.len()), format!("{expected} ({splats} splats)")));
    }
    let stored = sh_bases(sh_degree) * CHANNELS;
    for (row, splat) in sh_coeffs.chunks_exact(SH_FLOATS).enumerate() {
        if let Some(value) = splat.iter().find(|value| !value.is_finite()) {
            return Err(usage(format!("{value} at splat {row}"), "finite values".to_owned()));
        }
        if splat[stored..].iter().any(|&value| value != 0.0) {
            return Err(usage(
                format!("values above degree {sh_degree} at splat {row}"),
                "zeros, because the file has no place for them".to_owned(),
            ));
        }
    }
    Ok(())
}

/// Keeps the elements of `rows` that `keep` holds.
pub(super) fn retain_rows<T>(rows: &mut Vec<T>, keep: &[bool]) {
    let mut keep = keep.iter();
    rows.retain(|_| keep.next().copied().unwrap_or(false));
}
