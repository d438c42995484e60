//! Claims that nobody has a right to: real readers look at films of scenes that carry no mark, and keys claim their own
//! messages in them.
//!
//! Given all logits, every reading claims a message of its own, which follows from a secret that nothing else in the
//! test depends on. So the p-values are independent of one another however alike films and readers are, and the bounds
//! below are those of independent trials.

use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose};
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::id_code::SearchedP;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::payload::Payload;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::evidence::statistics::{SoftScoreNull, after_search, binomial_tail, match_p_value};
use guard4d_engine::media::Frame;
use guard4d_engine::release::evaluate::HeldOut;
use guard4d_engine::render::render_frames;
use guard4d_engine::scene::camera::classes::CameraClass;
use guard4d_engine::scene::camera::paths::{Band, Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt, Model, procedural};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Profile, Subject};
use guard4d_engine::watermark::extractor::calibration::Calibration;
use guard4d_engine::watermark::extractor::reader::{Reader, decode};
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_engine::watermark::key::owner_key::Key;
use nalgebra::{DMatrix, DVector};

use super::p_value_chart;
use crate::support::close::{assert_close, largest};
use crate::support::gpu::{Gpu, unwatched_device};
use crate::support::owner::Owner;
use crate::support::random::Random;
use crate::support::{repo, trained};

/// Bits of the keys whose rotations are drawn for the choice among several.
const BITS: usize = 48;
/// Scenes that are filmed: the built-in one, and random ones.
const SCENES: u64 = 10;
/// Films of each: ten from anywhere, and one of each class of cameras.
const FILMS: usize = 10 + CameraClass::ALL.len();
/// Frames of a film.
const FRAMES: usize = 4;
/// Sides of a frame, px.
const SIDE_PX: u32 = 64;
/// Secrets that read with the rotation and the zero of their own, for each of the two decoders.
const SECRETS: u64 = 250;
/// All readings.
const READINGS: usize = 2 * SECRETS as usize * SCENES as usize * FILMS;
const PICTURE: &str = "docs/images/false-claims.svg";

/// Unmarked 8-bit films of everything: all around, from below the horizon to above, near and far, and of every class of
/// cameras. The readers frame them by what the built-in scene looks like, those of the other scenes too.
fn films(gpu: &Gpu) -> Vec<Vec<Frame>> {
    let demo = DemoScene::unpack().expect("the scene unpacks");
    let mut films = Vec::new();
    for number in 0..SCENES {
        let model = match number {
            0 => Model::open(demo.path()).expect("the scene opens"),
            _ => procedural::scene(&mut prf(3, number).stream(Purpose::Scenes, 0)).expect("a scene"),
        };
        let band = Band { elevation_deg: -20.0..=80.0, distance: 0.75..=1.5, ..Band::around(LookAt::D_NERF, lens()) };
        let times: Vec<f32> = (0..FRAMES).map(|i| i as f32 / FRAMES as f32).collect();
        let anywhere = band.sample(10, 90 + number).expect("cameras");
        let classes = CameraClass::ALL.map(|class| class.cameras(LookAt::D_NERF, lens(), 1).expect("cameras"));
        for cameras in [anywhere].into_iter().chain(classes) {
            films.extend(render_frames(gpu, &model, &cameras.at_times(&times)).expect("films"));
        }
    }
    assert!(films.len() == SCENES as usize * FILMS && films.iter().all(|film| film.len() == FRAMES), "all films");
    films
}

/// One of the secrets of one kind.
fn prf(kind: u8, number: u64) -> Prf {
    let mut secret = [kind; 32];
    secret[..8].copy_from_slice(&number.to_le_bytes());
    Prf::new(&MasterSecret::from_bytes(secret))
}

/// A trained decoder with an extractor that was fitted to the built-in scene, and what they see.
struct Readers<'a> {
    gpu: &'a Gpu,
    key: &'a Key,
    extractor: ExtractorWeights,
    /// Features of unmarked films of the built-in scene, which set the zero `[n, D]`.
    zero: Vec<f32>,
    /// Features of all films `[films · FRAMES, D]`.
    films: Vec<f32>,
}

impl<'a> Readers<'a> {
    fn new(gpu: &'a Gpu, key: &'a Key, mode: ExtractorMode, films: &[Vec<Frame>]) -> Self {
        let clip = trained::clip(gpu);
        let demo = DemoScene::unpack().expect("the scene unpacks");
        let model = Model::open(demo.path()).expect("the scene opens");
        let message = key.own_message();
        let config = EmbedConfig::new(Profile::Draft, mode).with(|c| {
            c.views.clips = 12;
            c.views.size_px = (SIDE_PX, SIDE_PX);
            c.optimiser.held_out_every = 0;
            c.open_weights().expect("our own file");
        });
        let subject = Subject { device: gpu, clip: &clip, key, model: &model, message: &message };
        let extractor = Embedding::prepare(subject, config).expect("prepares").fitted().clone();
        assert!(extractor.known_views.is_some(), "films are framed");
        let mut reader = Reader::new(gpu, &clip, key, &extractor).expect("belongs to the key");
        let mut look = |films: &[Vec<Frame>]| -> Vec<f32> {
            films.iter().flat_map(|film| reader.look(film).expect("reads").features).collect()
        };
        let zero = look(&render_frames(gpu, &model, &orbit()).expect("films"));
        let films = look(films);
        Self { gpu, key, extractor, zero, films }
    }

    /// Mean logits of each film as a secret reads them that mixes the directions in its own way and sets the zero of
    /// that.
    fn read(&self, secret: &Prf) -> Vec<Reading> {
        let bits = self.key.num_bits();
        let rotation = |prf: &Prf| prf.stream(Purpose::Calibration, 0);
        let own = self.extractor.calibration.mixed_anew(&mut rotation(&self.key.prf()), &mut rotation(secret));
        // Zero and films in one go: folding the calibration into a decoder is what takes time.
        let seen = self.decode(&own, &[self.zero.as_slice(), &self.films].concat());
        let (at_zero, films) = seen.split_at(self.zero.len() / self.width() * bits as usize);
        let zero = Reading::from_logits(at_zero, bits).expect("finite logits");
        let logit = |(i, v): (usize, &f32)| (f64::from(*v) - zero.mean_logits()[i % bits as usize]) as f32;
        let logits: Vec<f32> = films.iter().enumerate().map(logit).collect();
        let of = |film: &[f32]| Reading::from_logits(film, bits).expect("finite logits");
        logits.chunks_exact(FRAMES * bits as usize).map(of).collect()
    }

    /// Fails unless [`Readers::read`] says what a calibration says that holds its zero, as a file of one does.
    fn assert_zero_is_as_in_files(&self, secret: &Prf) {
        let rotation = |prf: &Prf| prf.stream(Purpose::Calibration, 0);
        let own = self.extractor.calibration.mixed_anew(&mut rotation(&self.key.prf()), &mut rotation(secret));
        let zero = Reading::from_logits(&self.decode(&own, &self.zero), self.key.num_bits()).expect("finite logits");
        let mean_logits = zero.mean_logits().iter().map(|v| *v as f32).collect();
        let film = &self.films[..FRAMES * self.width()];
        let logits = self.decode(&Calibration { mean_logits, ..own }, film);
        let want = Reading::from_logits(&logits, self.key.num_bits()).expect("finite logits");
        let single = |reading: &Reading| reading.mean_logits().iter().map(|v| *v as f32).collect::<Vec<_>>();
        // Two ways to round the sum of a bias of size ten.
        assert_close(&single(&self.read(secret)[0]), &single(&want), 1e-4, 1e-5);
    }

    fn decode(&self, calibration: &Calibration, features: &[f32]) -> Vec<f32> {
        decode(self.gpu, self.key, calibration, features).expect("decodes")
    }

    fn width(&self) -> usize {
        self.key.text_mean.len()
    }
}

fn lens() -> Lens {
    Lens { fov_x_rad: 0.7, size: FrameSize::new(SIDE_PX, SIDE_PX).expect("a size") }
}

/// Cameras whose films set the zero.
fn orbit() -> CameraSet {
    let orbit = Orbit { views: 16, elevation_deg: 30.0, look_at: LookAt::D_NERF, lens: lens() };
    let times: Vec<f32> = (0..8u8).map(|i| f32::from(i) / 7.0).collect();
    orbit.cameras().expect("an orbit").at_times(&times)
}

/// p-values of all readings.
#[derive(Default)]
struct Claims {
    /// By the soft score, of messages that no other reading claims.
    soft: Vec<f64>,
    /// By the matches of the same.
    matched: Vec<f64>,
    /// The latter, spread evenly over the step that they end.
    spread: Vec<f64>,
    /// By the soft score, of the reading secret's own message in one film each.
    own: Vec<f64>,
}

impl Claims {
    fn add(&mut self, readers: &Readers<'_>, random: &mut Random) {
        let bits = readers.key.num_bits();
        let message = |prf: &Prf| Payload::Random(bits).message(prf).expect("a length of messages");
        let p_of =
            |reading: &Reading, claim: &Message| SearchedP::of(reading, claim, 1).expect("as many bits").soft_score;
        for number in 0..SECRETS {
            let secret = prf(bits as u8, number);
            let readings = readers.read(&secret);
            let one = number as usize % readings.len();
            self.own.push(p_of(&readings[one], &message(&secret)));
            for (film, reading) in readings.iter().enumerate() {
                let claim = message(&prf(bits as u8 + 1, number << 32 | film as u64));
                self.soft.push(p_of(reading, &claim));
                let matches = reading.matches(&claim).expect("as many bits");
                let (p, above) = (match_p_value(matches, bits), match_p_value(matches + 1, bits));
                self.matched.push(p);
                self.spread.push(p - random.uniform(0.0, 1.0) * (p - above));
            }
        }
    }
}

/// Kolmogorov's distance from the uniform distribution.
fn distance(p_values: &[f64]) -> f64 {
    let mut sorted = p_values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let gap = |(i, p): (usize, &f64)| largest([p - i as f64 / n, (i + 1) as f64 / n - p]);
    largest(sorted.iter().enumerate().map(gap))
}

#[test]
fn a_hundred_thousand_claims_in_unmarked_films_are_as_good_as_chance_makes_them() {
    let Some(gpu) = unwatched_device() else { return };
    let clip = trained::clip(&gpu);
    let films = films(&gpu);
    let (mut claims, mut random) = (Claims::default(), Random(48));
    let keys = [
        (trained::key_of_16(&gpu, &clip), ExtractorMode::Blind),
        (trained::key_of_32(&gpu, &clip), ExtractorMode::Pretrained),
    ];
    for (key, mode) in keys {
        let readers = Readers::new(&gpu, key, mode, &films);
        readers.assert_zero_is_as_in_files(&prf(0, 0));
        claims.add(&readers, &mut random);
    }
    let Claims { soft, matched, spread, own } = &claims;
    assert!(soft.len() == READINGS && matched.len() == READINGS && READINGS >= 100_000, "{} readings", soft.len());
    for (what, p_values) in [("soft score", soft), ("matches", matched)] {
        assert!(p_values.iter().all(|p| (0.0..=1.0).contains(p)), "{what}: probabilities");
        for rate in [1e-1, 1e-2, 1e-3, 1e-4, 1e-5] {
            let count = p_values.iter().filter(|p| **p <= rate).count() as u32;
            // An exact test exceeds this once in a million times.
            let chance = binomial_tail(count, READINGS as u32, rate);
            println!("{what}: {count} of {READINGS} at {rate}");
            assert!(chance > 1e-6, "{what}: {count} of {READINGS} at {rate}, which chance does at {chance}");
        }
    }
    // Kolmogorov's bound at 1e-3. A soft score is shared by few messages: its p-values come in steps of 2^-16, a
    // hundredth of the bound, so that they are compared with the uniform distribution as they are.
    for (what, p_values) in [("soft score", soft), ("matches, spread over their steps", spread), ("own", own)] {
        let (found, bound) = (distance(p_values), 1.95 / (p_values.len() as f64).sqrt());
        println!("{what}: distance from uniform {found} of {}, at most {bound}", p_values.len());
        assert!(found < bound, "{what}: distance from uniform {found}, at most {bound}");
    }
    if std::env::var_os("GUARD4D_RENEW").is_some_and(|value| value == "1") {
        let series = [("soft score", soft.as_slice()), ("matching bits", matched.as_slice())];
        std::fs::write(repo(PICTURE), p_value_chart::svg(series)).expect("writable");
    }
}

/// Coordinates of unmarked clips along the pretrained extractor's directions, before any key mixes them `[clips][L]`.
fn unmarked(gpu: &Gpu) -> Vec<Vec<f64>> {
    let owner = Owner::with_bits(gpu, BITS as u32);
    let config = EmbedConfig::new(Profile::Draft, ExtractorMode::Pretrained).with(|c| {
        c.views.clips = 12;
        c.views.size_px = (64, 64);
        c.open_weights().expect("our own file");
        c.optimiser.held_out_every = 0;
    });
    let embedding = Embedding::prepare(owner.subject(gpu), config).expect("prepares");
    let extractor = embedding.fitted();
    let clean = HeldOut::render(gpu, &owner.model, &owner.model.gaussians.sh_coeffs, &orbit()).expect("films").clean;
    let mut reader = Reader::new(gpu, &owner.clip, &owner.key, extractor).expect("belongs to the key");
    let coordinates = |clip: &Vec<_>| extractor.calibration.coordinates(&reader.look(clip).expect("reads").features);
    clean.iter().map(coordinates).collect()
}

/// What a key whose rotation nobody chose reads in a clip.
fn read_anyhow(clip: &[f64], random: &mut Random) -> SoftScoreNull {
    let clip = DVector::from_column_slice(clip);
    assert!(clip.iter().all(|z| z.is_finite()), "coordinates of a clip");
    // Sums of twelve uniform numbers are normal enough for a rotation.
    let gaussian = DMatrix::from_fn(BITS, BITS, |_, _| (0..12).map(|_| random.uniform(-0.5, 0.5)).sum::<f64>());
    let read = gaussian.qr().q().tr_mul(&clip);
    SoftScoreNull::new(read.as_slice()).expect("finite")
}

fn any_message(random: &mut Random) -> Message {
    let bits: Vec<bool> = (0..BITS).map(|_| random.uniform(0.0, 1.0) < 0.5).collect();
    Message::from_bits(&bits).expect("48 bits")
}

/// Whoever chooses the rotation that fits best even with the clip in hand has no more than the chances that are
/// counted.
#[test]
fn the_best_of_several_rotations_is_no_better_than_what_is_counted_for_the_choice() {
    let Some(gpu) = unwatched_device() else { return };
    let clips = unmarked(&gpu);
    let (choices, keys, claims) = (16, 125, 200);
    let mut random = Random(16);
    let (mut counted, mut alone) = (0, 0);
    for key in 0..keys {
        let rotations: Vec<_> = (0..choices).map(|_| read_anyhow(&clips[key % clips.len()], &mut random)).collect();
        for _ in 0..claims {
            let message = any_message(&mut random);
            let all: Vec<f64> = rotations.iter().map(|null| null.p_value(&message).expect("48 bits")).collect();
            assert!(all.iter().all(|p| p.is_finite()), "{all:?}");
            let least = -largest(all.into_iter().map(|p| -p));
            counted += u32::from(after_search(least, choices) <= 1e-2);
            alone += u32::from(least <= 1e-2);
        }
    }
    // Of 25,000 at 1e-2 at most 250 are due, within five standard deviations of 16; rotations that are as good as
    // independent leave little of that unused. Uncounted, 1 - 0.99^16 of them would be false: 3,700.
    assert!((170..=330).contains(&counted), "{counted} of 25,000 at 1e-2");
    assert!(alone > 3_000, "{alone} of 25,000 without counting");
}
