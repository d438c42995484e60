//! Scenes with a reference picture: as files, the way that users bring them.

use std::path::{Path, PathBuf};

use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::scene::{Gaussians, ply};
use serde_json::json;

use super::{repo, shared};

/// One scene, one view, and what an f64 reference makes of them.
pub(crate) struct RasterCase {
    /// The splats.
    pub(crate) ply: PathBuf,
    /// The view and its background.
    pub(crate) camera: PathBuf,
    /// Picture, transmittance, weights and gradients.
    pub(crate) expected: PathBuf,
    /// How far f32 may move a pixel that is decided as in f64.
    pub(crate) tolerance: f32,
    /// Pixels of a thousand in which f32 may decide otherwise than f64 did.
    pub(crate) strays_per_mille: usize,
}

/// The random scene of the repository, written to `folder`, and the trained one of the test material if it is there.
pub(crate) fn cases(folder: &Path) -> Vec<RasterCase> {
    let mut cases = vec![random_scene(folder)];
    if let (Some(golden), Some(ply)) =
        (shared("data/golden/raster_fruit"), shared("data/static/fruit_drops_minimal.ply"))
    {
        let (camera, expected) = (golden.join("camera.json"), golden.join("expected.safetensors"));
        // Alpha and stop decisions flip in a few pixels (formats, tolerances for goldens).
        cases.push(RasterCase { ply, camera, expected, tolerance: 1e-4, strays_per_mille: 1 });
    }
    cases
}

fn random_scene(folder: &Path) -> RasterCase {
    let expected = repo("tests/golden/raster.safetensors");
    let golden = TensorFile::read(&expected).expect("the golden file opens");
    let floats = |name: &str, shape: &[usize]| golden.floats(name, shape).expect("a tensor of the golden");
    let size = |name: &str, axis: usize| golden.get(name).expect("a tensor of the golden").shape[axis];
    let n = size("means", 0);
    let gaussians = Gaussians {
        means: floats("means", &[n, 3]).as_chunks().0.to_vec(),
        quats: floats("quats", &[n, 4]).as_chunks().0.to_vec(),
        scales: floats("scales", &[n, 3]).as_chunks().0.to_vec(),
        opacities: floats("opacities", &[n]).to_vec(),
        sh_coeffs: floats("sh", &[n, 16, 3]).to_vec(),
        sh_degree: 3,
    };
    let (height, width, focal) = (size("final_T", 0), size("final_T", 1), floats("focal", &[1])[0]);
    let rows: Vec<_> = floats("world_to_camera", &[4, 4]).chunks(4).collect();
    let camera = json!({
        "width": width, "height": height, "fx": focal, "fy": focal,
        "background": floats("background", &[3]), "world_to_camera_row_major": rows,
    });
    let (ply, camera_file) = (folder.join("random.ply"), folder.join("random.json"));
    std::fs::write(&ply, ply::encode(&gaussians)).expect("a temporary folder is writable");
    std::fs::write(&camera_file, camera.to_string()).expect("a temporary folder is writable");
    // The generator left out every splat that comes near a decision; its rules in f32 move a pixel by up to 2e-6.
    RasterCase { ply, camera: camera_file, expected, tolerance: 1e-5, strays_per_mille: 0 }
}
