//! From what frames say by themselves to the parts of a film.

use guard4d_kernels::image::resize::ImageSize;

use super::part::{Look, Part, TURNS_DEG, Window};

/// How far a frame's own window may be from the median of the frames around it, in widths or as a logarithm: beyond, it
/// is of another shot.
const SAME_SHOT: f64 = 0.15;
/// Frames before and after one that say where its shot is just then.
const CLOSE: usize = 4;
/// Most that half of these may be off their median for that: twice what single frames are off.
const STEADY: f64 = 0.05;
/// Frames before and after one that are averaged with it: two seconds of most films.
const AROUND: usize = 48;
/// How far the windows of these may be from where the shot is just then: a film that moves on, or that is cut, shows
/// the asset elsewhere.
const NEAR: f64 = 0.06;
/// A window that is as near to the whole frame as this is taken for it, in sides and as a logarithm. Most films are
/// framed as training was, and nothing is to be lost there by measuring where the asset is; a mark bears to be off by
/// 8 % of a side in place and 12 % in size.
const USUAL: [f64; 2] = [0.06, 0.12];
/// Of the turns, the one of upright films.
const UPRIGHT: usize = TURNS_DEG.len() / 2;
/// A film is turned upright if that leaves at most this share of its squared distance from the known views.
const TELLS: f64 = 0.9;
/// Turns of fewer degrees are left as they are: a mark bears them, and they may be an error.
const LEAST_TURN_DEG: f64 = 3.0;

/// What the frames of a film, all of this size, are cut to: the mean of what those around each say, but for those that
/// are of another shot. What one frame says is off by a few hundredths of a side, as the asset is never quite as it was
/// in a known view; the errors of a film even out.
#[must_use]
pub fn settle(looks: &[Look], size: ImageSize) -> Vec<Part> {
    let whole = Window::whole(size);
    let settled = |(at, look): (usize, &Look)| {
        if let Look::Nothing(why) = look {
            return Part::Fallback(*why);
        }
        let around = |reach: usize| &looks[at.saturating_sub(reach)..(at + reach + 1).min(looks.len())];
        let Turn { number, turn_deg } = turn_of(around(AROUND));
        let windows = |looks: &[Look]| looks.iter().filter_map(|look| look.window(number)).collect::<Vec<_>>();
        let Some(own) = look.window(number) else { return Part::All };
        let centre = shot_of(own, &windows(around(CLOSE)));
        let near = windows(around(AROUND)).into_iter().filter(|window| window.apart(centre) <= NEAR);
        let window = mean_of(near).unwrap_or(own);
        let window = if window.is_near(whole, USUAL) { whole } else { window };
        let window = Window { turn_deg, ..window };
        if window == whole { Part::All } else { Part::Window(window) }
    };
    looks.iter().enumerate().map(settled).collect()
}

/// Where the shot of a frame is just then: the median of the frames close to it, if these agree. A frame that is unlike
/// them, or among frames that differ, speaks for itself.
fn shot_of(own: Window, close: &[Window]) -> Window {
    let median = middle_of(close);
    let mut off: Vec<f64> = close.iter().map(|window| window.apart(median)).collect();
    let middle = off.len() / 2;
    let is_steady = *off.select_nth_unstable_by(middle, f64::total_cmp).1 <= STEADY;
    if is_steady && own.apart(median) <= SAME_SHOT { median } else { own }
}

/// How a film is turned.
struct Turn {
    /// The nearest of the turns that were looked for.
    number: usize,
    /// Degrees counterclockwise.
    turn_deg: f64,
}

/// How frames are turned, told by all of them together: one by itself is often as much like another view, turned.
fn turn_of(near: &[Look]) -> Turn {
    let mut far = [0.0; TURNS_DEG.len()];
    for look in near {
        if let Look::Fits(fits) = look {
            far.iter_mut().zip(fits).for_each(|(sum, fit)| *sum += fit.distance);
        }
    }
    let upright = Turn { number: UPRIGHT, turn_deg: 0.0 };
    let nearest = far.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
    let Some((number, _)) = nearest.filter(|(_, least)| **least < TELLS * far[UPRIGHT]) else { return upright };
    let turn_deg = TURNS_DEG[number] + between(&far, number) * (TURNS_DEG[1] - TURNS_DEG[0]);
    if turn_deg.abs() < LEAST_TURN_DEG { upright } else { Turn { number, turn_deg } }
}

/// How far from entry `at` the lowest point is of the parabola through it and its neighbours, in entries.
fn between(values: &[f64], at: usize) -> f64 {
    let (Some(before), Some(after)) = (at.checked_sub(1).and_then(|i| values.get(i)), values.get(at + 1)) else {
        return 0.0;
    };
    let bend = before - 2.0 * values[at] + after;
    if bend > 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Median of each number by itself.
fn middle_of(windows: &[Window]) -> Window {
    let median = |of: &dyn Fn(&Window) -> f64| {
        let mut values: Vec<f64> = windows.iter().map(of).collect();
        let at = values.len() / 2;
        *values.select_nth_unstable_by(at, f64::total_cmp).1
    };
    Window {
        middle: [median(&|w| w.middle[0]), median(&|w| w.middle[1])],
        sides: [median(&|w| w.sides[0]), median(&|w| w.sides[1])],
        turn_deg: 0.0,
    }
}

fn mean_of(windows: impl Iterator<Item = Window>) -> Option<Window> {
    let mut mean = Window { middle: [0.0; 2], sides: [0.0; 2], turn_deg: 0.0 };
    let mut count = 0.0;
    for Window { middle, sides, .. } in windows {
        count += 1.0;
        for i in 0..2 {
            mean.middle[i] += (middle[i] - mean.middle[i]) / count;
            mean.sides[i] += (sides[i] - mean.sides[i]) / count;
        }
    }
    (count > 0.0).then_some(mean)
}
