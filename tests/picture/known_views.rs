//! Films are framed as the known views were, from frames alone, and bad frames are shown whole.

use guard4d_engine::media::Frame;
use guard4d_engine::picture::foreground::NotFound;
use guard4d_engine::picture::known_views::KnownViews;
use guard4d_engine::picture::part::{Framings, Look, Part, Window};
use guard4d_engine::picture::settle::settle;
use guard4d_kernels::image::resize::ImageSize;

use super::foreground::{Disc, picture, turned};

const SIDE: u32 = 160;

/// An asset of a body and a head that leans as far as `lean` says, as a frame shows it that is `zoom` times as near and
/// looks `off` pixels beside it.
fn asset(size: [u32; 2], lean: f64, zoom: f64, off: [f64; 2]) -> Frame {
    let middle = [0, 1].map(|i| f64::from(size[i]) / 2.0 + off[i]);
    let at = |x: f64, y: f64| [middle[0] + zoom * x, middle[1] + zoom * y];
    let body = Disc { middle: at(0.0, 18.0), radius: 26.0 * zoom, colour: [200, 90, 20] };
    let head = Disc { middle: at(30.0 * lean, -22.0), radius: 15.0 * zoom, colour: [40, 60, 160] };
    picture(size[0], size[1], &[body, head])
}

fn known() -> KnownViews {
    let mut views = KnownViews::default();
    for lean in -10..=10 {
        assert!(views.add(&asset([SIDE; 2], f64::from(lean) / 10.0, 1.0, [0.0; 2]), 1.0), "it stands out");
    }
    views
}

fn size(frame: &Frame) -> ImageSize {
    ImageSize { height: frame.height() as usize, width: frame.width() as usize }
}

/// Fails unless the window is where the trained frame lies, as near as what the asset is like from other views allows.
#[track_caller]
fn assert_framed(part: Part, middle: [f64; 2], side: f64) {
    let Part::Window(Window { middle: found, sides, turn_deg }) = part else { panic!("{part:?}") };
    assert_eq!(turn_deg, 0.0, "it is upright");
    // Between known views the asset leans by half a tenth: less than 2 px of 160.
    let off = [0, 1].map(|i| (found[i] - middle[i]).abs() / side);
    assert!(off.iter().all(|off| *off < 0.02), "{found:?} instead of {middle:?}");
    assert!(sides.iter().all(|s| (s / side - 1.0).abs() < 0.03), "{sides:?} instead of {side}");
}

#[test]
fn films_from_far_near_and_aside_are_framed_as_the_known_views() {
    let views = known();
    assert_eq!(views.len(), 21, "a view each");
    for (frame, zoom, off) in
        [([400, 400], 1.2, [0.0, 0.0]), ([640, 360], 1.1, [150.0, -40.0]), ([200, 500], 0.9, [20.0, 130.0])]
    {
        let film: Vec<Frame> = (0..12).map(|i| asset(frame, 0.15 * f64::from(i) - 0.85, zoom, off)).collect();
        let looks: Vec<Look> = film.iter().map(|frame| views.look(frame)).collect();
        let middle = [0, 1].map(|i| f64::from(frame[i]) / 2.0 + off[i]);
        for part in settle(&looks, size(&film[0])) {
            assert_framed(part, middle, zoom * f64::from(SIDE));
        }
    }
}

#[test]
fn an_asset_that_fills_trainings_frames_is_framed_by_views_that_show_more() {
    // Training's frames are those of `known`, of half the side: the asset is cut by their edges.
    let mut views = KnownViews::default();
    let leans = (-10..=10).map(|lean| f64::from(lean) / 10.0);
    assert!(leans.into_iter().all(|lean| views.add(&asset([SIDE; 2], lean, 1.0, [0.0; 2]), 2.0)), "it stands out");
    let film = (0..12).map(|i| views.look(&asset([400, 400], 0.15 * f64::from(i) - 0.85, 1.2, [30.0, -20.0])));
    let looks: Vec<Look> = film.collect();
    for part in settle(&looks, ImageSize { height: 400, width: 400 }) {
        assert_framed(part, [230.0, 180.0], 1.2 * f64::from(SIDE) / 2.0);
    }
}

#[test]
fn a_film_that_is_framed_as_usual_is_shown_as_it_is() {
    let views = known();
    let film: Vec<Frame> = (0..8).map(|i| asset([SIDE; 2], 0.2 * f64::from(i) - 0.75, 1.0, [2.0, -3.0])).collect();
    let looks: Vec<Look> = film.iter().map(|frame| views.look(frame)).collect();
    assert!(looks.iter().all(|look| matches!(look, Look::Fits(_))), "it is found: {looks:?}");
    assert_eq!(settle(&looks, size(&film[0])), vec![Part::All; 8], "all together");
}

#[test]
fn a_turned_film_is_put_upright_wherever_the_asset_is_in_it() {
    let views = known();
    for degrees in [6.0, -12.0, 20.0, -33.0] {
        for (zoom, off) in [(1.0, [0.0, 0.0]), (1.2, [30.0, -20.0])] {
            let frame = |i: u32| turned(&asset([400, 400], 0.15 * f64::from(i) - 0.85, zoom, off), degrees);
            let looks: Vec<Look> = (0..12).map(|i| views.look(&frame(i))).collect();
            // Where the asset is after the turn; rows grow downwards.
            let (sin, cos) = f64::to_radians(degrees).sin_cos();
            let middle = [200.0 + cos * off[0] + sin * off[1], 200.0 + cos * off[1] - sin * off[0]];
            for part in settle(&looks, ImageSize { height: 400, width: 400 }) {
                let Part::Window(window) = part else { panic!("{degrees}: {part:?}") };
                // A mark loses two hundredths of its bits to two degrees.
                assert!((window.turn_deg - degrees).abs() < 2.0, "{degrees}: {window:?}");
                assert_framed(Part::Window(Window { turn_deg: 0.0, ..window }), middle, zoom * f64::from(SIDE));
            }
        }
    }
}

#[test]
fn a_turned_film_that_is_framed_as_usual_is_turned_about_its_middle() {
    let views = known();
    let looks =
        (0..8).map(|i| views.look(&turned(&asset([SIDE; 2], 0.2 * f64::from(i) - 0.75, 1.0, [2.0, -3.0]), 15.0)));
    let parts = settle(&looks.collect::<Vec<_>>(), ImageSize { height: 160, width: 160 });
    for part in &parts {
        let Part::Window(Window { middle, sides, turn_deg }) = *part else { panic!("{part:?}") };
        assert_eq!((middle, sides), ([80.0; 2], [160.0; 2]), "all of it");
        assert!((turn_deg - 15.0).abs() < 2.0, "{turn_deg}");
    }
    let framings = Framings::of(&parts);
    assert_eq!((framings.cut, framings.turned, framings.usual), (8, 8, 0), "{framings:?}");
    assert!(framings.are_framed() && !Framings::default().are_framed(), "{framings:?}");
}

#[test]
fn a_cut_to_another_shot_is_not_averaged_over() {
    let views = known();
    let frame = [400, 400];
    let film: Vec<Frame> =
        (0..12).map(|i| asset(frame, 0.1 * f64::from(i % 5) - 0.2, if i < 8 { 1.0 } else { 2.0 }, [0.0; 2])).collect();
    let looks: Vec<Look> = film.iter().map(|frame| views.look(frame)).collect();
    for (i, part) in settle(&looks, size(&film[0])).into_iter().enumerate() {
        assert_framed(part, [200.0; 2], if i < 8 { 160.0 } else { 320.0 });
    }
}

#[test]
fn shots_that_differ_by_an_eighth_of_a_side_are_told_apart() {
    let views = known();
    // Short shots, as of a film that jumps from camera to camera; then frames that each show the asset elsewhere.
    let places: Vec<[f64; 2]> = (0..5).map(|shot| [20.0 * f64::from(shot) - 40.0, 10.0 * f64::from(shot)]).collect();
    let frame = |i: usize, off| asset([400, 400], 0.15 * (i % 8) as f64 - 0.5, 1.0, off);
    let shots: Vec<[f64; 2]> = places.iter().flat_map(|place| [*place; 8]).collect();
    for (what, offs) in [("shots", shots), ("frames", places)] {
        let looks: Vec<Look> = offs.iter().enumerate().map(|(i, off)| views.look(&frame(i, *off))).collect();
        let parts = settle(&looks, ImageSize { height: 400, width: 400 });
        assert_eq!(parts.len(), offs.len(), "{what}");
        for (part, off) in parts.into_iter().zip(&offs) {
            assert_framed(part, off.map(|o| 200.0 + o), 160.0);
        }
    }
}

#[test]
fn bad_frames_are_shown_whole_with_the_reason_and_do_not_move_the_others() {
    let views = known();
    let mut film: Vec<Frame> = (0..9).map(|i| asset([400, 400], 0.1 * f64::from(i) - 0.4, 1.3, [30.0, 0.0])).collect();
    film[2] = picture(400, 400, &[]);
    film[5] = asset([400, 400], 0.0, 1.3, [200.0, 0.0]);
    let looks: Vec<Look> = film.iter().map(|frame| views.look(frame)).collect();
    let parts = settle(&looks, size(&film[0]));
    assert_eq!(parts[2], Part::Fallback(NotFound::Nothing), "a plain frame");
    assert_eq!(parts[5], Part::Fallback(NotFound::Cut), "half of it is outside");
    for (_, part) in parts.iter().enumerate().filter(|(i, _)| ![2, 5].contains(i)) {
        assert_framed(*part, [230.0, 200.0], 1.3 * f64::from(SIDE));
    }
    let framings = Framings::of(&parts);
    assert_eq!((framings.cut, framings.usual), (7, 0), "{framings:?}");
    assert_eq!(framings.not_found.values().sum::<u32>(), 2, "{framings:?}");
}

#[test]
fn another_size_of_memory_is_infinitely_far_and_the_same_is_not() {
    let (views, mut fewer) = (known(), KnownViews::default());
    fewer.add(&asset([SIDE; 2], 0.0, 1.0, [0.0; 2]), 1.0);
    assert_eq!(views.share_apart(&views.clone()), 0.0);
    let apart = views.share_apart(&fewer);
    assert!(apart.is_nan() || apart.is_infinite(), "{apart}");
    assert!(!fewer.add(&picture(50, 50, &[]), 1.0) && fewer.len() == 1, "what does not stand out is not remembered");
    assert!(KnownViews::default().is_empty() && !fewer.is_empty(), "empty is empty");
    assert!(matches!(KnownViews::default().look(&asset([SIDE; 2], 0.0, 1.0, [0.0; 2])), Look::Nothing(_)), "no view");
}
