//! Splats: what is computed from all of them.

use guard4d_engine::scene::Gaussians;

#[test]
fn the_scene_centre_ignores_strays() {
    let mut means = vec![[1.0, 2.0, 3.0]; 9];
    means.push([1e9, -1e9, f32::MAX]);
    let splats = Gaussians { means, ..Gaussians::default() };
    assert_eq!(splats.median_centre(), [1.0, 2.0, 3.0]);
    assert_eq!(Gaussians::default().median_centre(), [0.0; 3], "no splats");
}
