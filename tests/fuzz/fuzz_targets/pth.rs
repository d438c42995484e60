//! State dicts, and the networks in them.
#![no_main]

use std::path::Path;

use guard4d_engine::scene::DeformationWeights;
use guard4d_engine::scene::deformation::derive_config;
use guard4d_engine::scene::pth::PthContent;
use guard4d_engine::scene::warp::WarpWeights;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let path = Path::new("deformation.pth");
    let Ok(PthContent::StateDict(tensors)) = PthContent::parse(path, data) else { return };
    let _ = WarpWeights::from_state_dict(path, tensors.clone());
    if let Ok(config) = derive_config(path, &tensors) {
        let _ = DeformationWeights::from_state_dict(path, tensors, config);
    }
});
