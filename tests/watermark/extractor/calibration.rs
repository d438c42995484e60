//! Modality calibration: the scale of the fit, the fold into the decoder, and what the fit refuses.

use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose};
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::watermark::extractor::calibration::{CONTENT_LEVEL, Calibration};
use guard4d_engine::watermark::extractor::scatter::AssetFeatures;

use crate::support::close::{assert_close, largest};
use crate::support::random::Random;
use crate::watermark::key::decoder::{logits, random_weights, wide};

const WIDTH: usize = 24;
const BITS: usize = 8;
const FRAMES: usize = 60;
const FIELDS: usize = 32;

/// Features of frames that vary more along early axes, and responses that move late axes more.
fn features(seed: u64) -> (Vec<f32>, Vec<f32>) {
    let mut random = Random(seed);
    let content = (0..FRAMES * WIDTH).map(|i| 1.0 + random.uniform(-1.0, 1.0) as f32 / (1 + i % WIDTH) as f32);
    let content = content.collect();
    let responses = (0..FIELDS * WIDTH).map(|i| random.uniform(-0.01, 0.01) as f32 * (i % WIDTH) as f32);
    (content, responses.collect())
}

fn fit(content: &[f32], responses: &[f32], bits: usize) -> Result<Calibration, EngineError> {
    fit_frames(content, (responses, 1), bits)
}

/// With so many frames of each field.
fn fit_frames(content: &[f32], (responses, frames): (&[f32], usize), bits: usize) -> Result<Calibration, EngineError> {
    let mut rng = Prf::new(&MasterSecret::from_bytes([7; 32])).stream(Purpose::Calibration, 0);
    Calibration::fit(&AssetFeatures { content, copies: &[], responses, frames, width: WIDTH }, bits, &mut rng)
}

fn fitted(seed: u64) -> Calibration {
    let (content, responses) = features(seed);
    fit(&content, &responses, BITS).expect("finite features")
}

/// directionsᵀ (f − mean_image)
fn projected(map: &Calibration, feature: &[f32]) -> Vec<f64> {
    let term = |j: usize, bit: usize| f64::from(map.directions[j * BITS + bit]);
    let moved = |j: usize| f64::from(feature[j]) - f64::from(map.mean_image[j]);
    (0..BITS).map(|bit| (0..WIDTH).map(|j| term(j, bit) * moved(j)).sum()).collect()
}

#[test]
fn content_sits_at_its_level_around_the_mean() {
    for seed in 0..3 {
        let (content, _) = features(seed);
        let map = fitted(seed);
        let along: Vec<f64> = content.chunks_exact(WIDTH).flat_map(|f| projected(&map, f)).collect();
        let rms = (along.iter().map(|v| v * v).sum::<f64>() / along.len() as f64).sqrt();
        // The directions are rounded to f32 once.
        assert!((rms / CONTENT_LEVEL - 1.0).abs() < 1e-5, "{rms} against {CONTENT_LEVEL}");
        for bit in 0..BITS {
            let mean: f64 = along.iter().skip(bit).step_by(BITS).sum::<f64>() / FRAMES as f64;
            assert!(mean.abs() < 1e-5, "bit {bit}: {mean}");
        }
    }
}

#[test]
fn what_moves_copies_says_nothing() {
    let (content, responses) = features(3);
    let mut rng = Prf::new(&MasterSecret::from_bytes([7; 32])).stream(Purpose::Calibration, 0);
    let mean: Vec<f32> =
        (0..WIDTH).map(|j| content.iter().skip(j).step_by(WIDTH).sum::<f32>() / FRAMES as f32).collect();
    // A step along the axis that responses move most, as far as a thousand of them.
    let copy: Vec<f32> = mean.iter().enumerate().map(|(j, v)| v + if j + 1 == WIDTH { 200.0 } else { 0.0 }).collect();
    let data = |copies| AssetFeatures { content: &content, copies, responses: &responses, frames: 1, width: WIDTH };
    let tolerant = Calibration::fit(&data(&copy), BITS, &mut rng).expect("finite features");
    let said = |map: &Calibration| largest(projected(map, &copy).iter().map(|z| z.abs()));
    // Its noise is 4e4 along that axis, and about 1e-2 along the others.
    let (before, after) = (said(&fitted(3)), said(&tolerant));
    assert!(before > 100.0 && after < 1.0, "what the copy says: {before} without, {after} with it");
    let broken = Calibration::fit(&data(&[f32::NAN; WIDTH]), BITS, &mut rng);
    assert!(matches!(broken, Err(EngineError::NotFinite { .. })), "{broken:?}");
}

#[test]
fn coordinates_are_projections_of_the_mean_feature() {
    let (content, _) = features(9);
    let map = fitted(9);
    let want = projected(&map, &content[..WIDTH]);
    let narrow = |v: &[f64]| v.iter().map(|x| *x as f32).collect::<Vec<_>>();
    // Sums of f64 products in another order.
    assert_close(&narrow(&map.coordinates(&content[..WIDTH])), &narrow(&want), 1e-6, 1e-6);
    let centre = map.coordinates(&content);
    // The mean feature of the fit is rounded to f32.
    assert!(centre.iter().all(|z| z.abs() < 1e-5), "unmarked clips have their mean at 0: {centre:?}");
}

#[test]
fn directions_shrink_as_features_grow() {
    let (content, responses) = features(4);
    let twice = |v: &[f32]| v.iter().map(|x| 2.0 * x).collect::<Vec<_>>();
    let (small, large) = (fitted(4), fit(&twice(&content), &twice(&responses), BITS).expect("finite features"));
    // The same numbers but for powers of two, through an iteration whose thresholds are relative.
    assert_close(&twice(&large.directions), &small.directions, 1e-4, 1e-4);
    assert_close(&large.mean_image, &twice(&small.mean_image), 0.0, 1e-6);
}

#[test]
fn same_key_and_features_give_the_same_map() {
    assert_eq!(fitted(5), fitted(5), "deterministic");
    assert_ne!(fitted(5), fitted(6), "features matter");
}

#[test]
fn fold_is_the_affine_map_followed_by_the_decoder() {
    let mut random = Random(7);
    let mut map = fitted(7);
    let decoder = random_weights(&mut random, WIDTH, BITS);
    let (codes, text_mean) = (random.vec_f32(BITS * WIDTH, -0.3, 0.3), random.vec_f32(WIDTH, -1.0, 1.0));
    let folded = map.fold(&decoder, &codes, &text_mean);
    for feature in features(7).0.chunks_exact(WIDTH).take(5) {
        let bits = projected(&map, feature);
        let text: Vec<f64> = (0..WIDTH)
            .map(|j| {
                f64::from(text_mean[j]) + (0..BITS).map(|b| bits[b] * f64::from(codes[b * WIDTH + j])).sum::<f64>()
            })
            .collect();
        let want: Vec<f32> = logits(&decoder, &text).iter().map(|v| *v as f32).collect();
        let got: Vec<f32> = logits(&folded, &wide(feature)).iter().map(|v| *v as f32).collect();
        // The folded weights are rounded to f32 and multiply features far from their mean.
        assert_close(&got, &want, 1e-4, 1e-4);
    }
    assert_eq!(folded.layers[1..], decoder.layers[1..], "only the first layer changes");
    map.mean_logits = random.vec_f32(BITS, -2.0, 2.0);
    let (content, _) = features(7);
    let feature = wide(&content[..WIDTH]);
    let zeroed = logits(&map.fold(&decoder, &codes, &text_mean), &feature);
    let before = logits(&folded, &feature);
    let want = before.iter().zip(&map.mean_logits).map(|(o, mean)| (o - f64::from(*mean)) as f32);
    // One more rounding of a bias below 4.
    assert_close(&zeroed.iter().map(|v| *v as f32).collect::<Vec<_>>(), &want.collect::<Vec<_>>(), 1e-6, 0.0);
}

#[test]
fn clips_that_are_all_alike_can_be_told_from_marked_ones() {
    let (content, responses) = features(10);
    let alike: Vec<f32> = content[..WIDTH].repeat(FRAMES);
    let map = fit(&alike, &responses, BITS).expect("a scene without anything in it");
    let unmarked = projected(&map, &alike[..WIDTH]);
    // The mean is rounded to f32, and the directions are large where nothing else sets their scale.
    assert!(unmarked.iter().all(|z| z.abs() < 1e-2), "where unmarked clips are: {unmarked:?}");
    let moved: Vec<f32> = alike[..WIDTH].iter().zip(&responses).map(|(f, r)| f + r).collect();
    let along = projected(&map, &moved);
    let rms = (along.iter().map(|z| z * z).sum::<f64>() / BITS as f64).sqrt();
    assert!(rms > CONTENT_LEVEL, "what an offset field does stands out: {rms}");
}

#[test]
fn directions_keep_to_what_all_views_respond_alike() {
    let mut random = Random(12);
    // Axes that vary alike, and each on its own.
    let along = |i: usize| (0..WIDTH).map(move |j| if i / 2 == j { 1.0 - 2.0 * (i % 2) as f32 } else { 0.0 });
    let content: Vec<f32> = (0..2 * WIDTH).flat_map(along).collect();
    // Late axes respond twice as much, but to half of the frames one way and to half the other.
    let frames = 2;
    let (mut alike, mut apart) = (Vec::new(), Vec::new());
    for _ in 0..FIELDS {
        let field = random.vec_f32(WIDTH, -0.1, 0.1);
        let turned = |sign: f32| {
            let of = move |(j, v): (usize, &f32)| if j < WIDTH / 2 { *v } else { 2.0 * sign * v };
            field.iter().enumerate().map(of).collect::<Vec<_>>()
        };
        apart.extend([turned(1.0), turned(-1.0)].concat());
        alike.extend([turned(1.0), turned(1.0)].concat());
    }
    let late = |responses: &[f32]| {
        let map = fit_frames(&content, (responses, frames), BITS).expect("finite features");
        let square = |rows: std::ops::Range<usize>| -> f32 {
            map.directions[rows.start * BITS..rows.end * BITS].iter().map(|v| v * v).sum()
        };
        square(WIDTH / 2..WIDTH) / square(0..WIDTH)
    };
    // For the same response they need half the length, a quarter of its square.
    assert!(late(&alike) > 0.25, "the stronger half where frames agree: {}", late(&alike));
    // Sums of f32 that cancel.
    assert!(late(&apart) < 1e-3, "nothing of them where frames do not: {}", late(&apart));
}

#[test]
fn poison_and_scarcity_are_refused() {
    let (content, responses) = features(8);
    for poison in [f32::NAN, f32::INFINITY] {
        let mut bad = content.clone();
        bad[5] = poison;
        let error = fit(&bad, &responses, BITS).expect_err("poisoned content");
        assert!(matches!(error, EngineError::NotFinite { .. }), "{error}");
        let mut bad = responses.clone();
        bad[5] = poison;
        let error = fit(&content, &bad, BITS).expect_err("poisoned responses");
        assert!(matches!(error, EngineError::NotFinite { .. }), "{error}");
    }
    for (content, responses, what) in [
        (&content[..], &responses[..(BITS - 1) * WIDTH], "fewer responses than bits"),
        (&content[..], &vec![0.0; responses.len()][..], "responses that move nothing"),
        (&content[..0], &responses[..], "no content"),
    ] {
        assert!(matches!(fit(content, responses, BITS), Err(EngineError::NotFinite { .. })), "{what}");
    }
}

#[test]
fn file_gives_back_what_was_stored() {
    let map = Calibration { mean_logits: Random(9).vec_f32(BITS, -1.0, 1.0), ..fitted(9) };
    let mut file = TensorFile::default();
    map.store(&mut file, BITS);
    assert_eq!(Calibration::load(&file, WIDTH, BITS).expect("loads"), map, "round trip");
    let error = Calibration::load(&file, WIDTH, BITS + 8).expect_err("another length").to_string();
    assert!(error.contains("calibration.directions"), "{error}");
}
