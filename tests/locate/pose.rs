//! Poses and cameras say the same, and points move as told.

use glam::{DQuat, DVec3};
use guard4d_engine::locate::pose::{Middle, PARAMETERS, Pose, TIME};
use guard4d_engine::scene::FrameSize;

use crate::support::random::Random;

const MIDDLE: Middle = Middle { point: DVec3::new(0.3, -0.2, 1.1), radius: 1.4 };

fn pose() -> Pose {
    let turn = DQuat::from_scaled_axis(DVec3::new(0.7, -1.1, 0.4));
    Pose { middle: MIDDLE, turn, shift: [0.12, -0.07], size: -1.1, lens: 0.3, time: 0.4 }
}

#[test]
fn a_pose_is_its_cameras() {
    let size = FrameSize::new(320, 200).expect("a size");
    let back = Pose::of_camera(&pose().camera(size), 0.4, MIDDLE).expect("the middle is in front");
    // Cameras hold 32-bit floats.
    let apart = back.since(&pose());
    assert!(apart.iter().all(|step| step.abs() < 1e-5), "{apart:?}");
    let step = [0.02, -0.03, 0.01, 0.1, -0.2, 0.3, -0.1, 0.2];
    let told = pose().moved(&step).since(&pose());
    assert!(told.iter().zip(step).all(|(told, step)| (told - step).abs() < 1e-12), "{told:?}");
    assert_eq!(pose().moved(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.0]).time, 1.0, "time ends");
}

#[test]
fn a_view_is_the_same_about_another_middle() {
    let size = FrameSize::new(320, 200).expect("a size");
    let seen = pose().about_depth(4.0);
    assert!((seen.depth() - 4.0).abs() < 1e-12 && seen.shift.iter().all(|shift| shift.abs() < 1e-12), "{seen:?}");
    let position = seen.camera(size).position().as_dvec3();
    // Cameras hold 32-bit floats.
    assert!((seen.depth_of(seen.middle.point) - 4.0).abs() < 1e-12 && pose().depth_of(position).abs() < 1e-5);
    // Numbers of 32 bits.
    let [a, b] = [pose(), seen].map(|pose| pose.camera(size).world_to_camera);
    assert!(a.abs_diff_eq(b, 1e-6), "{a} and {b}");
    let step = [0.02, -0.03, 0.01, 0.1, -0.2, 0.3, -0.1, 0.2];
    let moved = pose().moved(&step);
    // Steps between views that are about different middles lead there, too.
    let [a, b] = [moved, seen.moved(&moved.since(&seen))].map(|pose| pose.camera(size).world_to_camera);
    assert!(a.abs_diff_eq(b, 1e-5), "{a} and {b}");
    let behind = Middle { point: position - pose().turn.inverse() * DVec3::Z, ..MIDDLE };
    assert!(pose().about(behind).size > pose().size + 2.0, "what is behind is as if it were before the lens");
    let standing = Pose::standing(position, seen.turn, seen.lens, seen.time);
    let [a, b] = [standing, seen].map(|pose| pose.camera(size).world_to_camera);
    assert!(a.abs_diff_eq(b, 1e-5), "{a} and {b}");
}

#[test]
fn points_flow_as_differences_of_pictures_say() {
    let size = FrameSize::new(1000, 800).expect("a size");
    let mut random = Random(5);
    for _ in 0..20 {
        let offset = random.vec_f32(3, -1.0, 1.0);
        let point = MIDDLE.point + DVec3::new(offset[0].into(), offset[1].into(), offset[2].into());
        let flow = pose().flow(point).expect("in front");
        for (parameter, flow) in flow.into_iter().enumerate() {
            let seen = |by: f64| {
                let mut step = [0.0; PARAMETERS];
                step[parameter] = by;
                let camera = pose().moved(&step).camera(size);
                camera.project(point.as_vec3()).expect("in front").0.as_dvec2() / 1000.0
            };
            let slope = (seen(0.01) - seen(-0.01)) / 0.02;
            // Of 32-bit pixels and second order: a thousandth of a width.
            let told = glam::DVec2::from(flow);
            assert!((slope - told).length() < 2e-3, "parameter {parameter}: {told} for {slope}");
        }
    }
    assert!(pose().flow(MIDDLE.point - pose().turn.inverse() * DVec3::Z * 100.0).is_none(), "behind");
    assert_eq!(TIME, 7, "time is the last");
}
