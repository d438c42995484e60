//! The scene inside the program.

use guard4d_engine::scene::Model;
use guard4d_engine::scene::demo::DemoScene;

#[test]
fn embedded_scene_unpacks_loads_and_leaves_no_trace() {
    let scene = DemoScene::unpack().expect("unpacks");
    let folder = scene.path().to_owned();
    let model = Model::open(scene.path()).expect("the embedded scene is valid");
    assert!(!model.gaussians.is_empty(), "it has splats");
    assert!(!model.motion.is_still(), "it moves");
    assert!(model.gaussians.sh_coeffs.iter().all(|v| v.is_finite()), "its colours are finite");
    drop(scene);
    assert!(!folder.exists(), "the temporary folder is gone");
}

#[test]
fn embedded_cameras_film_whole_clips_at_the_asked_size() {
    let scene = DemoScene::unpack().expect("unpacks");
    let clips = scene.cameras((200, 120)).expect("cameras").clips();
    assert!(!clips.is_empty(), "there is a clip");
    for clip in &clips {
        assert!(clip.len() > 1, "a clip has frames");
        assert!(clip.windows(2).all(|pair| pair[0].1 < pair[1].1), "times rise");
        assert!(
            clip.iter().all(|(c, t)| (c.width, c.height) == (200, 120) && (0.0..=1.0).contains(t)),
            "sizes and times"
        );
    }
    assert!(scene.cameras((0, 120)).is_err(), "an impossible size is refused");
}
