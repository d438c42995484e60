//! A scene of as many splats as wanted, all of about five pixels.

use std::path::Path;

use glam::Mat4;
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::{Camera, FrameSize, Gaussians};
use guard4d_kernels::splat::SH_FLOATS;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Standard deviations in px: three of them are about 5 px.
const SIGMA_PX: (f32, f32) = (1.2, 2.2);
/// Distances from the camera.
const DEPTH: (f32, f32) = (3.0, 5.0);
/// Logits of opacities between a tenth and nine tenths.
const OPACITY: (f32, f32) = (-2.2, 2.2);
/// Widest angle of the camera.
const FOV_RAD: f64 = 0.7;
const SEED: u64 = 1;

/// The camera that looks at [`splats`].
pub(crate) fn camera(side: u32) -> Result<Camera, EngineError> {
    Ok(Camera::with_fov(Mat4::IDENTITY, FOV_RAD, FrameSize::new(side, side)?))
}

/// Splats spread evenly over what `camera` sees. At another image size they are as large in pixels, so that the pairs
/// of a tile and a splat are about as many.
pub(crate) fn splats(count: usize, camera: &Camera) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut between = |(low, high): (f32, f32)| low + (high - low) * (rng.next_u32() >> 8) as f32 / (1 << 24) as f32;
    let mut splats = Gaussians { sh_degree: 3, ..Gaussians::default() };
    for _ in 0..count {
        let (u, v) = (between((0.0, camera.width as f32)), between((0.0, camera.height as f32)));
        let z = between(DEPTH);
        splats.means.push([(u - camera.cx) * z / camera.fx, (v - camera.cy) * z / camera.fy, z]);
        splats.scales.push(std::array::from_fn(|_| (between(SIGMA_PX) * z / camera.fx).ln()));
        splats.quats.push(std::array::from_fn(|_| between((-1.0, 1.0))));
        splats.opacities.push(between(OPACITY));
        splats.sh_coeffs.extend((0..SH_FLOATS).map(|_| between((-0.2, 0.2))));
    }
    splats
}

/// Writes a scene, its camera and the picture that guard4d makes of it, for implementations that share no code with it.
///
/// # Shapes
/// `means` [N,3] · `quats` [N,4] wxyz, not normalised · `scales` [N,3] logarithms · `opacities` [N] logits ·
/// `sh_coeffs` [N,16,3] · `viewmat` [4,4] world to camera, OpenCV's axes · `intrinsics` [3,3] in px, centres of pixels
/// at halves · `image` [H,W,4], colour and what is left of the light
///
/// # Errors
/// When the picture has another size than the camera, or the file cannot be written.
pub(crate) fn write(path: &Path, splats: &Gaussians, camera: &Camera, image: Vec<f32>) -> Result<(), EngineError> {
    let n = splats.len();
    let viewmat = camera.world_to_camera.transpose().to_cols_array();
    // The camera counts pixel centres from 0.
    let [cx, cy] = [camera.cx, camera.cy].map(|centre| centre + 0.5);
    let intrinsics = [camera.fx, 0.0, cx, 0.0, camera.fy, cy, 0.0, 0.0, 1.0];
    let tensors = [
        ("means", Tensor::f32(&[n, 3], splats.means.concat())),
        ("quats", Tensor::f32(&[n, 4], splats.quats.concat())),
        ("scales", Tensor::f32(&[n, 3], splats.scales.concat())),
        ("opacities", Tensor::f32(&[n], splats.opacities.clone())),
        ("sh_coeffs", Tensor::f32(&[n, SH_FLOATS / 3, 3], splats.sh_coeffs.clone())),
        ("viewmat", Tensor::f32(&[4, 4], viewmat.to_vec())),
        ("intrinsics", Tensor::f32(&[3, 3], intrinsics.to_vec())),
        ("image", Tensor::f32(&[camera.height as usize, camera.width as usize, 4], image)),
    ];
    let tensors = tensors.map(|(name, tensor)| (name.to_owned(), tensor)).into();
    let file = TensorFile { path: path.to_owned(), tensors, ..TensorFile::default() };
    AtomicFile::write(path, Existing::Replace, &file.to_bytes()?)
}
