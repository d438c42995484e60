//! JSON that came from outside, and that goes there.

use std::fmt::Display;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::files::bad_data;
use crate::error::EngineError;

/// Most arrays and objects inside each other; real files have a dozen. Less than the parser itself allows (128), so
/// that what is too deep is called so.
pub const MAX_JSON_DEPTH: usize = 64;

/// Parses `json`, which stands in `field` of the file at `path`.
///
/// # Errors
/// [`EngineError::BadData`] when it is nested deeper than [`MAX_JSON_DEPTH`], malformed, or not what was `expected`.
pub(crate) fn parse<'a, T: Deserialize<'a>>(
    path: &Path,
    field: impl Display,
    json: &'a [u8],
    expected: impl Display,
) -> Result<T, EngineError> {
    if depth(json) > MAX_JSON_DEPTH {
        let expected = format!("at most {MAX_JSON_DEPTH} arrays and objects inside each other");
        return Err(bad_data(path, field, "deeper nested ones", expected));
    }
    serde_json::from_slice(json).map_err(|error| bad_data(path, field, error, expected))
}

/// `value` as an indented text of JSON that ends its last line.
///
/// # Panics
/// If a map of `value` has keys other than strings.
pub(crate) fn to_file<T: Serialize>(value: &T) -> Vec<u8> {
    let mut text = serde_json::to_vec_pretty(value).expect("names are strings, and nothing else fails");
    text.push(b'\n');
    text
}

/// How many brackets are open at once.
fn depth(json: &[u8]) -> usize {
    let (mut open, mut most, mut in_string, mut escaped) = (0_usize, 0, false, false);
    for &byte in json {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if in_string => escaped = true,
            b'"' => in_string = !in_string,
            b'[' | b'{' if !in_string => {
                open += 1;
                most = most.max(open);
            }
            b']' | b'}' if !in_string => open = open.saturating_sub(1),
            _ => {}
        }
    }
    most
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brackets_count_outside_strings_only() {
        assert_eq!(depth(br#"{"a": [[1], "[[[[\"[", {}]}"#), 3);
        assert_eq!(depth(b"]]]["), 1, "damaged");
    }

    #[test]
    fn what_is_too_deep_is_called_so() {
        let nested = |depth: usize| [b"[".repeat(depth), b"]".repeat(depth)].concat();
        let parse = |depth| parse::<serde_json::Value>(Path::new("deep.json"), "json", &nested(depth), "a list");
        assert!(parse(MAX_JSON_DEPTH).is_ok(), "just so");
        let error = parse(MAX_JSON_DEPTH + 1).expect_err("too deep").to_string();
        assert!(error.contains("deep.json") && error.contains("at most 64"), "{error}");
        // A parser that followed each bracket would run out of stack.
        assert!(parse(10_000_000).is_err(), "hostile");
    }
}
