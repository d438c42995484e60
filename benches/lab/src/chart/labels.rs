//! Where the words beside points go: near their point, over no other words, and with a line to it when they are not.

use super::words::{Area, FONT_PX, Line, width};

/// Distances from a point that words are tried at, px.
const DISTANCES: [f64; 13] = [7.0, 12.0, 18.0, 26.0, 36.0, 48.0, 62.0, 78.0, 96.0, 116.0, 140.0, 170.0, 210.0];
/// Directions that they are tried in.
const DIRECTIONS: u8 = 24;
/// Nearer words need no line, px.
const NEAR_PX: f64 = 13.0;
/// Side of the square that a point keeps free, px.
const DOT_PX: f64 = 11.0;
/// Room between a point and its line, px.
const GAP_PX: f64 = 5.0;
/// Points whose labels compete for the same room are nearer than this, px.
const CROWD_PX: f64 = 70.0;
/// How often every label may find itself a better place once the others have one.
const PASSES: usize = 4;
/// What each fault of a place weighs against a pixel of distance.
const CROSSED_WORDS: f64 = 120.0;
const CROSSED_LEADER: f64 = 60.0;
const TOUCHED_DOT: f64 = 40.0;
const CROSSED_LINE: f64 = 15.0;
/// Whoever reads looks to the right of a point first.
const NOT_RIGHT: f64 = 3.0;

/// Words that want a place beside a point, px.
#[derive(Clone, Debug)]
pub(super) struct Wanted<'a> {
    pub(super) words: &'a str,
    pub(super) x: f64,
    pub(super) y: f64,
}

/// What is drawn already, px.
#[derive(Clone, Debug, Default)]
pub(super) struct Drawn {
    /// Middles of points: words keep away from them.
    pub(super) dots: Vec<[f64; 2]>,
    /// Ranges, and lines that join points: words avoid them where they can.
    pub(super) lines: Vec<Line>,
}

/// A place for words, and the line from it to the point.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) area: Area,
    pub(super) toward: Toward,
    pub(super) leader: Option<Line>,
}

/// Which end of the words is at their point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Toward {
    /// The first letter.
    Left,
    /// None: they stand above or below it.
    Middle,
    /// The last letter.
    Right,
}

/// Places in `frame` for each of `wanted`; `None` where the frame is full.
pub(super) fn places(wanted: &[Wanted<'_>], drawn: &Drawn, frame: &Area) -> Vec<Option<Place>> {
    let mut order: Vec<usize> = (0..wanted.len()).collect();
    let near = |i: &usize| {
        let apart = |other: &&Wanted<'_>| (other.x - wanted[*i].x).hypot(other.y - wanted[*i].y) < CROWD_PX;
        wanted.iter().filter(apart).count()
    };
    order.sort_by_cached_key(|i| std::cmp::Reverse(near(i)));
    let mut places: Vec<Option<Place>> = vec![None; wanted.len()];
    for _ in 0..PASSES {
        for &i in &order {
            places[i] = None;
            places[i] = best(&wanted[i], drawn, &places, frame);
        }
    }
    places
}

/// The best place for some words beside those that have one.
fn best(wanted: &Wanted<'_>, drawn: &Drawn, taken: &[Option<Place>], frame: &Area) -> Option<Place> {
    let directions = || (0..DIRECTIONS).map(|k| std::f64::consts::TAU * f64::from(k) / f64::from(DIRECTIONS));
    let candidates = DISTANCES.iter().flat_map(|d| directions().map(move |angle| (d, angle.cos(), angle.sin())));
    let rated = candidates.filter_map(|(distance, right, down)| {
        // An ellipse around the point for the middle of the words keeps their edge at this distance from it.
        let x = wanted.x + right * (distance + 0.5 * width(wanted.words));
        let y = wanted.y + down * (distance + 0.5 * FONT_PX);
        let area = Area::of_words(wanted.words, x, y);
        let toward = match wanted.x {
            x if x <= area.left => Toward::Left,
            x if x >= area.right => Toward::Right,
            _ => Toward::Middle,
        };
        let place = Place { area, toward, leader: (*distance > NEAR_PX).then(|| leader(wanted, &area)) };
        let faults = faults(&place, wanted, drawn, taken, frame)?;
        Some((distance + faults + if right > 0.9 { 0.0 } else { NOT_RIGHT }, place))
    });
    rated.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, place)| place)
}

/// The line from near the point to the nearest edge of the words.
fn leader(wanted: &Wanted<'_>, area: &Area) -> Line {
    let (x1, y1) = (wanted.x.clamp(area.left, area.right), wanted.y.clamp(area.top, area.bottom));
    let length = (x1 - wanted.x).hypot(y1 - wanted.y).max(GAP_PX);
    let share = GAP_PX / length;
    Line { x0: wanted.x + share * (x1 - wanted.x), y0: wanted.y + share * (y1 - wanted.y), x1, y1 }
}

/// What speaks against a place; `None` when it is none.
fn faults(place: &Place, wanted: &Wanted<'_>, drawn: &Drawn, taken: &[Option<Place>], frame: &Area) -> Option<f64> {
    let Place { area, leader, .. } = place;
    let dots = || drawn.dots.iter().map(|[x, y]| Area::around(*x, *y, DOT_PX));
    let others = || taken.iter().flatten();
    let is_over = others().any(|other| other.area.meets(area)) || dots().any(|dot| dot.meets(area));
    if is_over || !frame.holds(area) {
        return None;
    }
    let count = |faults: usize, weight: f64| weight * faults as f64;
    let crossed = drawn.lines.iter().filter(|line| area.is_crossed(line)).count();
    let under = others().filter_map(|other| other.leader).filter(|line| area.is_crossed(line)).count();
    let mut sum = count(crossed, CROSSED_LINE) + count(under, CROSSED_WORDS);
    if let Some(line) = leader {
        let own =
            |dot: &Area| dot.left < wanted.x && wanted.x < dot.right && dot.top < wanted.y && wanted.y < dot.bottom;
        sum += count(dots().filter(|dot| !own(dot) && dot.is_crossed(line)).count(), TOUCHED_DOT);
        sum += count(others().filter(|other| other.area.is_crossed(line)).count(), CROSSED_WORDS);
        let leaders = others().filter_map(|other| other.leader);
        sum += count(leaders.filter(|other| other.crosses(line)).count(), CROSSED_LEADER);
    }
    Some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Area = Area { left: 0.0, top: 0.0, right: 400.0, bottom: 300.0 };

    #[test]
    fn words_stand_right_of_a_lonely_point_without_a_line() {
        let wanted = [Wanted { words: "alone", x: 200.0, y: 150.0 }];
        let drawn = Drawn { dots: vec![[200.0, 150.0]], lines: Vec::new() };
        let place = places(&wanted, &drawn, &FRAME).remove(0).expect("there is room");
        assert!(place.leader.is_none() && place.area.left > 200.0, "{place:?}");
    }

    #[test]
    fn words_of_points_on_top_of_each_other_do_not_meet_and_what_finds_no_room_is_told() {
        let of = |count: usize| {
            let wanted = vec![Wanted { words: "the same place", x: 200.0, y: 150.0 }; count];
            let drawn = Drawn { dots: vec![[200.0, 150.0]], lines: Vec::new() };
            places(&wanted, &drawn, &FRAME)
        };
        for (count, all) in [(30, true), (150, false)] {
            let placed: Vec<Place> = of(count).into_iter().flatten().collect();
            assert_eq!(placed.len() == count, all, "{} of {count}", placed.len());
            for (i, one) in placed.iter().enumerate() {
                assert!(FRAME.holds(&one.area), "{one:?}");
                assert!(placed[..i].iter().all(|two| !two.area.meets(&one.area)), "{one:?}");
            }
        }
    }
}
