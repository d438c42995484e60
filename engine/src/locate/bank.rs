//! A first guess without a prior: small pictures of the asset from all around and at several moments, found in a frame
//! at whatever size and place they are most like it.

use glam::{DQuat, DVec3, Vec4, Vec4Swizzles};
use rayon::prelude::*;

use super::gray::Gray;
use super::pose::{PARAMETERS, Pose, TIME};
use super::stage::{Canvas, Stage};
use super::thumbnail::{CHANNELS, Thumbnail};
use super::views::{MOMENTS, Vantage};
use crate::error::EngineError;
use crate::scene::FrameSize;

/// Sides of the small pictures, px: for a first look, for assets that are small in a frame, for those that fill it, and
/// for those of which it shows a part.
const SIDES_PX: [usize; 4] = [16, 24, 48, 96];
/// Views that get more than a first look.
const LOOKED_AT: usize = 200;
/// How large an asset is, beside a usual film's, for which the third and the fourth are taken.
const LARGE: [f64; 2] = [1.0, 2.0];
/// How large the asset is beside a usual film's, at least and at most, of frames' longer sides: cameras from 0.6 to 1.7
/// times the distance, lenses from 25 to 75 degrees, and seven tenths of what they take in.
const SIZES: [f64; 2] = [0.25, 4.1];
/// From one size that is tried to the next.
const SIZE_STEP: f64 = 1.22;
/// Share of a small picture's gradients that is in the frame at least, before what is outside counts against it.
const LEAST_INSIDE: f32 = 0.3;
/// What keeps apart how clear a picture is and what it shows where both are nearly the same, of their squares.
const LITTLE: f32 = 1e-3;
/// How much differences of colour count beside those of brightness, which are larger in most pictures.
const COLOUR: f32 = 2.0;
/// How far views are turned that are looked at between those of the bank, from far to near; and how far sizes are from
/// one that was found, as logarithms.
const TURNED_DEG: [f64; 2] = [7.0, 3.5];
const NEAR_SIZE: f64 = 0.3;
/// Directions that are nearer than this count as one guess, as the cosine of some 20 degrees; and moments.
const SAME_VIEW: f64 = 0.94;
const SAME_TIME: f64 = 0.2;

/// A view of the asset, in pictures of all sizes.
#[derive(Clone, Debug)]
struct Seen {
    pose: Pose,
    looks: [Look; SIDES_PX.len()],
}

impl Seen {
    /// None of a view in which nothing is seen.
    fn of(stage: &mut Stage, pose: Pose) -> Result<Option<Self>, EngineError> {
        let canvas = Canvas::smallest(drawn_size()?);
        let pixels = stage.draw_pixels(&pose, canvas)?;
        let pose = stage.about_what_is_seen_in(canvas, &pose)?;
        let (drawn, clear) = (pixels.thumbnail(), pixels.clear());
        let looks = SIDES_PX.map(|side| Look::of(&drawn, &clear, side));
        Ok(looks.iter().all(|look| look.products.size() > f32::EPSILON).then_some(Self { pose, looks }))
    }
}

/// How fast a pixel's values change, right and down: those of each channel, and last how clear it is. Vectors are
/// multiplied at once in builds of any kind, and this is where a search spends its time beside drawing.
type Gradient = [Vec4; 2];
const _: () = assert!(CHANNELS == 3, "as many as a gradient has room for");

/// What a small picture looks like before any background.
#[derive(Clone, Debug)]
struct Look {
    side: usize,
    pixels: Vec<Gradient>,
    /// Sums of their products over the picture.
    products: Products,
}

impl Look {
    fn of(drawn: &Thumbnail, clear: &Gray, side: usize) -> Self {
        let pixels = gradients(&drawn.resized(side, side), Some(&clear.resized(side, side)));
        let mut products = Products::default();
        products.add(&pixels);
        Self { side, pixels, products }
    }
}

/// Of each pixel, each channel as much as it counts.
fn gradients(picture: &Thumbnail, clear: Option<&Gray>) -> Vec<Gradient> {
    let [width, height] = picture.size();
    let mut pixels = vec![Gradient::default(); width * height];
    let weighted = picture.channels.iter().zip([1.0, COLOUR, COLOUR]).chain(clear.map(|clear| (clear, 1.0)));
    for (at, (channel, weight)) in weighted.enumerate() {
        for (way, of) in channel.gradient().into_iter().enumerate() {
            pixels.iter_mut().zip(of).for_each(|(pixel, slope)| pixel[at / 2][at % 2 * 2 + way] = weight * slope);
        }
    }
    pixels
}

/// Sums of products of the picture's gradients and of how clear it is, right and down: of each channel with itself, and
/// with that; of that with itself last.
#[derive(Clone, Copy, Debug, Default)]
struct Products {
    own: Gradient,
    both: Gradient,
}

impl Products {
    fn add(&mut self, pixels: &[Gradient]) {
        self.add_with(pixels, pixels);
    }

    /// The same of a picture's with a film's, which has nothing that is clear.
    fn add_with(&mut self, pixels: &[Gradient], others: &[Gradient]) {
        let Self { own: [own_0, own_1], both: [both_0, both_1] } = self;
        for ([pixel_0, pixel_1], [other_0, other_1]) in pixels.iter().zip(others) {
            let clear = pixel_1.zwzw();
            *own_0 += *pixel_0 * *other_0;
            *own_1 += *pixel_1 * *other_1;
            *both_0 += clear * *other_0;
            *both_1 += clear * *other_1;
        }
    }

    fn size(&self) -> f32 {
        self.own.iter().map(|half| half.element_sum()).sum()
    }

    /// Of a channel, or of how clear it is.
    fn of(lanes: &Gradient, channel: usize) -> f32 {
        let half = lanes[channel / 2];
        if channel.is_multiple_of(2) { half.x + half.y } else { half.z + half.w }
    }

    /// Of a frame's gradients, which have the products `with` the picture, what that explains before the background
    /// that explains most; 0 where that would be its negative.
    ///
    /// # Equation
    /// Most of Σ |f|² − |f − g p − h k|² over channels' f and p, a gain g of all and a background h of each, where k is
    /// how clear the picture is: h = (f·k − g p·k) / k·k, and g is the quotient of Σ p·f − p·k f·k / k·k and Σ p·p −
    /// (p·k)² / k·k.
    fn explained(&self, with: &Self) -> f32 {
        let clear = Self::of(&self.own, CHANNELS).max(f32::MIN_POSITIVE) * (1.0 + LITTLE);
        let (mut seen, mut own, mut behind) = (0.0, 0.0, 0.0);
        for channel in 0..CHANNELS {
            let [both, there] = [&self.both, &with.both].map(|lanes| Self::of(lanes, channel));
            seen += Self::of(&with.own, channel) - both * there / clear;
            own += Self::of(&self.own, channel) * (1.0 + LITTLE) - both * both / clear;
            behind += there * there / clear;
        }
        if seen > 0.0 && own > 0.0 { seen * seen / own + behind } else { 0.0 }
    }
}

/// Small pictures of an asset.
#[derive(Clone, Debug)]
pub struct Bank {
    seen: Vec<Seen>,
}

/// How a frame's edges are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edges {
    /// As strong as they are.
    AsTheyAre,
    /// The strongest no stronger than most: a logo's are stronger than an asset's.
    HeldDown,
}

/// A pose, and how much a frame looks like it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guess {
    /// The pose, through a usual lens.
    pub pose: Pose,
    /// How much larger what is seen is than in a picture from where the view is taken, as a logarithm.
    pub larger: f64,
    /// Correlation of gradients, −1 to 1.
    pub likeness: f64,
}

impl Guess {
    /// As a logarithm of its length in widths, the lens that the pose's frame was taken through from where the view is
    /// taken: what is larger there is so by the lens alone.
    #[must_use]
    pub fn lens_from_there(&self) -> f64 {
        self.pose.lens + self.larger
    }

    /// The pose through a lens: what is seen beside the middle of a picture is seen from another side than what is in
    /// it, the more so the wider the lens.
    #[must_use]
    pub fn through(&self, lens: f64) -> Pose {
        let [across, down] = self.pose.shift.map(|shift| shift / lens.exp());
        let aside = DQuat::from_rotation_arc(DVec3::Z, DVec3::new(across, down, 1.0).normalize());
        Pose { turn: (aside * self.pose.turn).normalize(), lens, ..self.pose }
    }
}

impl Bank {
    /// Draws the pictures.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn new(stage: &mut Stage, vantage: Vantage<'_>) -> Result<Self, EngineError> {
        let mut seen = Vec::new();
        for pose in vantage.views(stage) {
            seen.extend(Seen::of(stage, pose)?);
        }
        Ok(Self { seen })
    }

    /// The `count` best guesses at what a frame shows, of views of the bank that are not the same, looked at more
    /// closely. Best first.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn guesses(
        &self,
        stage: &mut Stage,
        frame: &Thumbnail,
        edges: Edges,
        count: usize,
    ) -> Result<Vec<Guess>, EngineError> {
        let first = Self::ranked(&pyramid(frame, edges, |_| 0), &self.seen.iter().collect::<Vec<_>>());
        let seen: Vec<&Seen> = first.into_iter().take(LOOKED_AT).map(|found| found.seen).collect();
        let levels = pyramid(frame, edges, |size| 1 + LARGE.iter().filter(|large| size >= **large).count());
        let found = Self::ranked(&levels, &seen);
        let mut kept: Vec<Found<'_>> = Vec::new();
        for found in found {
            if !kept.iter().any(|other| is_same(&other.guess.pose, &found.guess.pose)) {
                kept.push(found);
            }
            if kept.len() == count {
                break;
            }
        }
        let mut closer: Vec<Closer<'_>> = kept.iter().map(|found| Closer::new(found, &levels)).collect();
        for step in steps_around(stage.moves()) {
            let mut beside = Vec::new();
            for guess in &closer {
                for step in [step, step.map(|by| -by)] {
                    beside.push(Seen::of(stage, guess.view.moved(&step))?);
                }
            }
            closer.par_iter_mut().zip(beside.par_chunks(2)).for_each(|(guess, beside)| guess.look_at(beside));
        }
        let mut guesses: Vec<Guess> = closer.into_iter().map(|closer| closer.guess).collect();
        guesses.sort_by(|a, b| b.likeness.total_cmp(&a.likeness));
        Ok(guesses)
    }

    /// Where each view is most like the frame, the likest first.
    fn ranked<'a>(pictures: &[Level], seen: &[&'a Seen]) -> Vec<Found<'a>> {
        let found_in = |seen: &&'a Seen| {
            let guess = best(pictures.iter().filter_map(|picture| picture.find(seen)))?;
            Some(Found { seen, guess })
        };
        let mut found: Vec<Found<'a>> = seen.par_iter().filter_map(found_in).collect();
        found.sort_by(|a, b| b.guess.likeness.total_cmp(&a.guess.likeness));
        found
    }
}

/// Whether two guesses are as good as one: the same is looked at from nearly the same side at about the same time.
fn is_same(a: &Pose, b: &Pose) -> bool {
    let axis = |pose: &Pose| pose.turn.inverse() * DVec3::Z;
    axis(a).dot(axis(b)) > SAME_VIEW
        && (a.time - b.time).abs() < SAME_TIME
        && a.middle.point.distance(b.middle.point) < a.middle.radius
}

/// The likest of guesses.
fn best(guesses: impl Iterator<Item = Guess>) -> Option<Guess> {
    guesses.max_by(|a, b| a.likeness.total_cmp(&b.likeness))
}

/// From a view to those between it and the next, one after the other: to moments between, as far as the next turn about
/// each axis, and again half as far.
fn steps_around(moves: bool) -> impl Iterator<Item = [f64; PARAMETERS]> {
    let moment = 1.0 / f64::from(3 * (MOMENTS - 1));
    TURNED_DEG.into_iter().flat_map(move |turned| {
        let (turn, part) = (turned.to_radians(), turned / TURNED_DEG[0]);
        let ways = moves.then_some((TIME, moment * part)).into_iter().chain((0..3).map(move |axis| (axis, turn)));
        ways.map(|(parameter, by)| {
            let mut step = [0.0; PARAMETERS];
            step[parameter] = by;
            step
        })
    })
}

/// A view and where it is in a frame.
struct Found<'a> {
    seen: &'a Seen,
    guess: Guess,
}

/// The likest of a view of the bank and those around it.
struct Closer<'a> {
    view: Pose,
    guess: Guess,
    /// The frame at sizes near the one that was found.
    levels: Vec<&'a Level>,
}

impl<'a> Closer<'a> {
    fn new(Found { seen, guess }: &Found<'_>, levels: &'a [Level]) -> Self {
        let is_near = |level: &&Level| (level.larger() - guess.larger).abs() < NEAR_SIZE;
        Self { view: seen.pose, guess: *guess, levels: levels.iter().filter(is_near).collect() }
    }

    /// Goes on from whichever of these views is likelier.
    fn look_at(&mut self, views: &[Option<Seen>]) {
        for seen in views.iter().flatten() {
            let found = best(self.levels.iter().filter_map(|level| level.find(seen)));
            if let Some(guess) = found.filter(|guess| guess.likeness > self.guess.likeness) {
                (self.view, self.guess) = (seen.pose, guess);
            }
        }
    }
}

/// As large as the larger pictures.
fn drawn_size() -> Result<FrameSize, EngineError> {
    let side = u32::try_from(SIDES_PX[SIDES_PX.len() - 1]).unwrap_or(u32::MAX);
    FrameSize::new(side, side)
}

/// A frame at a size at which the asset may be as large as in the small pictures.
struct Level {
    width: usize,
    height: usize,
    pixels: Vec<Gradient>,
    /// Sum of the squares of all gradients.
    energy: f32,
    /// Which of the small pictures it is compared with.
    look: usize,
}

/// A frame at all sizes, and which of the small pictures is for which.
fn pyramid(frame: &Thumbnail, edges: Edges, look_of: impl Fn(f64) -> usize) -> Vec<Level> {
    let whole = frame.size();
    let mut levels = Vec::new();
    let mut size = SIZES[0];
    while size <= SIZES[1] {
        // An asset that is `size` times the usual one in a frame is as large as in a picture in a frame of this length.
        let look = look_of(size);
        let longer = SIDES_PX[look] as f64 / size;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some dozens of pixels")]
        let [across, down] =
            whole.map(|side| (longer * side as f64 / whole[0].max(whole[1]) as f64).round().max(4.0) as usize);
        let mut pixels = gradients(&frame.resized(across, down), None);
        if edges == Edges::HeldDown {
            hold_down(&mut pixels);
        }
        let energy = pixels.iter().map(squared).sum();
        levels.push(Level { width: across, height: down, pixels, energy, look });
        size *= SIZE_STEP;
    }
    levels
}

/// Makes gradients no longer than their mean, each weighted by its length.
fn hold_down(pixels: &mut [Gradient]) {
    let sum = pixels.iter().map(|pixel| squared(pixel).sqrt()).sum::<f32>().max(f32::MIN_POSITIVE);
    let longest = pixels.iter().map(squared).sum::<f32>() / sum;
    for pixel in pixels {
        let length = squared(pixel).sqrt();
        if length > longest {
            *pixel = pixel.map(|half| half * (longest / length));
        }
    }
}

fn squared(pixel: &Gradient) -> f32 {
    pixel.iter().map(|half| half.length_squared()).sum()
}

impl Level {
    /// How much larger the asset is in the frame than in a small picture of it, as a logarithm.
    fn larger(&self) -> f64 {
        (SIDES_PX[self.look] as f64 / self.width as f64).ln()
    }

    /// Where a small picture is most like the frame, of all places where its middle is in the frame.
    fn find(&self, seen: &Seen) -> Option<Guess> {
        let look = &seen.looks[self.look];
        let half = signed(look.side / 2);
        let [width, height] = [self.width, self.height].map(signed);
        let mut best: Option<([i64; 2], f64)> = None;
        let mut try_at = |[across, down]: [i64; 2]| {
            if (0..width).contains(&across) && (0..height).contains(&down) {
                let likeness = self.likeness(look, [across - half, down - half]);
                if best.is_none_or(|(_, most)| likeness > most) {
                    best = Some(([across, down], likeness));
                }
            }
            best
        };
        // Every other place, and then those around the best.
        let mut found = None;
        for down in (0..height).step_by(2) {
            for across in (0..width).step_by(2) {
                found = try_at([across, down]);
            }
        }
        let ([across, down], _) = found?;
        for beside in [[-1, 0], [1, 0], [0, -1], [0, 1], [-1, -1], [1, 1], [-1, 1], [1, -1]] {
            try_at([across + beside[0], down + beside[1]]);
        }
        let ([across, down], likeness) = best?;
        let of_width = |at: i64, side: i64| (at as f64 - side as f64 / 2.0) / width as f64;
        // The lens stays the usual one: what differs is how large the asset appears.
        let larger = self.larger();
        let size = seen.pose.size + larger;
        let shift = [of_width(across, width), of_width(down, height)];
        Some(Guess { pose: Pose { shift, size, ..seen.pose }, larger, likeness })
    }

    /// Correlation of gradients with the picture's upper left corner at a pixel, before the background with which that
    /// is most: what of the frame lies outside of the picture counts against it, what of the picture lies outside of
    /// the frame does not.
    fn likeness(&self, look: &Look, [left, top]: [i64; 2]) -> f64 {
        let side = signed(look.side);
        let [width, height] = [self.width, self.height].map(signed);
        let (from_x, to_x) = ((-left).max(0), side.min(width - left));
        let is_whole = from_x == 0 && to_x == side && top >= 0 && top + side <= height;
        let (mut with, mut inside) = (Products::default(), Products::default());
        for y in (-top).max(0)..side.min(height - top) {
            let index = |at: i64| usize::try_from(at).unwrap_or(0);
            let (row, there) = (index(y * side), index((y + top) * width + left + from_x));
            let (own, count) = (row + index(from_x), index(to_x - from_x));
            let picture = &look.pixels[own..own + count];
            with.add_with(picture, &self.pixels[there..there + count]);
            if !is_whole {
                inside.add(picture);
            }
        }
        let inside = if is_whole { look.products } else { inside };
        // A picture that is nearly all outside of the frame says nothing.
        let share = (inside.size() / (LEAST_INSIDE * look.products.size())).min(1.0);
        let explained = share * inside.explained(&with);
        if self.energy > 0.0 { f64::from((explained / self.energy).sqrt()) } else { 0.0 }
    }
}

fn signed(side: usize) -> i64 {
    i64::try_from(side).unwrap_or(i64::MAX)
}
