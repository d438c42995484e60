//! Guesses of what was done to a film: that undoing brings it back, and that a choice among them proves nothing by
//! itself.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::id_code::SearchedP;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::media::Frame;
use guard4d_engine::media::framing::Rect;
use guard4d_engine::picture::distortion::{Distortion, DistortionChain};
use guard4d_engine::picture::part::{Part, Window};
use guard4d_engine::picture::undo_guess::{GuessSearch, UndoGuess};
use guard4d_engine::watermark::extractor::calibration::Calibration;
use guard4d_engine::watermark::extractor::reader::{ClipFeatures, Reader};
use guard4d_engine::watermark::extractor::rotation::KeyRotation;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;

use guard4d_kernels::image::resize::ImageSize;

use crate::support::close::largest;
use crate::support::gpu::{Gpu, device};
use crate::support::owner::Owner;
use crate::support::random::Random;

const BITS: usize = 16;

fn search(kinds: &str) -> GuessSearch {
    kinds.parse().expect("well written")
}

#[test]
fn guesses_are_all_combinations_and_nothing_at_all_is_the_first() {
    assert_eq!(GuessSearch::default().guesses(), [UndoGuess::NONE], "nothing asked for");
    for (kinds, count) in [
        ("mirror", 2),
        ("rotation", 9),
        ("rotation,crop", 45),
        ("crop, rotation", 45),
        ("crop,crop", 5),
        ("rotation,crop,brightness,mirror", 450),
        // 25, 81, 169 and 289 places of four sizes.
        ("window", 565),
        ("window,crop,mirror", 1130),
    ] {
        let guesses = search(kinds).guesses();
        assert_eq!((guesses.len(), guesses[0]), (count, UndoGuess::NONE), "{kinds}");
        for (i, guess) in guesses.iter().enumerate() {
            assert!(!guesses[..i].contains(guess), "{kinds}: {guess:?} twice");
        }
    }
    assert!(search("auto").is_auto() && search("auto").guesses() == [UndoGuess::NONE], "left to the films");
    assert!(!GuessSearch::suited(true).is_auto() && !search("mirror").is_auto(), "settled");
    assert_eq!(GuessSearch::suited(true), search("mirror"), "framing undoes the rest");
    assert_eq!(GuessSearch::suited(false), search("rotation,crop,mirror"));
    for nonsense in ["", "jpeg", "auto,mirror", "rotation:5", "rotation,,crop"] {
        let refused = nonsense.parse::<GuessSearch>().expect_err(nonsense);
        assert!(refused.contains("rotation, crop, window, brightness, mirror"), "{nonsense}: {refused}");
    }
}

fn reader(gpu: &Gpu, owner: &Owner) -> Reader {
    let (width, bits) = (owner.key.text_mean.len(), owner.key.bits());
    let calibration = Calibration {
        mean_image: vec![0.0; width],
        directions: Random(31).vec_f32(width * bits, -1.0, 1.0),
        mean_logits: vec![0.0; bits],
    };
    let extractor = ExtractorWeights {
        mode: ExtractorMode::Blind,
        tmsd: None,
        calibration,
        key_rotation: KeyRotation::FIXED,
        known_views: None,
        content: None,
    };
    Reader::new(gpu, &owner.clip, &owner.key, &extractor).expect("belongs to the key")
}

/// Coloured waves around the middle of a wide picture of colour `ground`, gone at its border, so that no edit here cuts
/// anything off.
fn picture(ground: [f64; 3]) -> Frame {
    let (width, height) = (300_u32, 200_u32);
    let level = |x: u32, y: u32, channel: usize| {
        let (x, y) = (f64::from(x) / 100.0 - 1.5, f64::from(y) / 100.0 - 1.0);
        let wave = (4.0 * x + 7.0 * y * (channel + 1) as f64).sin() + (6.0 * x * y).cos();
        ground[channel] + 30.0 * (2.0 + wave) * (-6.0 * (x * x + y * y)).exp()
    };
    let samples = (0..height * width * 3).map(|i| level(i / 3 % width, i / 3 / width, i as usize % 3).round() as u8);
    Frame::new(width, height, samples.collect()).expect("it fits")
}

fn distance(a: &ClipFeatures, b: &ClipFeatures) -> f64 {
    let squares = a.features.iter().zip(&b.features).map(|(a, b)| f64::from(a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

/// How far from `original` CLIP sees `edited`, as it is and without what was done.
fn distances(reader: &mut Reader, original: &Frame, edited: &Frame, done: UndoGuess) -> [f64; 2] {
    let mut look = |frame: &Frame, edits: &[UndoGuess]| {
        let mut feature_stream = reader.stream(edits, Vec::new());
        feature_stream.push(frame.clone()).expect("sees");
        feature_stream.finish().expect("sees")
    };
    let seen = look(original, &[UndoGuess::NONE]);
    let [as_it_is, undone] = &look(edited, &[UndoGuess::NONE, done])[..] else { panic!("two clip_features") };
    [as_it_is, undone].map(|clip_features| distance(clip_features, &seen[0]))
}

#[test]
fn a_film_without_its_edit_is_seen_nearly_as_it_was() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let mut reader = reader(&gpu, &owner);
    // Turned pictures have black corners, which are gone where the ground is black.
    let (black, green) = (picture([0.0; 3]), picture([60.0, 110.0, 60.0]));
    for (frame, chain, done) in [
        (&green, "mirror", UndoGuess { mirror: true, ..UndoGuess::NONE }),
        (&black, "rotation:15", UndoGuess { rotation: 15.0, ..UndoGuess::NONE }),
        (&green, "crop:0.7", UndoGuess { crop: 0.7, ..UndoGuess::NONE }),
        (&green, "brightness:0.7", UndoGuess { brightness: 0.7, ..UndoGuess::NONE }),
        (
            &black,
            "mirror,rotation:-10,crop:0.8,brightness:1.2",
            UndoGuess { rotation: -10.0, crop: 0.8, brightness: 1.2, mirror: true, ..UndoGuess::NONE },
        ),
    ] {
        let distortions: Vec<Distortion> = chain.split(',').map(|text| text.parse().expect("well written")).collect();
        let mut attack =
            DistortionChain::new(&gpu, (frame.width(), frame.height()), &distortions, 0).expect("prepares");
        let edited = attack.apply(frame, 0).expect("runs");
        let [far, near] = distances(&mut reader, frame, &edited, done);
        // What remains is two samplings and roundings to 8 bits.
        assert!(near < 0.3 * far, "{chain}: {near} from the original instead of {far}");
    }
    // Four fifths of each side, their middle 15 px right of the picture's and 10 px above it.
    let part = Rect { x: 45, y: 10, width: 240, height: 160 };
    let edited = green.cut(part).and_then(|part| part.resized((300, 200))).expect("inside");
    let done = UndoGuess { crop: 0.8, right: 0.05, below: -0.05, ..UndoGuess::NONE };
    let [far, near] = distances(&mut reader, &green, &edited, done);
    assert!(near < 0.3 * far, "a part from elsewhere: {near} from the original instead of {far}");
    let elsewhere = UndoGuess { right: -0.05, below: 0.05, ..done };
    let [_, wrong] = distances(&mut reader, &green, &edited, elsewhere);
    assert!(wrong > 2.0 * near, "put back to the wrong side: {wrong}, to the right one {near}");
}

#[test]
fn a_turned_part_is_seen_upright_and_guesses_are_undone_on_it() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let mut reader = reader(&gpu, &owner);
    let frame = picture([0.0; 3]);
    let distorted = |chain: &str| {
        let distortions: Vec<Distortion> = chain.split(',').map(|text| text.parse().expect("well written")).collect();
        let mut attack =
            DistortionChain::new(&gpu, (frame.width(), frame.height()), &distortions, 0).expect("prepares");
        attack.apply(&frame, 0).expect("runs")
    };
    let mut seen = |frame: &Frame, guess: UndoGuess, turn_deg: f64| {
        let size = ImageSize { height: frame.height() as usize, width: frame.width() as usize };
        let part = Part::Window(Window { turn_deg, ..Window::whole(size) });
        let mut feature_stream = reader.stream(&[guess], vec![part]);
        feature_stream.push(frame.clone()).expect("sees");
        feature_stream.finish().expect("sees").swap_remove(0)
    };
    let original = seen(&frame, UndoGuess::NONE, 0.0);
    for (chain, guess, turn_deg) in [
        ("rotation:15", UndoGuess::NONE, 15.0),
        ("rotation:-28", UndoGuess::NONE, -28.0),
        ("mirror,rotation:12", UndoGuess { mirror: true, ..UndoGuess::NONE }, 12.0),
    ] {
        let edited = distorted(chain);
        let far = distance(&seen(&edited, UndoGuess::NONE, 0.0), &original);
        let near = distance(&seen(&edited, guess, turn_deg), &original);
        // What remains is two samplings and roundings to 8 bits.
        assert!(near < 0.3 * far, "{chain}: {near} from the original instead of {far}");
        let wrong = distance(&seen(&edited, guess, -turn_deg), &original);
        assert!(wrong > 2.0 * near, "{chain}: turned the wrong way {wrong}, the right way {near}");
    }
}

/// Whoever may choose among readings that have nothing to do with the message is right by chance as often as the
/// p-value says, or less.
#[test]
fn the_best_of_all_guesses_is_no_better_than_chance() {
    let mut random = Random(77);
    let guesses = search("rotation,crop").guesses();
    // Readings of one film resemble each other: a common part, and one of the guess.
    let common = random.vec_f32(BITS, -1.0, 1.0);
    let readings: Vec<Reading> = guesses
        .iter()
        .map(|_| {
            let own = random.vec_f32(BITS, -1.0, 1.0);
            let logits: Vec<f32> = common.iter().zip(&own).map(|(a, b)| a + b).collect();
            Reading::from_logits(&logits, BITS as u32).expect("finite")
        })
        .collect();
    const MESSAGES: u32 = 4000;
    let tried = u32::try_from(guesses.len()).expect("45");
    let mut least = Vec::new();
    for _ in 0..MESSAGES {
        let bits: Vec<bool> = random.vec_f32(BITS, -1.0, 1.0).iter().map(|v| *v > 0.0).collect();
        let message = Message::from_bits(&bits).expect("a length");
        let p = readings.iter().map(|reading| SearchedP::of(reading, &message, tried).expect("fits").soft_score);
        least.push(-largest(p.map(|p| -p)));
    }
    for level in [0.5, 0.1, 0.01] {
        let below = least.iter().filter(|p| **p <= level).count() as f64;
        let expected = level * f64::from(MESSAGES);
        // Five standard errors above what exact p-values would give.
        assert!(below <= expected + 5.0 * (expected * (1.0 - level)).sqrt(), "{below} of {MESSAGES} at {level}");
        assert!(level < 0.1 || below > 0.0, "nothing ever comes near {level}: the test sees no choice at all");
    }
}
