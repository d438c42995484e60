//! What moves features: sums over assets, the best directions, and what is refused.

use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::watermark::extractor::scatter::{AssetFeatures, Scatter};
use nalgebra::DMatrix;

use crate::support::random::Random;

const WIDTH: usize = 12;
const FIELDS: usize = 10;
const FRAMES: usize = 4;

/// Features of an asset whose content lies along early axes and whose responses along late ones.
struct Asset {
    content: Vec<f32>,
    copies: Vec<f32>,
    responses: Vec<f32>,
}

impl Asset {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let mut along = |rows: usize, size: &dyn Fn(usize) -> f64| -> Vec<f32> {
            (0..rows * WIDTH).map(|i| (random.uniform(-1.0, 1.0) * size(i % WIDTH)) as f32).collect()
        };
        let content = along(40, &|axis| 1.0 / (1 + axis) as f64);
        let copies = along(6, &|axis| if axis == 3 { 2.0 } else { 0.1 });
        let responses = along(FIELDS * FRAMES, &|axis| 0.02 * axis as f64);
        Self { content, copies, responses }
    }

    fn features(&self) -> AssetFeatures<'_> {
        let Self { content, copies, responses } = self;
        AssetFeatures { content, copies, responses, frames: FRAMES, width: WIDTH }
    }

    fn scatter(&self) -> Scatter {
        Scatter::of(&self.features()).expect("finite features")
    }
}

#[test]
fn the_discriminants_separate_better_than_any_other_directions() {
    let scatter = Asset::new(1).scatter();
    let best = scatter.separation(&scatter.discriminants(3).expect("independent responses")).expect("directions");
    let mut random = Random(2);
    for _ in 0..200 {
        let any = DMatrix::from_fn(WIDTH, 3, |_, _| random.uniform(-1.0, 1.0));
        let reached = scatter.separation(&any).expect("directions");
        // Rounding of products of a dozen numbers of order 1.
        assert!(reached <= best * (1.0 + 1e-9), "{reached} with random directions, {best} with the best");
    }
    // In falling order: the first alone is better than all three together.
    let first = scatter.separation(&scatter.discriminants(1).expect("a response")).expect("a direction");
    assert!(first >= best, "{first} of the first, {best} of three");
}

#[test]
fn each_direction_answers_with_one() {
    let asset = Asset::new(3);
    let directions = asset.scatter().discriminants(4).expect("independent responses");
    for column in directions.column_iter() {
        let mean = |field: usize| {
            let frame = |f: usize| &asset.responses[(field * FRAMES + f) * WIDTH..][..WIDTH];
            let term = |f: usize| frame(f).iter().zip(column.iter()).map(|(r, v)| f64::from(*r) * v).sum::<f64>();
            (0..FRAMES).map(term).sum::<f64>() / FRAMES as f64
        };
        let square = (0..FIELDS).map(|field| mean(field).powi(2)).sum::<f64>() / FIELDS as f64;
        // f32 features, f64 sums.
        assert!((square - 1.0).abs() < 1e-6, "mean square response {square}");
    }
}

#[test]
fn a_sum_is_the_same_in_any_order_and_after_a_file() {
    let [a, b, c] = [4, 5, 6].map(|seed| Asset::new(seed).scatter());
    let (left, right) = (a.with(&b).with(&c), c.with(&a).with(&b));
    let mut file = TensorFile::default();
    left.store(&mut file);
    let read = Scatter::load(&file).expect("just stored");
    assert_eq!(read, left, "sums are kept as files hold them");
    let ratio = |of: &Scatter, by: &Scatter| of.separation(&by.discriminants(4).expect("responses")).expect("finite");
    for (one, other) in [(&left, &right), (&left, &read)] {
        // Rows of responses are rounded to f32 in another order; directions of like ratios may turn among each other.
        let (own, theirs) = (ratio(one, one), ratio(one, other));
        assert!((theirs / own - 1.0).abs() < 1e-3, "{theirs} against {own}");
    }
    // Thirty rows of responses are kept in as many as there are columns.
    assert_eq!(file.get("scatter.responses").expect("stored").shape, [WIDTH, WIDTH]);
}

#[test]
fn what_cannot_be_fitted_is_refused() {
    let asset = Asset::new(7);
    let no = Asset { content: Vec::new(), ..Asset::new(7) };
    let broken = Asset { copies: vec![f32::NAN; WIDTH], ..Asset::new(7) };
    for bad in [no, broken] {
        let error = Scatter::of(&bad.features()).expect_err("nothing to fit to");
        assert!(matches!(error, EngineError::NotFinite { .. }), "{error}");
    }
    let silent = Asset { responses: vec![0.0; FIELDS * FRAMES * WIDTH], ..asset };
    assert!(silent.scatter().discriminants(1).is_err(), "offsets that move nothing");
    assert!(Asset::new(8).scatter().discriminants(FIELDS + 1).is_err(), "more bits than fields");
    let mut file = TensorFile::default();
    Asset::new(9).scatter().store(&mut file);
    file.tensors.get_mut("scatter.noise").expect("stored").shape = vec![WIDTH * WIDTH];
    assert!(Scatter::load(&file).is_err(), "a matrix that is none");
}
