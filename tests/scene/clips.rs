//! Grouping of camera entries into clips.

use glam::{Mat4, Vec3};
use guard4d_engine::scene::{Camera, CameraSet, ImageSize, View};

fn camera(number: f32) -> Camera {
    let size = ImageSize::new(64, 48).expect("a small size");
    Camera::with_fov(Mat4::from_translation(Vec3::X * number), 0.7, size)
}

fn view(number: f32, times: &[f32]) -> View {
    View { name: format!("view {number}"), camera: camera(number), times: times.to_vec() }
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
