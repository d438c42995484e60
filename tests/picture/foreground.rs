//! What stands out in a frame: where it is, how far it is spread, and when nothing can be said.

use guard4d_engine::media::Frame;
use guard4d_engine::picture::foreground::{NotFound, Thing, border_colour, find, without_corners};

const GROUND: [u8; 3] = [240, 240, 235];

/// Where a disc lies.
#[derive(Clone, Copy)]
pub(super) struct Disc {
    pub(super) middle: [f64; 2],
    pub(super) radius: f64,
    pub(super) colour: [u8; 3],
}

/// Discs before a plain ground, their edges blended.
pub(super) fn picture(width: u32, height: u32, discs: &[Disc]) -> Frame {
    let pixel = |at: u32| {
        let (x, y) = (f64::from(at % width) + 0.5, f64::from(at / width) + 0.5);
        let mut colour = GROUND.map(f64::from);
        for disc in discs {
            let distance = (x - disc.middle[0]).hypot(y - disc.middle[1]);
            let share = (disc.radius + 0.5 - distance).clamp(0.0, 1.0);
            colour.iter_mut().zip(disc.colour).for_each(|(c, own)| *c += share * (f64::from(own) - *c));
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a level of 8 bits")]
        colour.map(|c| c.round() as u8)
    };
    Frame::new(width, height, (0..width * height).flat_map(pixel).collect()).expect("the length fits")
}

fn disc(x: f64, y: f64, radius: f64) -> Disc {
    Disc { middle: [x, y], radius, colour: [30, 60, 90] }
}

#[test]
fn a_disc_is_found_where_it_is_in_frames_of_any_shape() {
    for (width, height, one) in
        [(200, 200, disc(100.0, 100.0, 40.0)), (320, 120, disc(70.5, 52.0, 30.0)), (90, 300, disc(40.0, 250.0, 25.0))]
    {
        let Thing { middle, spread, .. } = find(&picture(width, height, &[one])).expect("it stands out");
        // Edges are blended over a pixel.
        assert!((0..2).all(|i| (middle[i] - one.middle[i]).abs() < 0.2), "{middle:?} of {:?}", one.middle);
        // The spread of a disc is its radius over the root of two.
        let wanted = one.radius / 2.0_f64.sqrt();
        assert!((spread / wanted - 1.0).abs() < 0.02, "{spread} instead of {wanted}");
    }
}

#[test]
fn specks_and_logos_move_nothing() {
    let asset = disc(90.0, 110.0, 40.0);
    let alone = find(&picture(200, 200, &[asset])).expect("it stands out");
    let beside = find(&picture(200, 200, &[asset, disc(185.0, 15.0, 5.0), disc(12.0, 180.0, 2.0)]));
    assert_eq!(beside, Ok(alone), "a fiftieth of its size");
}

#[test]
fn nothing_is_found_where_nothing_can_be_said() {
    assert_eq!(find(&picture(100, 80, &[])), Err(NotFound::Nothing), "a plain frame");
    // Levels that a codec moves a plain ground by.
    let noisy = Frame::new(64, 64, (0..3 * 64 * 64).map(|i| 120 + (i * 7 % 9) as u8).collect()).expect("it fits");
    assert_eq!(find(&noisy), Err(NotFound::Nothing), "noise");
    assert_eq!(find(&picture(100, 100, &[disc(50.0, 50.0, 90.0)])), Err(NotFound::Nothing), "one colour all over");
    assert_eq!(find(&picture(100, 100, &[disc(50.0, 100.0, 45.0)])), Err(NotFound::Cut), "half of it is outside");
    let two = [disc(50.0, 60.0, 25.0), disc(150.0, 140.0, 24.0)];
    assert_eq!(find(&picture(200, 200, &two)), Err(NotFound::Several), "two assets");
    let hall = Frame::new(60, 60, (0..3 * 60 * 60).map(|i| if i / 3 / 60 / 6 % 2 == 0 { 20 } else { 220 }).collect());
    assert_eq!(find(&hall.expect("it fits")), Err(NotFound::Cut), "a room without an outside");
    // The smallest frames there are.
    for side in 1..4 {
        assert!(find(&picture(side, side, &[])).is_err(), "{side} px");
    }
}

#[test]
fn the_border_has_its_commonest_colour() {
    assert_eq!(border_colour(&picture(40, 30, &[disc(20.0, 0.0, 6.0)])), GROUND, "a thing reaches it");
}

/// The frame turned counterclockwise about its middle, and put on black.
pub(super) fn turned(frame: &Frame, degrees: f64) -> Frame {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let [width, height] = [frame.width(), frame.height()].map(f64::from);
    let pixel = |at: u32| {
        let (x, y) =
            (f64::from(at % frame.width()) + 0.5 - width / 2.0, f64::from(at / frame.width()) + 0.5 - height / 2.0);
        // Rows grow downwards.
        let (x, y) = (cos * x - sin * y + width / 2.0, sin * x + cos * y + height / 2.0);
        let is_inside = (0.0..width).contains(&x) && (0.0..height).contains(&y);
        let at = if is_inside { (y as usize * frame.width() as usize + x as usize) * 3 } else { usize::MAX };
        frame.rgb().get(at..at.saturating_add(3)).map_or([0; 3], |rgb| [rgb[0], rgb[1], rgb[2]])
    };
    Frame::new(frame.width(), frame.height(), (0..frame.width() * frame.height()).flat_map(pixel).collect())
        .expect("the length fits")
}

#[test]
fn what_a_turned_picture_was_put_on_is_no_part_of_it() {
    let asset = disc(110.0, 90.0, 40.0);
    for degrees in [5.0, -15.0, 30.0, 45.0] {
        let turned = turned(&picture(240, 200, &[asset]), degrees);
        assert_eq!(find(&turned), Err(NotFound::Cut), "{degrees}: black corners are cut by the edge");
        let Thing { background, spread, .. } = find(&without_corners(&turned)).expect("it stands out");
        assert_eq!(background, GROUND, "{degrees}");
        assert!((spread / (asset.radius / 2.0_f64.sqrt()) - 1.0).abs() < 0.02, "{degrees}: {spread}");
    }
}

#[test]
fn pictures_that_fill_their_frame_stay_as_they_are() {
    let corner = |x: f64, y: f64| Disc { middle: [x, y], radius: 30.0, colour: [0; 3] };
    let corners = [corner(0.0, 0.0), corner(200.0, 0.0), corner(0.0, 160.0), corner(200.0, 160.0)];
    let hall = Frame::new(60, 60, (0..3 * 60 * 60).map(|i| if i / 3 / 60 / 6 % 2 == 0 { 20 } else { 220 }).collect());
    for (what, frame) in [
        ("an asset", picture(200, 160, &[disc(90.0, 80.0, 40.0)])),
        ("nothing", picture(20, 10, &[])),
        ("three dark corners", picture(200, 160, &corners[..3])),
        ("a room", hall.expect("it fits")),
        ("a pixel", picture(1, 1, &[])),
    ] {
        assert_eq!(*without_corners(&frame), frame, "{what}");
    }
    // Four corners of one colour are what a turned picture has.
    let four = picture(200, 160, &[&corners[..], &[disc(100.0, 80.0, 30.0)]].concat());
    assert_eq!(find(&without_corners(&four)).map(|thing| thing.background), Ok(GROUND));
}
