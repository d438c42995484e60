//! Model folders: what is loaded, what is refused, and what a marked copy holds.

use std::fs;
use std::path::{Path, PathBuf};

use guard4d_engine::error::EngineError;
use guard4d_engine::render::profile::Viewer;
use guard4d_engine::scene::deformation::PLANE_AXES;
use guard4d_engine::scene::{DeformationWeights, Model, Motion, ply};

use super::{assert_refused, bad_data};
use crate::support::fixture::{self, CHANNELS, MULTIRES, RESOLUTION, SPLATS, TinyModel, WIDTH};
use crate::support::pth_builder::{RawView, bare};
use crate::support::{files_below, golden, shared};

fn open_error(tiny: &TinyModel) -> EngineError {
    Model::open(tiny.path()).expect_err("the model is bad")
}

fn network(model: &Model) -> &DeformationWeights {
    model.motion.network().expect("a folder has a deformation network")
}

#[test]
fn a_folder_loads_with_all_weights_in_their_places() {
    let tiny = TinyModel::new();
    let model = Model::open(tiny.path()).expect("the fixture is a good model");
    assert_eq!(model.gaussians, fixture::gaussians(SPLATS, 3, 20000));
    assert_eq!(model.background, [1.0; 3], "white_background=True");
    assert!(model.warnings.is_empty(), "{:?}", model.warnings);
    let network = network(&model);
    let tensors = fixture::tensors();
    let stored = |name: &str| {
        let tensor = tensors.iter().find(|tensor| tensor.name == format!("deformation_net.{name}"));
        &tensor.expect(name).values
    };
    for (level, planes) in network.grids.iter().enumerate() {
        for (index, plane) in planes.iter().enumerate() {
            let size = |axis: usize| RESOLUTION[axis] * if axis == 3 { 1 } else { MULTIRES[level] };
            let (a, b) = PLANE_AXES[index];
            assert_eq!((plane.channels, plane.height, plane.width), (CHANNELS, size(b), size(a)), "{level}.{index}");
            assert_eq!(&plane.data, stored(&format!("grid.grids.{level}.{index}")), "{level}.{index}");
        }
    }
    assert_eq!(&network.aabb.as_flattened(), stored("grid.aabb"));
    assert_eq!(network.feature_out.len(), 2, "defor_depth=2");
    assert_eq!((network.feature_out[0].inputs, network.feature_out[1].inputs), (CHANNELS * 2, WIDTH));
    assert_eq!(&network.feature_out[1].weight, stored("feature_out.2.weight"));
    assert_eq!(&network.rotations_deform.hidden.bias, stored("rotations_deform.1.bias"));
    assert_eq!(&network.shs_deform.out.weight, stored("shs_deform.3.weight"));
    assert_eq!(network.shs_deform.out.outputs, 48, "16 coefficients of 3 channels");
}

#[test]
fn the_largest_iteration_is_taken() {
    let tiny = TinyModel::new();
    tiny.write_iteration(9000);
    tiny.write_iteration(30000);
    tiny.write("point_cloud/iteration_99999", b"a file, not a folder");
    tiny.write("point_cloud/coarse_iteration_99999/point_cloud.ply", b"the static stage");
    let model = Model::open(tiny.path()).expect("the fixture is a good model");
    assert_eq!(model.gaussians, fixture::gaussians(SPLATS, 3, 30000));
}

#[test]
fn without_cfg_args_the_sizes_are_derived_and_a_warning_says_so() {
    let tiny = TinyModel::new();
    let with = Model::open(tiny.path()).expect("the fixture is a good model");
    fs::remove_file(tiny.file("cfg_args")).expect("the fixture can be changed");
    let without = Model::open(tiny.path()).expect("sizes can be derived");
    assert_eq!(network(&with), network(&without));
    let [warning] = without.warnings.as_slice() else { panic!("one warning: {:?}", without.warnings) };
    assert!(warning.contains("cfg_args") && warning.contains("assumed"), "{warning}");
}

#[test]
fn missing_files_are_named() {
    for name in ["point_cloud.ply", "deformation.pth"] {
        let tiny = TinyModel::new();
        fs::remove_file(tiny.file(&tiny.saved(name))).expect("the fixture can be changed");
        let error = open_error(&tiny);
        assert_eq!(error.exit_code(), 66, "{error}");
        assert!(error.to_string().contains(&tiny.saved(name)), "{error}");
    }
    let empty = tempfile::tempdir().expect("a temporary folder can be made");
    for path in [empty.path().to_path_buf(), empty.path().join("nowhere")] {
        let error = Model::open(&path).expect_err("nothing is there");
        assert_eq!(error.exit_code(), 66, "{error}");
    }
}

#[test]
fn training_tensors_may_be_missing_but_not_of_another_run() {
    let tiny = TinyModel::new();
    let four = bare("BoolStorage", &RawView::contiguous(&[4]), 4, &[1; 4]);
    tiny.write(&tiny.saved("deformation_table.pth"), &four);
    assert_refused(Model::open(tiny.path()), &["shape", "[4]", "[3], one row per splat"]);
    fs::remove_file(tiny.file(&tiny.saved("deformation_table.pth"))).expect("the fixture can be changed");
    let flat = bare("FloatStorage", &RawView::contiguous(&[9]), 9, &[0; 36]);
    tiny.write(&tiny.saved("deformation_accum.pth"), &flat);
    assert_refused(Model::open(tiny.path()), &["shape", "[9]", "[3, 3]"]);
    fs::remove_file(tiny.file(&tiny.saved("deformation_accum.pth"))).expect("the fixture can be changed");
    Model::open(tiny.path()).expect("neither file is needed to render");
}

#[test]
fn the_state_dict_must_have_exactly_the_keys_and_shapes_of_cfg_args() {
    let good = fixture::tensors();
    let tiny = TinyModel::new();
    for (index, tensor) in good.iter().enumerate() {
        let mut missing = good.clone();
        missing.remove(index);
        tiny.write_tensors(&missing);
        let [field, got, _] = bad_data(Model::open(tiny.path()));
        assert_eq!((field.as_str(), got.as_str()), (tensor.name.as_str(), "missing"));

        let mut longer = good.clone();
        longer[index].shape.insert(0, 1);
        tiny.write_tensors(&longer);
        assert_refused(Model::open(tiny.path()), &[&tensor.name, "shape [1, "]);
    }
    let mut extra = good.clone();
    extra[0].name = "deformation_net.static_mlp.1.weight".to_owned();
    extra.push(good[0].clone());
    tiny.write_tensors(&extra);
    assert_refused(Model::open(tiny.path()), &["static_mlp.1.weight", "do not account for"]);
}

#[test]
fn weights_that_are_not_finite_or_no_box_are_refused() {
    let tiny = TinyModel::new();
    let mut tensors = fixture::tensors();
    let last = tensors.last_mut().expect("there are tensors");
    last.values[7] = f32::NAN;
    tiny.write_tensors(&tensors);
    assert_refused(Model::open(tiny.path()), &["shs_deform.3.bias", "NaN at element 7", "finite"]);
    let mut tensors = fixture::tensors();
    let aabb = tensors.iter_mut().find(|tensor| tensor.name.ends_with("aabb")).expect("there is a box");
    aabb.values[4] = aabb.values[1];
    tiny.write_tensors(&tensors);
    assert_refused(Model::open(tiny.path()), &["aabb", "no extent along axis 1"]);
}

#[test]
fn files_of_one_folder_must_agree() {
    let tiny = TinyModel::new();
    tiny.write(&tiny.saved("point_cloud.ply"), &ply::encode(&fixture::gaussians(SPLATS, 2, 1)));
    assert_refused(Model::open(tiny.path()), &["sh_degree", "3", "2, as point_cloud.ply stores"]);
    let accum = bare("FloatStorage", &RawView::contiguous(&[1]), 1, &[0; 4]);
    let tiny = TinyModel::new();
    tiny.write(&tiny.saved("deformation.pth"), &accum);
    assert_refused(Model::open(tiny.path()), &["root", "a bare tensor", "a state dict"]);
}

#[test]
fn a_marked_copy_differs_only_in_sh_and_carries_no_unmarked_splats() {
    let tiny = TinyModel::new();
    tiny.write_iteration(14000);
    tiny.write("transforms_test.json", b"{}");
    tiny.write("chkpnt_fine_20000.pth", b"the optimiser's copy of the splats");
    tiny.write("input.PLY", b"the first point cloud");
    tiny.write("test/ours_20000/renders/00000.png", b"a picture");
    let model = Model::open(tiny.path()).expect("the fixture is a good model");
    let out = tempfile::tempdir().expect("a temporary folder can be made");
    let target = out.path().join("marked");
    let sh = fixture::gaussians(SPLATS, 3, 77).sh_coeffs;
    let written = model.write_marked(&target, &sh).expect("the copy can be written");

    let relative = |name: &str| PathBuf::from(tiny.saved(name));
    assert_eq!(written.marked, [relative("point_cloud.ply")]);
    let copied = ["deformation.pth", "deformation_accum.pth", "deformation_table.pth"].map(relative);
    let copied = [&["cfg_args".into(), "transforms_test.json".into()], copied.as_slice()].concat();
    assert_eq!(written.copied, copied);
    let left_out = ["chkpnt_fine_20000.pth", "input.PLY", "point_cloud/iteration_14000", "test"].map(PathBuf::from);
    assert_eq!(written.left_out, left_out);
    let mut expected = [copied.as_slice(), written.marked.as_slice()].concat();
    expected.sort();
    assert_eq!(files_below(&target), expected);
    for name in &copied {
        let bytes = |folder: &Path| fs::read(folder.join(name)).expect("the file is there");
        assert_eq!(bytes(tiny.path()), bytes(&target), "{}", name.display());
    }
    let marked = Model::open(&target).expect("the copy is a model");
    assert_eq!(marked.gaussians.sh_coeffs, sh);
    let back = marked.words_of(&model.gaussians.sh_coeffs).expect("SH fits");
    assert_eq!(marked.with_words(&back), [model.sources()[0].bytes()]);
}

#[test]
fn a_static_ply_loads_and_is_written_under_its_name() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("garden.ply");
    let splats = fixture::gaussians(5, 1, 3);
    fs::write(&path, ply::encode(&splats)).expect("a temporary folder is writable");
    let model = Model::open(&path).expect("a static model");
    assert_eq!((&model.gaussians, model.background), (&splats, [0.0; 3]), "INRIA's default background is black");
    assert!(model.motion.is_still(), "a PLY has no network");
    let sh = fixture::gaussians(5, 1, 4).sh_coeffs;
    let out = folder.path().join("out");
    let written = model.write_marked(&out, &sh).expect("the copy can be written");
    assert_eq!(written.marked, [Path::new("garden.ply")]);
    let marked = Model::open(&out.join("garden.ply")).expect("the copy is a model");
    assert_eq!(marked.gaussians.sh_coeffs, sh);
}

#[test]
fn real_folders_load() {
    for (name, count, time) in [("robot", 36000, 25), ("fox", 19867, 50), ("stress4d", 8156, 25)] {
        let Some(path) = shared(&format!("data/models/{name}")) else { return };
        let model = Model::open(&path).expect(name);
        assert_eq!(model.gaussians.len(), count, "{name}");
        assert!(model.warnings.is_empty(), "{name}: {:?}", model.warnings);
        let network = network(&model);
        let sizes: Vec<_> = network.grids.iter().map(|planes| (planes[0].width, planes[2].height)).collect();
        assert_eq!(sizes, [(64, time), (128, time)], "{name}: t is not multiplied");
        assert!(network.config.no_do && network.config.no_dshs && !network.config.no_dx, "{name}");
        assert!(network.aabb[0][0] > network.aabb[1][0], "{name}: row 0 of the box is its maximum");
    }
}

#[test]
fn what_no_renderer_draws_is_told_from_what_comes_up_later() {
    // Half a step of 8 bits: of all renderers the first to draw a splat, and the others draw no less.
    let least = Viewer::Spark.profile().rules.min_alpha;
    assert!(Viewer::ALL.iter().all(|viewer| viewer.profile().rules.min_alpha >= least));
    let logit = |opacity: f32| (opacity / (1.0 - opacity)).ln();
    let mut splats = fixture::gaussians(4, 0, 1);
    splats.opacities.fill(2.0);
    // Hair's breadths on either side, and one that a transparent splat of another file is.
    splats.opacities[..3].copy_from_slice(&[logit(0.999 * least), logit(1.001 * least), f32::MIN]);
    let mut model = Model::of_splats(Path::new("faint.ply"), &splats, [0.0; 3]).expect("a model");
    let drawn = |model: &Model| -> Vec<bool> { (0..4).map(|row| model.is_ever_drawn(row)).collect() };
    assert_eq!(drawn(&model), [false, true, false, true]);

    let mut later = splats.clone();
    later.opacities[0] = 1.0;
    model.motion = Motion::Sequence(vec![splats, later]);
    assert_eq!(drawn(&model), [true, true, false, true]);

    // A network that changes opacities.
    let mut model = Model::open(&golden::model("dynerf_like")).expect("the model opens");
    model.gaussians.opacities.fill(f32::MIN);
    assert!(model.is_ever_drawn(0));
    let mut model = Model::open(&golden::model("dnerf_like")).expect("the model opens");
    model.gaussians.opacities.fill(f32::MIN);
    assert!(!model.is_ever_drawn(0));
}

#[test]
fn golden_folders_load() {
    for (name, width, levels, depth) in
        [("dnerf_like", 16, 2, 1), ("dynerf_like", 24, 2, 1), ("deep_applyrot", 16, 3, 3)]
    {
        let model = Model::open(&golden::model(name)).expect(name);
        let network = network(&model);
        assert_eq!(model.gaussians.len(), 48, "{name}");
        assert_eq!((network.config.net_width, network.grids.len()), (width, levels), "{name}");
        assert_eq!(network.feature_out.len(), depth, "{name}");
        assert_eq!(network.config.apply_rotation, name == "deep_applyrot", "{name}");
        assert_eq!(network.config.no_do, name != "dynerf_like", "{name}");
    }
}
