//! Whatever the scene: what is written comes back, and a mark that is taken out leaves the file as it was.

use std::path::Path;

use guard4d_engine::base::output::Existing;
use guard4d_engine::release::undo;
use guard4d_engine::scene::formats::Export;
use guard4d_engine::scene::{Gaussians, Model};
use proptest::prelude::*;

use super::super::assert_same_scene;
use crate::support::fixture;
use crate::support::random::Random;

fn written(export: Export, splats: &Gaussians) -> Model {
    let path = Path::new("scene").with_extension(export.extension());
    let bytes = export.encode(&path, splats).expect("it fits");
    Model::parse(&path, bytes).expect("our own file")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn floats_come_back_as_they_were(seed in any::<u64>(), n in 1_usize..80, degree in 0_u32..=3) {
        let splats = fixture::gaussians(n, degree, seed);
        prop_assert_eq!(&written(Export::Ply, &splats).gaussians, &splats);
        let glb = written(Export::Glb, &splats).gaussians;
        prop_assert_eq!((&glb.means, &glb.sh_coeffs), (&splats.means, &splats.sh_coeffs));
        // exp and ln, sigmoid and logit, and a norm, there and back.
        assert_same_scene(&glb, &splats, 2e-6, "GLB");
    }

    #[test]
    fn steps_stay_steps(seed in any::<u64>(), n in 1_usize..80, degree in 0_u32..=3) {
        let first = written(Export::Spz, &fixture::gaussians(n, degree, seed)).gaussians;
        let again = written(Export::Spz, &first).gaussians;
        prop_assert_eq!((&again.means, &again.scales), (&first.means, &first.scales));
        prop_assert_eq!((&again.sh_coeffs, again.sh_degree), (&first.sh_coeffs, degree));
    }

    #[test]
    fn a_mark_is_taken_out_to_the_byte(
        seed in any::<u64>(),
        n in 1_usize..40,
        degree in 0_u32..=3,
        kind in 0_usize..3,
    ) {
        let export = [Export::Ply, Export::Glb, Export::Spz][kind];
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let file = folder.path().join("scene").with_extension(export.extension());
        let private = folder.path().join("undo");
        let splats = fixture::gaussians(n, degree, seed);
        std::fs::write(&file, export.encode(&file, &splats).expect("it fits")).expect("writable");
        let model = Model::open_in_kind(&file).expect("our own file");
        let mut random = Random(seed);
        let mut marked = model.gaussians.sh_coeffs.clone();
        // Where the degree has no coefficient, files have no place for an offset.
        let used = 3 * (degree as usize + 1).pow(2);
        marked.chunks_exact_mut(48).flat_map(|c| &mut c[..used]).for_each(|h| *h += random.uniform(-0.1, 0.1) as f32);
        let stored = model.as_stored(&marked).expect("it fits");
        model.write_marked(&folder.path().join("marked"), &stored).expect("writable");
        undo::write(&private, &model, &stored).expect("writable");
        let copy = folder.path().join("marked").join(file.file_name().expect("a name"));
        prop_assert_eq!(Model::open_in_kind(&copy).expect("our own file").gaussians.sh_coeffs, stored);
        let restored = folder.path().join("restored");
        undo::restore(&copy, &private, &restored, Existing::Refuse).expect("it is ours");
        let restored = std::fs::read(restored.join(file.file_name().expect("a name"))).expect("restored");
        prop_assert!(restored == model.sources()[0].bytes(), "the original's bytes");
    }
}
