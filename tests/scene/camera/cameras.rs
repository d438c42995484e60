//! Cameras in a set: grouping into clips, other sizes, positions.

use glam::{Mat4, Vec3};
use guard4d_engine::scene::{Camera, CameraSet, FrameSize, View};

use super::{POSE_TOLERANCE, assert_near, band, orbit, size};

fn camera(number: f32) -> Camera {
    let size = FrameSize::new(64, 48).expect("a small size");
    Camera::with_fov(Mat4::from_translation(Vec3::X * number), 0.7, size)
}

fn view(number: f32, times: &[f32]) -> View {
    View { name: format!("view {number}"), camera: camera(number), times: times.to_vec(), located: true }
}

fn clips(views: &[View]) -> Vec<Vec<(f32, f32)>> {
    let set = CameraSet { views: views.to_vec(), in_sequence: false };
    let number = |c: &Camera| c.world_to_camera.w_axis.x;
    set.clips().iter().map(|clip| clip.iter().map(|(c, t)| (number(c), *t)).collect()).collect()
}

#[test]
fn view_with_many_times_is_a_clip_of_its_own() {
    let got = clips(&[view(0.0, &[0.0, 0.5, 0.75]), view(1.0, &[0.25])]);
    assert_eq!(got, [vec![(0.0, 0.0), (0.0, 0.5), (0.0, 0.75)], vec![(1.0, 0.25)]], "one clip per view");
}

#[test]
fn views_with_one_time_each_are_followed_through_the_times() {
    // Three viewpoints at two moments, the later one listed first.
    let later = (0..3u8).map(|k| view(f32::from(k), &[0.5]));
    let earlier = (3..6u8).map(|k| view(f32::from(k), &[0.25]));
    let got = clips(&later.chain(earlier).collect::<Vec<_>>());
    let want = [vec![(3.0, 0.25), (0.0, 0.5)], vec![(4.0, 0.25), (1.0, 0.5)], vec![(5.0, 0.25), (2.0, 0.5)]];
    assert_eq!(got, want, "k-th views, in order of time");
}

#[test]
fn moment_with_fewer_views_is_absent_from_later_clips() {
    let got = clips(&[view(0.0, &[0.0]), view(1.0, &[0.0]), view(2.0, &[1.0])]);
    assert_eq!(got, [vec![(0.0, 0.0), (2.0, 1.0)], vec![(1.0, 0.0)]], "the second clip has one moment");
}

#[test]
fn no_views_make_no_clips() {
    assert!(clips(&[]).is_empty(), "nothing to film");
}

#[test]
fn resizing_keeps_the_view() {
    let camera = orbit(1).cameras().expect("a good orbit").views[0].camera;
    let half = camera.resized(size(32, 24));
    assert_eq!((half.tan_fovx(), half.tan_fovy()), (camera.tan_fovx(), camera.tan_fovy()));
    assert_eq!((half.cx, half.cy), (15.5, 11.5), "still the middle");
    assert_eq!(half.resized(size(64, 48)), camera);
}

#[test]
fn positions_invert_the_view_transform() {
    let set = band().sample(10, 3).expect("a good band");
    for view in &set.views {
        let Camera { world_to_camera, .. } = view.camera;
        assert_near(world_to_camera.transform_point3(view.camera.position()), Vec3::ZERO, POSE_TOLERANCE);
    }
}
