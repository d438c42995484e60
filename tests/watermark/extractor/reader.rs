//! Frames that come one after the other are seen as frames that are all there.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::media::Frame;
use guard4d_engine::picture::undo_guess::UndoGuess;
use guard4d_engine::watermark::extractor::calibration::Calibration;
use guard4d_engine::watermark::extractor::reader::{ClipFeatures, Reader};
use guard4d_engine::watermark::extractor::rotation::KeyRotation;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;

use crate::support::gpu::device;
use crate::support::owner::Owner;
use crate::support::random::Random;

#[test]
fn frames_are_seen_alike_whether_they_come_together_or_one_by_one() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let width = owner.key.text_mean.len();
    let extractor = ExtractorWeights {
        mode: ExtractorMode::Blind,
        tmsd: None,
        calibration: Calibration {
            mean_image: vec![0.0; width],
            directions: Random(31).vec_f32(width * owner.key.bits(), -1.0, 1.0),
            mean_logits: vec![0.0; owner.key.bits()],
        },
        key_rotation: KeyRotation::FIXED,
        known_views: None,
        content: None,
    };
    let mut reader = Reader::new(&gpu, &owner.clip, &owner.key, &extractor).expect("belongs to the key");
    let frame = |t: u32, side: u32| {
        Frame::new(side, side, (0..3 * side * side).map(|i| ((i * (t + 3)) % 251) as u8).collect()).expect("it fits")
    };
    let frames: Vec<_> = (0..11).map(|t| frame(t, 24)).collect();
    // Less than a clip of eight, a clip, a clip and a part.
    for count in [1, 8, 11] {
        let together = reader.look(&frames[..count]).expect("sees");
        assert_eq!(together.logits.len(), count * owner.key.bits(), "{count} frames");
        let mut feature_stream = reader.stream(&[UndoGuess::NONE], Vec::new());
        for frame in &frames[..count] {
            feature_stream.push(frame.clone()).expect("sees");
        }
        // The same clips in the same kernels.
        assert!(feature_stream.finish().expect("sees")[0] == together, "{count} frames");
    }
    assert!(
        reader.stream(&[UndoGuess::NONE], Vec::new()).finish().expect("nothing to see")[0] == ClipFeatures::default(),
        "no frame"
    );
    let mut feature_stream = reader.stream(&[UndoGuess::NONE], Vec::new());
    let pushed: Result<Vec<()>, _> = (0..7).map(|t| feature_stream.push(frame(t, 24))).collect();
    assert_eq!(pushed.expect("of one size").len(), 7, "frames");
    let error = feature_stream.push(frame(7, 32)).expect_err("another size");
    assert!(error.exit_code() == 2 && error.to_string().contains("32 x 32 px"), "{error}");
}
