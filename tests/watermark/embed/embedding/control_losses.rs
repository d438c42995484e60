//! Every control loss leaves numbers behind, or says that it could not.

use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::watermark::embed::{Control, EmbedConfig, Embedded, Embedding, JointConfig, StepReport};

use crate::support::gpu::{Gpu, device};
use crate::support::owner::{BITS, Owner};

/// Control losses and seeds. The paper leaves ε open; these are the ends of what anyone would take, and one between.
/// The smallest has the steepest slopes, and so the most seeds.
const CASES: [(&str, &[u64]); 6] = [
    ("inverse-bce:1e-6", &[0, 1, 2]),
    ("inverse-bce:1e-3", &[0]),
    ("inverse-bce:1", &[1]),
    ("hinge:1e-6", &[0, 2]),
    ("hinge:1", &[0]),
    ("chance", &[0]),
];
const STEPS: usize = 8;

fn control(text: &str) -> Control {
    text.parse().expect("a control loss")
}

fn config(owner: &Owner, control: Control) -> EmbedConfig {
    owner.config_of(ExtractorMode::Joint).with_probes(BITS as usize).with(|c| {
        c.optimiser.steps = STEPS;
        c.views.clips = 1;
        c.views.size_px = (32, 32);
        joint(c).control = control;
    })
}

/// Settings of `joint`.
fn joint(config: &mut EmbedConfig) -> &mut JointConfig {
    config.extractor.joint_mut().expect("it is joint")
}

fn train(gpu: &Gpu, owner: &Owner, config: EmbedConfig) -> Result<(Vec<StepReport>, Embedded), EngineError> {
    let mut embedding = Embedding::prepare(owner.subject(gpu), config)?;
    let mut reports = Vec::new();
    while let Some(report) = embedding.step()? {
        reports.push(report);
    }
    Ok((reports, embedding.finish()?))
}

/// Every number that a file would hold.
fn numbers(embedded: &Embedded) -> impl Iterator<Item = &f32> {
    let layers = embedded.extractor.tmsd.iter().flat_map(|tmsd| &tmsd.layers).flatten();
    let calibration = &embedded.extractor.calibration;
    embedded.sh_coeffs.iter().chain(layers).chain(&calibration.mean_logits).chain(&calibration.directions)
}

#[test]
fn losses_and_weights_of_every_control_are_finite() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    for (text, seeds) in CASES {
        for &seed in seeds {
            let config = config(&owner, control(text)).with(|c| c.seed = seed);
            let (reports, embedded) = train(&gpu, &owner, config).expect("trains");
            let bad = reports.iter().find(|r| ![r.message, r.control, r.mse, r.total].iter().all(|v| v.is_finite()));
            assert!(bad.is_none() && reports.len() == STEPS, "{text}, seed {seed}: {bad:?}");
            assert!(reports.iter().all(|r| r.control > 0.0), "{text}, seed {seed}: the control was read");
            assert!(numbers(&embedded).all(|v| v.is_finite()), "{text}, seed {seed}: weights");
        }
    }
}

#[test]
fn training_that_blows_up_says_so_and_hands_out_nothing() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    // Rates that make R overflow. The first loss is finite, so after one step only the end can tell.
    for (steps, lr_tmsd) in [(1, 1e38), (STEPS, 1e10)] {
        let config = config(&owner, control("inverse-bce:1e-6")).with(|c| {
            c.optimiser.steps = steps;
            joint(c).lr_tmsd = lr_tmsd;
        });
        match train(&gpu, &owner, config) {
            Ok((_, embedded)) => assert!(numbers(&embedded).all(|v| v.is_finite()), "{steps} steps at {lr_tmsd:e}"),
            Err(error) => assert!(matches!(error, EngineError::NotFinite { .. }), "{steps} steps: {error}"),
        }
    }
    let config = config(&owner, control("inverse-bce:1e-6")).with(|c| joint(c).lr_tmsd = 1e38);
    let error = train(&gpu, &owner, config).expect_err("no convolution survives weights of 1e38");
    assert!(matches!(error, EngineError::NotFinite { .. }), "{error}");
}
