//! The order in which people count files.

/// Sorts names with runs of digits as numbers, so that 9 comes before 10: text and number in turn; a number is its
/// digits without leading zeros, after their count.
pub fn key(name: &str) -> Vec<(String, usize, String)> {
    let mut key = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text_end = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(text_end);
        let digits_end = tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len());
        let (digits, tail) = tail.split_at(digits_end);
        let number = digits.trim_start_matches('0');
        key.push((text.to_owned(), number.len(), number.to_owned()));
        rest = tail;
    }
    key
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_sorted_by_their_numbers() {
        let mut names = ["take2_10.ply", "take2_9.ply", "take10_1.ply", "take2_009b.ply", "a.ply"];
        names.sort_by_cached_key(|name| key(name));
        assert_eq!(names, ["a.ply", "take2_9.ply", "take2_009b.ply", "take2_10.ply", "take10_1.ply"]);
    }
}
