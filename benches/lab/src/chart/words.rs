//! How much room words take.
//!
//! A picture in SVG does not know the font that it will be shown in. The widths here are those of DejaVu Sans, one of
//! the widest fonts that a viewer takes for `sans-serif`, rounded up; in any other the words take less.

/// Size of all words, px.
pub(super) const FONT_PX: f64 = 12.0;
/// Room for a line of words, px.
pub(super) const LINE_PX: f64 = 15.0;

/// Width of words in px.
pub(super) fn width(words: &str) -> f64 {
    FONT_PX * words.chars().map(share).sum::<f64>()
}

/// Width of a character as a share of the font's size.
fn share(c: char) -> f64 {
    match c {
        'i' | 'j' | 'l' | '\'' => 0.29,
        ' ' | ',' | '.' => 0.33,
        'f' | 'r' | 't' | '-' | ':' | ';' | '/' | '(' | ')' | '|' => 0.42,
        'm' | 'w' | 'M' | 'W' | '%' | '@' | '+' | '<' | '>' | '=' => 1.0,
        'A'..='Z' => 0.79,
        c if c.is_ascii() => 0.65,
        // Two cells of a terminal are one em.
        _ => 1.0,
    }
}

/// A part of a picture, px; y runs downwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Area {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) right: f64,
    pub(super) bottom: f64,
}

impl Area {
    /// The area of `words` whose middle is at a point.
    pub(super) fn of_words(words: &str, middle_x: f64, middle_y: f64) -> Self {
        let (half_width, half_height) = (0.5 * width(words), 0.5 * LINE_PX);
        Self {
            left: middle_x - half_width,
            top: middle_y - half_height,
            right: middle_x + half_width,
            bottom: middle_y + half_height,
        }
    }

    /// The square of `side` around a point.
    pub(super) fn around(x: f64, y: f64, side: f64) -> Self {
        let half = 0.5 * side;
        Self { left: x - half, top: y - half, right: x + half, bottom: y + half }
    }

    /// Whether both share more than an edge.
    pub(super) fn meets(&self, other: &Self) -> bool {
        let beside = self.right <= other.left || other.right <= self.left;
        let above = self.bottom <= other.top || other.bottom <= self.top;
        !beside && !above
    }

    /// Whether all of `other` is inside.
    pub(super) fn holds(&self, other: &Self) -> bool {
        let wide = self.left <= other.left && other.right <= self.right;
        wide && self.top <= other.top && other.bottom <= self.bottom
    }

    /// Whether a line passes through.
    pub(super) fn is_crossed(&self, line: &Line) -> bool {
        // The part of the line, from 0 to 1, that is between left and right, and between top and bottom.
        let (mut first, mut last) = (0.0f64, 1.0f64);
        for (from, to, low, high) in
            [(line.x0, line.x1, self.left, self.right), (line.y0, line.y1, self.top, self.bottom)]
        {
            if from == to {
                if from <= low || from >= high {
                    return false;
                }
                continue;
            }
            let (a, b) = ((low - from) / (to - from), (high - from) / (to - from));
            first = first.max(a.min(b));
            last = last.min(a.max(b));
        }
        first < last
    }
}

/// A line from one point to another, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub(super) x0: f64,
    pub(super) y0: f64,
    pub(super) x1: f64,
    pub(super) y1: f64,
}

impl Line {
    /// Whether both cross.
    pub(super) fn crosses(&self, other: &Self) -> bool {
        let side =
            |line: &Self, x: f64, y: f64| (line.x1 - line.x0) * (y - line.y0) - (line.y1 - line.y0) * (x - line.x0);
        let parts = |one: &Self, two: &Self| side(one, two.x0, two.y0) * side(one, two.x1, two.y1) < 0.0;
        parts(self, other) && parts(other, self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_and_lines_meet_where_they_should() {
        let area = Area { left: 10.0, top: 10.0, right: 20.0, bottom: 20.0 };
        assert!(area.meets(&Area::around(20.0, 20.0, 2.0)), "a corner");
        assert!(!area.meets(&Area::around(21.0, 15.0, 2.0)), "an edge is no overlap");
        assert!(area.holds(&Area::around(15.0, 15.0, 10.0)) && !area.holds(&Area::around(16.0, 15.0, 10.0)), "inside");
        let line = |x0, y0, x1, y1| Line { x0, y0, x1, y1 };
        assert!(
            area.is_crossed(&line(0.0, 15.0, 30.0, 15.0)) && area.is_crossed(&line(12.0, 0.0, 18.0, 30.0)),
            "through"
        );
        assert!(
            !area.is_crossed(&line(0.0, 15.0, 9.0, 15.0)) && !area.is_crossed(&line(0.0, 25.0, 30.0, 25.0)),
            "short"
        );
        assert!(!area.is_crossed(&line(0.0, 15.0, 15.0, 0.0)), "past a corner");
        assert!(line(0.0, 0.0, 2.0, 2.0).crosses(&line(0.0, 2.0, 2.0, 0.0)), "a cross");
        assert!(!line(0.0, 0.0, 2.0, 2.0).crosses(&line(0.0, 0.0, 2.0, 0.0)), "a common end");
    }

    #[test]
    fn words_take_room_by_their_letters() {
        assert_eq!(width(""), 0.0);
        assert!(width("ill") < width("mmm") && width("bits right, %") < 12.0 * 13.0, "narrow and wide letters");
    }
}
