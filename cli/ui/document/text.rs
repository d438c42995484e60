//! Words and numbers as the page shows them.

use std::path::Path;

/// Characters that change the direction of what stands beside them: a name could make the page say something else.
const TURNING: [char; 12] = [
    '\u{061c}', '\u{200e}', '\u{200f}', '\u{202a}', '\u{202b}', '\u{202c}', '\u{202d}', '\u{202e}', '\u{2066}',
    '\u{2067}', '\u{2068}', '\u{2069}',
];

/// A name that came from outside, without characters that nobody sees.
pub(super) fn plain(name: &str) -> String {
    let seen = |c: char| if c.is_control() || TURNING.contains(&c) { char::REPLACEMENT_CHARACTER } else { c };
    name.chars().map(seen).collect()
}

/// The last part of a path, in plain characters.
pub(super) fn file_name(path: &str) -> String {
    plain(&Path::new(path).file_name().map_or_else(|| path.into(), |name| name.to_string_lossy()))
}

/// How often something of probability `p` happens: "once in 65,536 times".
pub(super) fn once_in(p: f64) -> String {
    let times = 1.0 / p;
    let scales = [(1e15, "million billion"), (1e12, "thousand billion"), (1e9, "billion"), (1e6, "million")];
    if !times.is_finite() {
        return "less than can be counted".to_owned();
    }
    if times < 1.5 {
        return "always".to_owned();
    }
    if times >= 1e18 {
        return format!("once in 10^{:.0} times", times.log10().floor());
    }
    match scales.into_iter().find(|(scale, _)| times >= *scale) {
        Some((scale, name)) => format!("once in {:.1} {name} times", times / scale),
        None => format!("once in {} times", thousands(times)),
    }
}

/// A whole number with commas.
fn thousands(number: f64) -> String {
    let digits = format!("{number:.0}");
    let mut out = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rare_things_have_words() {
        let words = [(1.0, "always"), (0.5, "once in 2 times"), (2.0_f64.powi(-16), "once in 65,536 times")];
        for (p, want) in words {
            assert_eq!(once_in(p), want, "{p}");
        }
        assert_eq!(once_in(2.0_f64.powi(-32)), "once in 4.3 billion times");
        assert_eq!(once_in(2.0_f64.powi(-128)), "once in 10^38 times");
        assert_eq!((once_in(0.0), once_in(f64::NAN)), (once_in(f64::MIN_POSITIVE / 1e10), once_in(0.0)), "no number");
    }

    #[test]
    fn names_cannot_turn_the_words_beside_them() {
        assert_eq!(plain("a\u{202e}4pm.exe\n"), "a\u{fffd}4pm.exe\u{fffd}");
        assert_eq!(file_name("/home/me/über film.mp4"), "über film.mp4");
    }
}
