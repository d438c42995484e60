//! Values as flags and files spell them, and the checks that all settings share.

use std::fmt::Display;
use std::str::FromStr;

use glam::DVec3;
use serde::de::DeserializeOwned;
use serde::de::value::StrDeserializer;

use crate::error::EngineError;

/// Sides of pictures in pixels.
const SIDES_PX: std::ops::RangeInclusive<u32> = 16..=8192;

/// A word of an enumeration, as files spell it.
///
/// # Errors
/// [`EngineError::Usage`] with all words that there are.
pub(super) fn word<T: DeserializeOwned>(what: &str, text: &str) -> Result<T, EngineError> {
    T::deserialize(StrDeserializer::<serde::de::value::Error>::new(text)).map_err(|error| {
        let said = error.to_string();
        let expected = said.split_once("expected ").map_or(said.as_str(), |(_, expected)| expected);
        EngineError::Usage { what: what.to_owned(), got: text.to_owned(), expected: expected.to_owned() }
    })
}

/// `WIDTHxHEIGHT` in pixels.
pub(super) fn size(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let fits = parsed.filter(|(w, h)| SIDES_PX.contains(w) && SIDES_PX.contains(h));
    let (least, most) = (SIDES_PX.start(), SIDES_PX.end());
    fits.ok_or_else(|| format!("`{text}`: expected WIDTHxHEIGHT, each from {least} to {most}"))
}

/// A point of the scene, `X,Y,Z`.
pub(super) fn point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(|n| n.is_finite()) => Ok([x, y, z]),
        _ => Err(format!("`{text}`: expected three numbers, X,Y,Z")),
    }
}

/// A direction, `X,Y,Z`, brought to the length 1.
pub(super) fn direction(text: &str) -> Result<[f64; 3], String> {
    let given = DVec3::from_array(point(text)?);
    given.try_normalize().map(|unit| unit.to_array()).ok_or_else(|| format!("`{text}`: expected a direction, X,Y,Z"))
}

/// A number in single precision, as flags of angles have always been read: marks of a seed hang on its last bits.
pub(super) fn single(text: &str) -> Result<f64, String> {
    text.parse::<f32>().map(f64::from).map_err(|error| format!("`{text}`: {error}"))
}

/// `LOW..HIGH`.
pub(super) fn range<T: FromStr>(text: &str) -> Result<(T, T), String> {
    let numbers = text.split_once("..").and_then(|(low, high)| Some((low.parse().ok()?, high.parse().ok()?)));
    numbers.ok_or_else(|| format!("`{text}`: expected two numbers, LOW..HIGH"))
}

/// Refuses a number that its setting cannot have.
///
/// # Errors
/// [`EngineError::Usage`] with what was expected, unless it `is_fine`.
pub(super) fn check(what: &str, got: impl Display, is_fine: bool, expected: &str) -> Result<(), EngineError> {
    if is_fine {
        return Ok(());
    }
    Err(EngineError::Usage { what: what.to_owned(), got: got.to_string(), expected: expected.to_owned() })
}

/// Refuses what is no weight: negative, or not finite.
///
/// # Errors
/// As [`check`].
pub(super) fn check_weight(what: &str, got: f32) -> Result<(), EngineError> {
    check(what, got, got.is_finite() && got >= 0.0, "a sensible number, not negative")
}
