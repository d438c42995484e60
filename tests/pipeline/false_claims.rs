//! A million claims that nobody has a right to: unmarked clips through the pretrained extractor, read by random keys.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::statistics::{SoftScoreNull, after_search};
use guard4d_engine::release::evaluate::HeldOut;
use guard4d_engine::scene::FrameSize;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Profile};
use guard4d_engine::watermark::extractor::reader::Reader;
use nalgebra::{DMatrix, DVector};

use crate::support::close::largest;
use crate::support::gpu::{Gpu, device};
use crate::support::owner::Owner;
use crate::support::random::Random;

const BITS: usize = 48;
/// Rotations of the directions, one of them per key's secret.
const ROTATIONS: usize = 2000;
/// Messages claimed with each.
const CLAIMS: usize = 500;

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
    let lens = Lens { fov_x_rad: 0.7, size: FrameSize::new(64, 64).expect("a size") };
    let orbit = Orbit { views: 16, elevation_deg: 30.0, radius: 4.0, target: glam::Vec3::ZERO, lens };
    let times: Vec<f32> = (0..8u8).map(|i| f32::from(i) / 7.0).collect();
    let cameras = orbit.cameras().expect("an orbit").at_times(&times);
    let clean = HeldOut::render(gpu, &owner.model, &owner.model.gaussians.sh_coeffs, &cameras).expect("films").clean;
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

#[test]
fn a_million_claims_on_unmarked_clips_are_as_good_as_chance_makes_them() {
    let Some(gpu) = device() else { return };
    let clips = unmarked(&gpu);
    assert_eq!(clips.len(), 16, "one clip per camera");
    let mut random = Random(48);
    let (mut p_values, mut counts) = (Vec::new(), [0u32; 3]);
    for key_rotation in 0..ROTATIONS {
        let null = read_anyhow(&clips[key_rotation % clips.len()], &mut random);
        for claim in 0..CLAIMS {
            let p = null.p_value(&any_message(&mut random)).expect("48 bits");
            for (count, rate) in counts.iter_mut().zip([1e-2, 1e-3, 1e-6]) {
                *count += u32::from(p <= rate);
            }
            if claim < 5 {
                p_values.push(p);
            }
        }
    }
    // Expected 10,000, 1,000 and 1: within five standard deviations, and for the last what chance exceeds once in 1,500
    // times.
    let expected = [(9_500, 10_500), (840, 1_160), (0, 5)];
    for (count, (least, most)) in counts.into_iter().zip(expected) {
        assert!((least..=most).contains(&count), "{counts:?} of a million at 1e-2, 1e-3 and 1e-6");
    }
    p_values.sort_by(f64::total_cmp);
    let n = p_values.len() as f64;
    let distance = |(i, p): (usize, &f64)| (p - i as f64 / n).abs().max((p - (i + 1) as f64 / n).abs());
    let distance = largest(p_values.iter().enumerate().map(distance));
    // Kolmogorov's bound at 1e-3: 1.95 / √n; ten thousand p-values.
    assert!(n == 10_000.0 && distance < 1.95 / n.sqrt(), "distance from uniform {distance} of {n}");
}

/// Whoever chooses the rotation that fits best even with the clip in hand has no more than the chances that are
/// counted.
#[test]
fn the_best_of_several_rotations_is_no_better_than_what_is_counted_for_the_choice() {
    let Some(gpu) = device() else { return };
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
