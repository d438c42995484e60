//! Where the values of an axis go, and which of them get a grid line.

use super::data::Axis;

/// About so many grid lines on an axis.
const GRID_LINES: f64 = 7.0;
/// Decades that a picture may span on either side of 1.
const DECADES: i32 = 12;

/// The values of an axis; logarithms of them on a logarithmic one.
#[derive(Clone, Debug)]
pub(super) struct Span {
    /// Value at the beginning of the axis.
    pub(super) low: f64,
    /// Value at its end.
    pub(super) high: f64,
    logarithmic: bool,
}

/// A value with a grid line, and what stands beside it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tick {
    pub(super) at: f64,
    pub(super) words: String,
}

impl Span {
    /// Room for values and a margin around them.
    pub(super) fn of(axis: &Axis, values: impl Iterator<Item = f64>) -> Self {
        let span = Self { low: f64::INFINITY, high: f64::NEG_INFINITY, logarithmic: axis.logarithmic };
        let Self { low, high, .. } = values
            .map(|v| span.bent(v))
            .filter(|v| v.is_finite())
            .fold(span.clone(), |s, v| Self { low: s.low.min(v), high: s.high.max(v), ..s });
        let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
        // Points do not sit on the frame, and a single value has room.
        let room = if high > low { 0.06 * (high - low) } else { 0.5 };
        Self { low: low - room, high: high + room, ..span }
    }

    /// Lines of names: line `i` is at `-i`, so that the first stands on top.
    pub(super) fn of_lines(count: usize) -> Self {
        Self { low: 0.5 - count.max(1) as f64, high: 0.5, logarithmic: false }
    }

    /// A value as the axis counts.
    pub(super) fn bent(&self, value: f64) -> f64 {
        if self.logarithmic { value.max(f64::MIN_POSITIVE).ln() } else { value }
    }

    /// Part of the axis before a value that it has bent.
    pub(super) fn part(&self, bent: f64) -> f64 {
        (bent - self.low) / (self.high - self.low)
    }

    /// Values with a grid line, the most of them whose words `fit`.
    pub(super) fn ticks(&self, fit: impl Fn(&[Tick]) -> bool) -> Vec<Tick> {
        let mut choices = if self.logarithmic { self.decades() } else { Vec::new() };
        let (low, high) = if self.logarithmic { (self.low.exp(), self.high.exp()) } else { (self.low, self.high) };
        choices.extend((1..=3).map(|few| self.steps(low, high, GRID_LINES / f64::from(few))));
        choices.into_iter().find(|ticks| ticks.len() > 1 && fit(ticks)).unwrap_or_default()
    }

    /// Values of 1, 2 or 5 times powers of ten, or powers alone, that have equal distances or nearly so.
    fn decades(&self) -> Vec<Vec<Tick>> {
        let of = |mantissas: &[f64], every: i32| -> Vec<Tick> {
            let powers = (-DECADES..=DECADES).filter(|power| power % every == 0);
            let values = powers.flat_map(|power| mantissas.iter().map(move |m| m * 10f64.powi(power)));
            let inside = values.map(|v| Tick { at: v.ln(), words: format!("{v}") });
            inside.filter(|tick| (self.low..=self.high).contains(&tick.at)).collect()
        };
        let choices = [of(&[1.0, 2.0, 5.0], 1), of(&[1.0], 1), of(&[1.0], 2), of(&[1.0], 4)];
        choices.into_iter().filter(|ticks| ticks.len() > 2).collect()
    }

    /// About `lines` round numbers from `low` to `high`, at equal distances.
    fn steps(&self, low: f64, high: f64, lines: f64) -> Vec<Tick> {
        let raw = (high - low) / lines;
        let decade = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|s| *s >= raw).unwrap_or(raw);
        let first = (low / step).ceil() * step;
        let values = std::iter::successors(Some(first), |v| Some(v + step)).take_while(|v| *v <= high).take(100);
        // Steps are 1, 2 or 5 times a power of ten: as many decimals as make them whole.
        let decimals = (0u8..12).find(|&digits| (step * 10f64.powi(digits.into())).fract() < 1e-6).unwrap_or(0);
        values.map(|v| Tick { at: self.bent(v), words: format!("{v:.*}", decimals.into()) }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(span: &Span, fit: impl Fn(&[Tick]) -> bool) -> Vec<String> {
        span.ticks(fit).into_iter().map(|tick| tick.words).collect()
    }

    #[test]
    fn ticks_are_round_numbers_inside() {
        let span = Span::of(&Axis::linear("x"), [41.0, 50.0].into_iter());
        assert_eq!(words(&span, |_| true), ["42", "44", "46", "48", "50"], "every other decibel");
        assert_eq!(words(&span, |ticks| ticks.len() < 5), ["45", "50"], "fewer where there is less room");
        let span = Span::of(&Axis::logarithmic("s"), [9.0, 120.0].into_iter());
        assert_eq!(words(&span, |_| true), ["10", "20", "50", "100"], "seconds");
        let span = Span::of(&Axis::logarithmic("s"), [11.0, 19.0].into_iter());
        assert_eq!(words(&span, |_| true), ["12", "14", "16", "18"], "less than a decade");
        let span = Span::of(&Axis::logarithmic("s"), [1e-4, 1e4].into_iter());
        assert_eq!(words(&span, |ticks| ticks.len() < 6), ["0.0001", "0.01", "1", "100", "10000"], "many decades");
    }

    #[test]
    fn without_values_and_with_one_there_is_still_an_axis() {
        for values in [&[][..], &[f64::NAN], &[3.0], &[0.0]] {
            for axis in [Axis::linear("x"), Axis::logarithmic("x")] {
                let span = Span::of(&axis, values.iter().copied());
                assert!(span.low < span.high && (span.high - span.low).is_finite(), "{values:?}: {span:?}");
            }
        }
    }
}
