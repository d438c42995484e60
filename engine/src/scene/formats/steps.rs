//! Values in steps: what is between two bytes.

/// How far a value may be from a byte and still be that byte: computing in floats moves it by 3e-5 at most.
const NEAR: f32 = 1e-3;
/// Each row goes on by the golden section, so that rows of any stretch of a file spread evenly between the steps; each
/// column begins elsewhere, by the root of x³ = x + 1 (the plastic number, which does the same in two dimensions).
const PER_ROW: f64 = 0.618_033_988_749_895;
const PER_COLUMN: f64 = 0.754_877_666_246_693;

/// The byte nearest to `steps`.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
pub(in crate::scene) fn nearest_byte(steps: f32) -> u8 {
    steps.round().clamp(0.0, 255.0) as u8
}

/// One of the two bytes around `steps`, the upper one as often as `steps` is above the lower one. A mark is fainter
/// than a step: on colours that lie on steps already, rounding to the nearest would take all of it away, and this
/// leaves its mean.
#[allow(clippy::cast_precision_loss, reason = "which of two bytes a row far down gets is a draw either way")]
pub(super) fn dithered_byte(steps: f32, row: usize, column: usize) -> u8 {
    if (steps - steps.round()).abs() < NEAR {
        return nearest_byte(steps);
    }
    let draw = (row as f64 * PER_ROW + column as f64 * PER_COLUMN).fract();
    nearest_byte(if f64::from(steps - steps.floor()) > draw { steps.ceil() } else { steps.floor() })
}
