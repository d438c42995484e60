//! What is left of a film's frame when the unmarked asset is taken off it, and where it counts.

use nalgebra::{Matrix4, Vector4};

use super::lowpass::{Pictures, as_kept};
use crate::base::numbers::narrow;
use crate::media::Frame;
use crate::media::frames::LUMA;
use crate::scene::gaussians::CHANNELS;

/// Largest difference of a pixel that counts, of 1. Marks are smaller, and codecs make mistakes that are larger: the
/// best of those tried on films through H.264.
const LIMIT: f32 = 0.02;
/// Largest difference of a channel that may be an owner's mark, of 1: what differs by more is something else that both
/// are shown, such as a logo. Without it films of fruit and robots read as well, and no better.
const OF_A_MARK: f32 = 0.05;
/// How far black or white has to be moved, of 1, for a film to have levels of its own.
const OTHER_LEVELS: f64 = 0.06;
/// Levels of an 8-bit channel that was not cut off.
const BETWEEN: std::ops::RangeInclusive<u8> = 2..=253;
/// Largest final transmittance of a pixel that shows enough of the asset.
const UNCOVERED: f32 = 0.98;
/// Least share of a picture that has to be background, and that has to be wholly covered, to tell another one.
const SEEN: f64 = 0.005;
/// Least final transmittance of a pixel that tells what is behind the asset.
const CLEAR: f32 = 0.5;
/// Largest final transmittance of a pixel that is wholly covered.
const COVERED: f32 = 0.1;
/// Levels, of 1, by which a background has to differ to be another.
const OTHER: f32 = 0.1;
/// How far a background may be from what is expected to be that: codecs and noise.
const EVEN: f32 = 0.06;
/// Percent of a background's pixels that tell how far it is from that: a logo in it is less than the rest.
const MOST: usize = 80;

/// What is behind the asset in one channel of a film, as far as that shows through.
struct Behind {
    /// By how much each clear enough pixel is lighter there than expected: by the levels of what is covered, or by the
    /// model's own, whichever is nearer. Films end at black and white, and so may a background that was made brighter;
    /// and what bends levels leaves both ends where they are.
    off: Vec<f32>,
    /// The film's levels, by what is covered.
    fit: Line,
}

impl Behind {
    /// None where too little of the asset, or too little beside it, is seen.
    fn seen(frame: &Frame, clean: &[f32], channel: usize) -> Option<Self> {
        let pixels =
            || levels(frame, clean, channel).zip(frame.rgb().chunks_exact(CHANNELS)).zip(clean.chunks_exact(4));
        let covered = pixels().filter(|((_, levels), pixel)| {
            pixel[CHANNELS] < COVERED && levels.iter().all(|level| BETWEEN.contains(level))
        });
        let covered: Vec<Level> = covered.map(|((level, _), _)| level).collect();
        let clear = pixels().filter(|(_, pixel)| pixel[CHANNELS] > CLEAR).count();
        if (clear.min(covered.len()) as f64) < SEEN * (clean.len() / 4) as f64 {
            return None;
        }
        let fit = Line::through(covered.into_iter());
        let off = |((Level { film, clean }, _), pixel): ((Level, &[u8]), &[f32])| {
            let clear = pixel[CHANNELS];
            let off = [clean, fit.at(clean)].map(|expected| (film - expected.clamp(0.0, 1.0)) / clear);
            (clear > CLEAR).then_some(if off[0].abs() < off[1].abs() { off[0] } else { off[1] })
        };
        let off = pixels().filter_map(off).collect();
        Some(Self { off, fit })
    }
}

/// The background of a film in the colours of the model, where it is not the model's own: its middle colour.
pub(super) fn background(frame: &Frame, clean: &[f32], own: [f32; 3]) -> Option<[f32; 3]> {
    let mut found = own;
    let mut is_other = false;
    for (channel, found) in found.iter_mut().enumerate() {
        let Behind { mut off, fit } = Behind::seen(frame, clean, channel)?;
        off.sort_by(f32::total_cmp);
        let middle = off[(off.len() - 1) / 2];
        if middle.abs() >= OTHER && fit.slope > 0.0 {
            is_other = true;
            *found = narrow(f64::from(*found) + f64::from(middle) / fit.slope).clamp(0.0, 1.0);
        }
    }
    is_other.then_some(found)
}

/// A film's difference to the unmarked asset in luma, pixel by pixel, and where it counts.
pub(super) struct Difference {
    pub limited: Vec<f32>,
    pub counted: Vec<bool>,
}

/// Film minus what the unmarked asset looks like there, after the exposure, contrast and bend that fit each channel
/// best.
pub(super) fn difference(frame: &Frame, clean: &[f32]) -> Difference {
    let counted = counted(frame, clean);
    let mut pictures = vec![[0.0f32; 2]; counted.len()];
    // A mark moves all three alike, and codecs keep what else there is at half the size or worse.
    for (channel, weight) in LUMA.into_iter().enumerate() {
        let levels = levels(frame, clean, channel);
        let fit = Curve::through(levels.clone().zip(&counted).filter(|(_, counted)| **counted).map(|(level, _)| level));
        for ([film, clean], level) in pictures.iter_mut().zip(levels) {
            *film += weight * level.film;
            *clean += weight * fit.at(level.clean);
        }
    }
    // What does not count is as the clean picture, so that no edge of it is taken for detail.
    let (film, clean): (Vec<f32>, Vec<f32>) = pictures
        .iter()
        .zip(&counted)
        .map(|([film, clean], counted)| (if *counted { *film } else { *clean }, *clean))
        .unzip();
    let width = frame.width() as usize;
    let kept = as_kept(&Pictures { film: &film, clean: &clean, counted: &counted, width });
    let limited = film
        .iter()
        .zip(kept)
        .zip(&counted)
        .map(|((film, kept), counted)| if *counted { (film - kept).clamp(-LIMIT, LIMIT) } else { 0.0 })
        .collect();
    Difference { limited, counted }
}

/// Pixels of the unmarked asset as the film shows them, red, green and blue; the film's own where they cannot be
/// compared.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a level from 0 to 255")]
pub(super) fn as_shown(frame: &Frame, clean: &[f32]) -> Vec<u8> {
    let counted = counted(frame, clean);
    let compared = (0..CHANNELS).flat_map(|channel| levels(frame, clean, channel).zip(&counted));
    let fit = Line::through(compared.filter(|(_, counted)| **counted).map(|(level, _)| level)).unless_as_it_is();
    let mut rgb = frame.rgb().to_vec();
    for channel in 0..CHANNELS {
        let pixels = rgb.chunks_exact_mut(CHANNELS).zip(levels(frame, clean, channel)).zip(&counted);
        for ((pixel, Level { film, clean }), _) in pixels.filter(|(_, counted)| **counted) {
            let level = film - (film - fit.at(clean)).clamp(-OF_A_MARK, OF_A_MARK);
            pixel[channel] = (255.0 * level.clamp(0.0, 1.0)).round() as u8;
        }
    }
    rgb
}

/// Where film and asset can be compared.
pub(super) fn counted(frame: &Frame, clean: &[f32]) -> Vec<bool> {
    let clearest = clearest(frame, clean);
    let pixels = frame.rgb().chunks_exact(CHANNELS).zip(clean.chunks_exact(4));
    let counts = |(levels, pixel): (&[u8], &[f32])| {
        levels.iter().all(|level| BETWEEN.contains(level)) && pixel[CHANNELS] <= clearest
    };
    pixels.map(counts).collect()
}

/// The largest final transmittance of pixels that count. Where a film has something else behind the asset, what shows
/// through is a difference of its own: the more that is, the less of it may show through.
fn clearest(frame: &Frame, clean: &[f32]) -> f32 {
    let channels: Option<Vec<Behind>> = (0..CHANNELS).map(|channel| Behind::seen(frame, clean, channel)).collect();
    let Some(channels) = channels else { return UNCOVERED };
    let luma = |at: usize| channels.iter().zip(LUMA).map(|(behind, weight)| weight * behind.off[at]).sum::<f32>();
    let mut off: Vec<f32> = (0..channels[0].off.len()).map(|at| luma(at).abs()).collect();
    off.sort_by(f32::total_cmp);
    let most = off[off.len() * MOST / 100];
    if most > EVEN { (LIMIT / most).min(UNCOVERED) } else { UNCOVERED }
}

/// A channel of all pixels.
fn levels<'a>(frame: &'a Frame, clean: &'a [f32], channel: usize) -> impl Iterator<Item = Level> + Clone + use<'a> {
    let pixels = frame.rgb().chunks_exact(CHANNELS).zip(clean.chunks_exact(4));
    pixels.map(move |(levels, pixel)| Level { film: f32::from(levels[channel]) / 255.0, clean: pixel[channel] })
}

/// A channel of a pixel.
#[derive(Clone, Copy)]
struct Level {
    film: f32,
    clean: f32,
}

/// film ≈ slope·clean + start
struct Line {
    slope: f64,
    start: f64,
}

impl Line {
    /// The least squares; film = clean where that does not vary.
    fn through(levels: impl Iterator<Item = Level>) -> Self {
        let (mut n, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for Level { film, clean } in levels {
            let (film, clean) = (f64::from(film), f64::from(clean));
            n += 1.0;
            x += clean;
            y += film;
            xx += clean * clean;
            xy += clean * film;
        }
        let n = f64::max(n, 1.0);
        let (x, y) = (x / n, y / n);
        let (xx, xy) = (xx / n - x * x, xy / n - x * y);
        if xx <= f64::EPSILON {
            return Self { slope: 1.0, start: 0.0 };
        }
        Self { slope: xy / xx, start: y - xy / xx * x }
    }

    fn at(&self, clean: f32) -> f32 {
        narrow(self.slope * f64::from(clean) + self.start)
    }

    /// Film = clean, unless levels are plainly others: a mark moves them a little, too, and is not to be taken for it.
    fn unless_as_it_is(self) -> Self {
        let at_ends = [self.start, self.slope + self.start - 1.0];
        if at_ends.iter().any(|off| off.abs() > OTHER_LEVELS) { self } else { Self { slope: 1.0, start: 0.0 } }
    }
}

/// film ≈ Σ a·P(2·clean − 1), over the first four of Legendre's polynomials: exposure, contrast, and a bend such as a
/// power of each level.
struct Curve(Vector4<f64>);

/// What is added to each polynomial's sum of squares, of the number of levels: where levels leave one open, it is none.
const RIDGE: f64 = 1e-6;

impl Curve {
    /// The least squares; film = clean where there is nothing to fit.
    fn through(levels: impl Iterator<Item = Level>) -> Self {
        let (mut normal, mut right, mut n) = (Matrix4::zeros(), Vector4::zeros(), 0.0);
        for Level { film, clean } in levels {
            let row = Self::row(clean);
            normal += row * row.transpose();
            right += row * f64::from(film - clean);
            n += 1.0;
        }
        let normal = normal + Matrix4::identity() * (RIDGE * n);
        let off = normal.cholesky().map_or_else(Vector4::zeros, |factor| factor.solve(&right));
        // clean = 1/2 + (2·clean − 1)/2
        Self(off + Vector4::new(0.5, 0.5, 0.0, 0.0))
    }

    fn at(&self, clean: f32) -> f32 {
        narrow(self.0.dot(&Self::row(clean)))
    }

    fn row(clean: f32) -> Vector4<f64> {
        let x = 2.0 * f64::from(clean) - 1.0;
        Vector4::new(1.0, x, 1.5 * x * x - 0.5, 2.5 * x * x * x - 1.5 * x)
    }
}
