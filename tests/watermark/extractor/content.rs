//! What unmarked frames say is foretold by what they show, and not by more.

use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::watermark::extractor::content::{ContentModel, FittedContent, MOST_VIEWS, THUMBNAIL_LEN};

use crate::support::random::Random;

const WIDTH: usize = 5;
const VIEWS: usize = 60;

/// What is seen from a place on a circle: every texel waves once or twice around it.
fn thumbnail(place: f32) -> Vec<f32> {
    (0..THUMBNAIL_LEN).map(|i| 0.5 + 0.3 * ((1 + i % 2) as f32 * place + i as f32).sin()).collect()
}

/// What is said of it, around a mean that is not zero.
fn features(place: f32) -> Vec<f32> {
    (0..WIDTH).map(|i| i as f32 + (place + 2.0 * i as f32).cos()).collect()
}

fn place(share: f32) -> f32 {
    std::f32::consts::TAU * share
}

fn all(of: fn(f32) -> Vec<f32>) -> Vec<f32> {
    (0..VIEWS).flat_map(|i| of(place(i as f32 / VIEWS as f32))).collect()
}

fn fitted() -> FittedContent {
    ContentModel::fit(&all(thumbnail), &all(features)).expect("numbers")
}

/// Without its mean, which is that over the circle.
fn deviation(features: &[f32]) -> Vec<f32> {
    features.iter().enumerate().map(|(i, v)| v - (i % WIDTH) as f32).collect()
}

fn squares(values: &[f32]) -> f32 {
    values.iter().map(|v| v * v).sum()
}

/// |told - wanted|^2 / |wanted|^2
fn unexplained(told: &[f32], wanted: &[f32]) -> f32 {
    assert_eq!(told.len(), wanted.len(), "one for each");
    let apart: Vec<f32> = told.iter().zip(wanted).map(|(a, b)| a - b).collect();
    squares(&apart) / squares(wanted)
}

#[test]
fn views_between_those_that_are_known_are_foretold() {
    let FittedContent { model, left_out } = fitted();
    assert_eq!(model.views(), VIEWS, "all of them are remembered");
    // Views are 6 degrees apart, and features turn once in 360: next to nothing is left but for the ridge.
    for share in [0.008, 0.308, 0.508, 0.991] {
        let told = model.foretell(&thumbnail(place(share)));
        let left = unexplained(&told, &deviation(&features(place(share))));
        assert!(left < 1e-2, "{left} of a view at {share}");
    }
    let left = unexplained(&left_out, &deviation(&all(features)));
    assert!(left < 1e-2, "{left} of views by all others");
}

/// A mark that is trained through an extractor from a file has to meet the content that the first one met.
#[test]
fn a_model_knows_which_views_it_was_fitted_to_and_what_the_others_say_of_them() {
    let FittedContent { model, left_out } = fitted();
    let again = model.left_out().expect("views that differ");
    assert!(again.iter().zip(&left_out).all(|(a, b)| a.to_bits() == b.to_bits()), "the same to the bit");
    let by_heart = unexplained(&model.foretell(&all(thumbnail)), &left_out);
    assert!(by_heart > 0.0, "of its own views it says more than all others do");
    assert_eq!(model.view_of(&thumbnail(place(7.0 / VIEWS as f32))), Some(7), "one of them");
    assert_eq!(model.view_of(&thumbnail(place(0.508))), None, "one between them");
}

#[test]
fn what_looks_like_no_view_is_foretold_nothing() {
    let told = fitted().model.foretell(&[9.0; THUMBNAIL_LEN]);
    assert_eq!(told, [0.0; WIDTH], "no view is near");
}

/// By heart it would be.
#[test]
fn noise_is_not_foretold_of_a_view_by_the_others() {
    let noise = Random(3).vec_f32(VIEWS * WIDTH, -1.0, 1.0);
    let FittedContent { left_out, .. } = ContentModel::fit(&all(thumbnail), &noise).expect("numbers");
    let left = unexplained(&left_out, &noise);
    // Chance is 1 or a little more; 60 views with 5 numbers each spread it by about a tenth.
    assert!(left > 0.8, "{left} of the noise is left");
}

#[test]
fn views_that_are_all_alike_are_no_error() {
    let same: Vec<f32> = (0..VIEWS).flat_map(|_| thumbnail(0.0)).collect();
    let told = ContentModel::fit(&same, &all(features)).expect("numbers").model.foretell(&thumbnail(0.0));
    // All that can be said is the mean, from which nothing deviates; sums of 60 numbers are rounded.
    assert!(squares(&told) < 1e-6, "{told:?}");
}

#[test]
fn values_that_are_no_numbers_are_refused() {
    let mut broken = all(features);
    broken[7] = f32::NAN;
    assert!(ContentModel::fit(&all(thumbnail), &broken).is_err(), "features");
    broken = all(thumbnail);
    broken[7] = f32::INFINITY;
    assert!(ContentModel::fit(&broken, &all(features)).is_err(), "thumbnails");
    assert!(ContentModel::fit(&[], &[]).is_err(), "no view");
}

#[test]
fn files_give_back_the_same_model_and_refuse_others() {
    let model = fitted().model;
    let mut file = TensorFile::default();
    assert_eq!(ContentModel::load(&file, WIDTH).expect("nothing stored"), None, "a file without one");
    model.store(&mut file);
    assert_eq!(ContentModel::load(&file, WIDTH).expect("as stored"), Some(model.clone()), "round trip");
    assert!(ContentModel::load(&file, WIDTH + 1).is_err(), "another CLIP");
    let refused = |name: &str, tensor: Tensor| {
        let mut file = file.clone();
        file.tensors.insert(name.to_owned(), tensor);
        let error = ContentModel::load(&file, WIDTH).expect_err("not a model").to_string();
        assert!(error.contains(name), "{error}");
    };
    refused("content.reach", Tensor::f32(&[1], vec![-1.0]));
    refused("content.reach", Tensor::f32(&[1], vec![f32::NAN]));
    refused("content.ridge", Tensor::f32(&[1], vec![0.0]));
    refused("content.weights", Tensor::f32(&[0, WIDTH], Vec::new()));
    let many = MOST_VIEWS + 1;
    refused("content.weights", Tensor::f32(&[many, WIDTH], vec![0.0; many * WIDTH]));
    refused("content.thumbnails", Tensor::f32(&[1, THUMBNAIL_LEN], thumbnail(0.0)));
}

#[test]
fn another_model_is_told_from_the_same() {
    let model = fitted().model;
    assert_eq!(model.share_apart(&model), 0.0, "itself");
    let mut other = model.clone();
    other.weights[3] = f32::NAN;
    assert!(other.share_apart(&model).is_nan(), "a NaN stays one");
    other = model.clone();
    other.reach *= 1.5;
    let apart = other.share_apart(&model);
    assert!((apart - 0.5).abs() < 1e-6, "{apart}: half as far again");
    other = model.clone();
    other.weights.truncate(WIDTH);
    other.thumbnails.truncate(THUMBNAIL_LEN);
    assert!(other.share_apart(&model).is_infinite(), "fewer views");
}
