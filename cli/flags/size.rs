//! Sizes of pictures as text.

use std::ops::RangeInclusive;

/// Sides of a picture in pixels.
const SIDES: RangeInclusive<u32> = 16..=8192;

/// Width and height in px of a picture, as WIDTHxHEIGHT.
pub(crate) fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let fits = parsed.filter(|(w, h)| SIDES.contains(w) && SIDES.contains(h));
    fits.ok_or_else(|| format!("`{text}`: expected WIDTHxHEIGHT, each from {} to {}", SIDES.start(), SIDES.end()))
}
