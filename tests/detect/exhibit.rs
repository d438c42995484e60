//! Frames that a report shows, and the original's beside them.

use guard4d_engine::detect::exhibit::{Exhibit, difference};
use guard4d_engine::detect::request::{VerifyInputs, VerifyRequest};
use guard4d_engine::detect::suspect::Suspect;
use guard4d_engine::detect::verify_cache::VerifyCache;
use guard4d_engine::media::{Frame, ReadOptions};

use crate::support::gpu::device;
use crate::support::owner::{Owner, delivered};
use crate::support::random::Random;

/// A frame of one colour with a little noise.
fn frame(colour: u8, random: &mut Random) -> Frame {
    let noisy = |_| colour + random.uniform(0.0, 4.0) as u8;
    Frame::new(16, 12, (0..16 * 12 * 3).map(noisy).collect()).expect("a size")
}

fn exhibit(picture: Frame) -> Exhibit {
    Exhibit { clip: "film".to_owned(), frame: 0, picture }
}

#[test]
fn the_nearest_view_of_the_original_is_found_and_told_from_another_camera() {
    let mut random = Random(5);
    let clean: Vec<Vec<Frame>> =
        (0..3u8).map(|view| (0..4u8).map(|t| frame(60 * view + 10 * t, &mut random)).collect()).collect();
    let near = exhibit(frame(60 + 30, &mut random)).nearest(&clean).expect("sizes fit").expect("views");
    assert_eq!((near.view, near.frame), (1, 3), "{:?}", near.psnr);
    assert!(near.is_same_view(), "noise of four levels: {:?}", near.psnr);
    let far = exhibit(frame(200, &mut random)).nearest(&clean).expect("sizes fit").expect("views");
    assert!((far.view, far.frame) == (2, 3) && !far.is_same_view(), "50 levels away: {:?}", far.psnr);
    let same = exhibit(clean[2][0].clone()).nearest(&clean).expect("sizes fit").expect("views");
    assert!(same.psnr.0.is_infinite() && same.is_same_view(), "the frame itself");
    let large = exhibit(clean[1][2].resized((32, 24)).expect("a size")).nearest(&clean).expect("sizes fit");
    let large = large.expect("views");
    assert_eq!((large.view, large.frame, large.picture.width()), (1, 2, 32), "brought to the film's size");
    assert!(exhibit(clean[0][0].clone()).nearest(&[]).expect("nothing to compare").is_none());
}

#[test]
fn differences_are_made_larger_up_to_white() {
    let of = |samples: &[u8]| Frame::new(1, 2, samples.to_vec()).expect("a size");
    let (a, b) = (of(&[0, 10, 255, 7, 7, 7]), of(&[3, 0, 0, 7, 8, 6]));
    assert_eq!(difference(&a, &b, 20).expect("one size").rgb(), [60, 200, 255, 0, 20, 20]);
    assert!(difference(&a, &Frame::new(2, 1, vec![0; 6]).expect("a size"), 20).is_err(), "another shape");
}

/// Numbers of the frames shown of clips of these lengths, each clip by its place.
fn shown(lengths: &[u8]) -> Vec<(usize, u64)> {
    let Some(gpu) = device() else { return Vec::new() };
    let owner = Owner::new(&gpu);
    // Each frame says its number by its colour.
    let frames = |length: u8| (0..length).map(|i| Frame::new(32, 32, vec![i; 32 * 32 * 3]).expect("a size")).collect();
    let suspects = lengths.iter().enumerate();
    let suspects = suspects.map(|(at, &length)| Suspect::Frames { name: at.to_string(), frames: frames(length) });
    let inputs = VerifyInputs { suspects: suspects.collect(), ..VerifyInputs::default() };
    let receipt = delivered(&gpu).join("out/private/receipt.json");
    let request = VerifyRequest {
        device: &gpu,
        clip: &owner.clip,
        key: &owner.key,
        sought: None,
        receipt: &receipt,
        pretrained: None,
        original: None,
        trusted_clip: None,
        claims: std::num::NonZeroU32::MIN,
        cache: &VerifyCache::default(),
    };
    let report = request.verify(&inputs, &ReadOptions::default()).expect("reads");
    let told = report.exhibits.iter().map(|exhibit| {
        assert_eq!(u64::from(exhibit.picture.rgb()[0]), exhibit.frame, "the frame that it says");
        (exhibit.clip.parse().expect("a number"), exhibit.frame)
    });
    told.collect()
}

#[test]
fn frames_from_all_over_the_first_clips_are_shown() {
    if device().is_none() {
        return;
    }
    assert_eq!(shown(&[1]), [(0, 0)]);
    assert_eq!(shown(&[3]), [(0, 0), (0, 1), (0, 2)]);
    let long: Vec<u64> = shown(&[50]).into_iter().map(|(_, frame)| frame).collect();
    assert!(
        long.len() == 3 && long[0] < 17 && (17..34).contains(&long[1]) && long[2] >= 34,
        "one of each third: {long:?}"
    );
    let clips: Vec<usize> = shown(&[4, 9, 2, 7]).into_iter().map(|(clip, _)| clip).collect();
    assert_eq!(clips, [0, 1, 2], "one of each");
    let clips: Vec<usize> = shown(&[4, 9]).into_iter().map(|(clip, _)| clip).collect();
    assert_eq!(clips, [0, 0, 1]);
}
