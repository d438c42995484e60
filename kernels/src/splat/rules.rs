//! How splats reach pixels: where one renderer differs from another.

/// What becomes of opacity where a splat is widened to be seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Opacity {
    /// It stays.
    Kept,
    /// It falls as the area grows: times the square root of the ratio of determinants, without and with the dilation
    /// (Yu et al. 2024, "Mip-Splatting").
    Compensated,
}

/// Which pixels a splat may reach beside what its falloff says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// Those of the 16 x 16 tiles that meet the square of three standard deviations about it.
    Tiles,
    /// All of them.
    Image,
}

/// What splats are sorted by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SortKey {
    /// Depth along the axis of the camera.
    Depth,
    /// Distance to the camera.
    Distance,
    /// Depth in buckets, more of them near the camera ([`super::bucket`]).
    Buckets,
}

/// What a pixel does with the splat that would leave it less than 1e-4 of transmittance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// It ends before that splat.
    Before,
    /// It ends behind it, as if all that follow were drawn too.
    Behind,
}

/// What a picture is blended in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Framebuffer {
    /// Numbers that nothing is rounded in.
    Floats,
    /// 8 bits a channel, back to front: every splat is rounded in.
    Bytes,
}

/// How splats are projected and blended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Added to both variances of a splat on the image, px².
    pub dilation: f32,
    /// What the dilation does to opacity.
    pub opacity: Opacity,
    /// Half the difference of the variances along a splat's axes is at least this, px².
    pub min_split: f32,
    /// Variance along the shorter axis is at least this, px².
    pub min_minor: f32,
    /// A splat of a smaller variance along the longer axis is not drawn, px².
    pub min_major: f32,
    /// Directions are cut at so many times the half image where a splat's shape is worked out.
    pub margin: f32,
    /// A splat whose centre is farther from the image's than so many times the half image is not drawn.
    pub guard: f32,
    /// Which pixels may be reached.
    pub extent: Extent,
    /// Standard deviations at which falloff ends.
    pub reach: f32,
    /// Falloff is `(exp(-d²/2) - foot) / (1 - foot)`, d in standard deviations; from 0 to below 1.
    pub foot: f32,
    /// Largest value of a splat's colour channels.
    pub max_colour: f32,
    /// A splat's alpha below this is none.
    pub min_alpha: f32,
    /// Largest alpha.
    pub max_alpha: f32,
    /// Where a pixel ends.
    pub stop: Stop,
    /// What comes first.
    pub sort_key: SortKey,
    /// What pictures are blended in.
    pub framebuffer: Framebuffer,
}

impl Rules {
    /// The rasteriser of Kerbl et al. 2023.
    pub const REFERENCE: Self = Self {
        dilation: 0.3,
        opacity: Opacity::Kept,
        min_split: 0.0,
        min_minor: 0.0,
        min_major: 0.0,
        margin: 1.3,
        guard: f32::INFINITY,
        extent: Extent::Tiles,
        reach: f32::INFINITY,
        foot: 0.0,
        max_colour: f32::INFINITY,
        min_alpha: 1.0 / 255.0,
        max_alpha: 0.99,
        stop: Stop::Before,
        sort_key: SortKey::Depth,
        framebuffer: Framebuffer::Floats,
    };

    /// 1 where the kernels' own constants say all of it.
    pub(super) fn plain(&self) -> u32 {
        u32::from(*self == Self::REFERENCE)
    }

    /// As a shader compares with it: an exponent of base 2, not negative.
    pub(super) fn span(&self) -> f32 {
        0.5 * std::f32::consts::LOG2_E * self.reach * self.reach
    }
}

impl Default for Rules {
    fn default() -> Self {
        Self::REFERENCE
    }
}
