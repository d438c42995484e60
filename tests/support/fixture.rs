//! A tiny 4DGaussians folder, made here, so that every rule can be tried without other files.

use std::fs;
use std::path::{Path, PathBuf};

use guard4d_engine::scene::gaussians::{SH_FLOATS, sh_bases};
use guard4d_engine::scene::{Gaussians, ply};
use tempfile::TempDir;

use crate::support::pth_builder::{NamedTensor, RawView, bare, state_dict};
use crate::support::random::Random;

pub(crate) const SPLATS: usize = 3;
pub(crate) const WIDTH: usize = 4;
pub(crate) const CHANNELS: usize = 2;
pub(crate) const MULTIRES: [usize; 2] = [1, 2];
pub(crate) const RESOLUTION: [usize; 4] = [3, 4, 5, 2];

/// A model folder that is removed with this value.
pub(crate) struct TinyModel {
    pub(crate) folder: TempDir,
}

impl TinyModel {
    pub(crate) fn new() -> Self {
        let model = Self { folder: tempfile::tempdir().expect("a temporary folder can be made") };
        model.write("cfg_args", cfg_args().as_bytes());
        model.write_iteration(20000);
        model
    }

    pub(crate) fn write_iteration(&self, iteration: u32) {
        let folder = format!("point_cloud/iteration_{iteration}");
        let table = RawView::contiguous(&[SPLATS]);
        let accum = RawView::contiguous(&[SPLATS, 3]);
        self.write(&format!("{folder}/point_cloud.ply"), &ply::encode(&gaussians(SPLATS, 3, u64::from(iteration))));
        self.write(&format!("{folder}/deformation.pth"), &state_dict(&tensors()));
        self.write(&format!("{folder}/deformation_table.pth"), &bare("BoolStorage", &table, 3, &[1; SPLATS]));
        self.write(&format!("{folder}/deformation_accum.pth"), &bare("FloatStorage", &accum, 9, &[0; SPLATS * 12]));
    }

    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    /// A file of the iteration folder.
    pub(crate) fn saved(&self, name: &str) -> String {
        format!("point_cloud/iteration_20000/{name}")
    }

    pub(crate) fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.file(name);
        let parent = path.parent().expect("the path has a folder");
        fs::create_dir_all(parent).expect("a temporary folder is writable");
        fs::write(path, bytes).expect("a temporary folder is writable");
    }

    pub(crate) fn write_tensors(&self, tensors: &[NamedTensor]) {
        self.write(&self.saved("deformation.pth"), &state_dict(tensors));
    }
}

/// Random splats; coefficients above `sh_degree` are zero.
pub(crate) fn gaussians(count: usize, sh_degree: u32, seed: u64) -> Gaussians {
    let mut random = Random(seed);
    let mut triple = || [(); 3].map(|()| random.uniform(-1.0, 1.0) as f32);
    let means = (0..count).map(|_| triple()).collect();
    let scales = (0..count).map(|_| triple()).collect();
    let quats = (0..count).map(|_| [triple()[0], triple()[0], triple()[0], 1.0]).collect();
    let opacities = random.vec_f32(count, -4.0, 4.0);
    let mut sh_coeffs = random.vec_f32(count * SH_FLOATS, -1.0, 1.0);
    for splat in sh_coeffs.chunks_exact_mut(SH_FLOATS) {
        splat[sh_bases(sh_degree) * 3..].fill(0.0);
    }
    Gaussians { means, quats, scales, opacities, sh_coeffs, sh_degree }
}

/// The state dict of a network with the sizes above.
pub(crate) fn tensors() -> Vec<NamedTensor> {
    let mut shapes: Vec<(String, Vec<usize>)> = Vec::new();
    let mut add = |name: &str, shape: &[usize]| shapes.push((name.to_owned(), shape.to_vec()));
    for (name, size) in [("time_poc", 4), ("pos_poc", 10), ("rotation_scaling_poc", 2), ("opacity_poc", 2)] {
        add(name, &[size]);
    }
    for (name, shape) in [("timenet.0", [8, 9]), ("timenet.2", [4, 8])] {
        add(&format!("{name}.weight"), &shape);
        add(&format!("{name}.bias"), &shape[..1]);
    }
    let dn = "deformation_net";
    add(&format!("{dn}.grid.aabb"), &[2, 3]);
    let [x, y, z, t] = RESOLUTION;
    for (level, m) in MULTIRES.into_iter().enumerate() {
        let planes = [[y * m, x * m], [z * m, x * m], [t, x * m], [z * m, y * m], [t, y * m], [t, z * m]];
        for (plane, [height, width]) in planes.into_iter().enumerate() {
            add(&format!("{dn}.grid.grids.{level}.{plane}"), &[1, CHANNELS, height, width]);
        }
    }
    let mut linear = |name: String, inputs: usize, outputs: usize| {
        add(&format!("{dn}.{name}.weight"), &[outputs, inputs]);
        add(&format!("{dn}.{name}.bias"), &[outputs]);
    };
    linear("feature_out.0".to_owned(), CHANNELS * MULTIRES.len(), WIDTH);
    linear("feature_out.2".to_owned(), WIDTH, WIDTH);
    for (head, outputs) in [("pos", 3), ("scales", 3), ("rotations", 4), ("opacity", 1), ("shs", 48)] {
        linear(format!("{head}_deform.1"), WIDTH, WIDTH);
        linear(format!("{head}_deform.3"), WIDTH, outputs);
    }
    let mut random = Random(4);
    let fill = |(name, shape): (String, Vec<usize>)| {
        let values = random.vec_f32(shape.iter().product(), -1.0, 1.0);
        NamedTensor { name, shape, values }
    };
    shapes.into_iter().map(fill).collect()
}

pub(crate) fn cfg_args() -> String {
    format!(
        "Namespace(apply_rotation=False, bounds=1.6, defor_depth=2, empty_voxel=False, grid_pe=0, \
         kplanes_config={{'grid_dimensions': 2, 'input_coordinate_dim': 4, 'output_coordinate_dim': {CHANNELS}, \
         'resolution': {RESOLUTION:?}}}, model_path='./output/tiny', multires={MULTIRES:?}, net_width={WIDTH}, \
         no_do=True, no_dr=False, no_ds=False, no_dshs=True, no_dx=False, no_grid=False, sh_degree=3, \
         static_mlp=False, white_background=True)"
    )
}
