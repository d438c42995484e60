//! Copies differ from their original by as much as was asked for.

use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::fidelity::{DEFAULT_PSNR_DB, strength_for};
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::picture::metrics::{Picture, PsnrSummary, SquaredError};
use guard4d_engine::render::render_frames;
use guard4d_engine::scene::Model;
use guard4d_engine::scene::demo::DemoScene;

use crate::support::gpu::device;

#[test]
fn copies_keep_the_psnr_that_was_asked_for() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let prf = Prf::new(&MasterSecret::from_bytes([31; 32]));
    // The scene's own cameras and times, and a copy that is not the one that was measured.
    let cameras = scene.cameras((200, 200)).expect("cameras");
    let clean = render_frames(&gpu, &model, &cameras).expect("renders").concat();
    for asked in [DEFAULT_PSNR_DB, 52.0] {
        let strength = strength_for(&gpu, Issue::new(&model, prf.clone(), 1.0), asked).expect("measures");
        let mut copy = Model::open(scene.path()).expect("the scene opens");
        copy.gaussians.sh_coeffs = Issue::new(&model, prf.clone(), strength).stamp(3);
        let marked = render_frames(&gpu, &copy, &cameras).expect("renders").concat();
        let error = |(a, b)| SquaredError::between(&Picture::from_frame(a), &Picture::from_frame(b)).expect("one size");
        let errors: Vec<SquaredError> = clean.iter().zip(&marked).map(error).collect();
        let psnr = PsnrSummary::of(&errors).expect("there are frames").pooled_db.0;
        // Other views, and 8 bits: their rounding alone is 59 dB.
        assert!((psnr - asked).abs() < 1.5, "{psnr} dB for {asked}");
    }
    for wrong in [0.0, f64::NAN, f64::INFINITY] {
        let refused = strength_for(&gpu, Issue::new(&model, prf.clone(), 1.0), wrong);
        assert!(matches!(refused, Err(EngineError::Usage { .. })), "{wrong}: {refused:?}");
    }
}
