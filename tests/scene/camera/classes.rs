//! Classes of films: what their cameras see of an asset.

use glam::DVec3;
use guard4d_engine::scene::Camera;
use guard4d_engine::scene::camera::classes::CameraClass;
use guard4d_engine::scene::camera::look_at::LookAt;
use guard4d_engine::scene::camera::paths::Lens;

use super::size;

const VIEWS: u32 = 4;
const LOOK_AT: LookAt = LookAt::at(DVec3::new(1.0, -2.0, 0.5), 3.0);

fn cameras(class: CameraClass) -> Vec<Camera> {
    let lens = Lens { fov_x_rad: 0.69, size: size(400, 400) };
    let set = class.cameras(LOOK_AT, lens, VIEWS).expect("cameras");
    set.views.iter().map(|view| view.camera).collect()
}

/// Where the camera stands, as seen from the target.
fn stand(camera: &Camera) -> DVec3 {
    camera.world_to_camera.inverse().w_axis.truncate().as_dvec3() - LOOK_AT.target
}

/// Where a point stands in the frame, px from its middle.
fn place(camera: &Camera, point: DVec3) -> [f32; 2] {
    let seen = camera.world_to_camera.transform_point3(point.as_vec3());
    [camera.fx * seen.x / seen.z, camera.fy * seen.y / seen.z]
}

#[test]
fn each_class_differs_as_its_name_says() {
    for class in CameraClass::ALL {
        assert_eq!(class.to_string().parse::<CameraClass>().expect("its own name"), class, "{class}");
        let all = cameras(class);
        assert_eq!(all.len(), VIEWS as usize, "{class}");
        for camera in &all {
            let from = stand(camera);
            let elevation_deg = (from.z / from.length()).asin().to_degrees();
            // f32 poses near 4; the off-centre circle goes around a point beside the target.
            let is_near = |got: f64, want: f64| (got - want).abs() < 1e-3;
            match class {
                CameraClass::Usual => assert!(is_near(elevation_deg, 30.0), "{elevation_deg}"),
                CameraClass::Above => assert!(is_near(elevation_deg, 75.0), "{elevation_deg}"),
                CameraClass::Below => assert!(is_near(elevation_deg, -20.0), "{elevation_deg}"),
                CameraClass::Far => assert!(is_near(from.length(), 4.8), "{}", from.length()),
                CameraClass::Near => assert!(is_near(from.length(), 2.1), "{}", from.length()),
                CameraClass::Wide => assert_eq!([camera.width, camera.height], [534, 300], "{class}"),
                CameraClass::Portrait => assert_eq!([camera.width, camera.height], [300, 534], "{class}"),
                CameraClass::Narrow | CameraClass::OffCentre | CameraClass::Roll => {}
            }
            let [x, y] = place(camera, LOOK_AT.target);
            let beside = x.hypot(y) / camera.width as f32;
            assert_eq!(beside > 0.02, class == CameraClass::OffCentre, "{class}: the target {beside} sides off");
        }
    }
}

#[test]
fn a_narrow_lens_shows_the_asset_as_large_as_usual() {
    // A sphere around the target is as wide as its radius at the distance says.
    let width = |camera: &Camera| f64::from(camera.fx) / stand(camera).length();
    let (usual, narrow) = (cameras(CameraClass::Usual)[0], cameras(CameraClass::Narrow)[0]);
    // Of f32 focal lengths.
    assert!((width(&narrow) / width(&usual) - 1.0).abs() < 1e-5, "{} {}", width(&narrow), width(&usual));
}

#[test]
fn a_rolled_camera_sees_the_vertical_aslant() {
    let above = LOOK_AT.target + DVec3::Z;
    let tilt = |class| {
        let [x, y] = place(&cameras(class)[0], above);
        f64::from(x).atan2(f64::from(-y)).to_degrees()
    };
    // Of f32 poses.
    assert!(tilt(CameraClass::Usual).abs() < 1e-3, "level: {}", tilt(CameraClass::Usual));
    assert!((tilt(CameraClass::Roll).abs() - 10.0).abs() < 1e-3, "rolled: {}", tilt(CameraClass::Roll));
}

#[test]
fn what_is_no_class_is_refused_with_the_names_of_all() {
    let refused = "sideways".parse::<CameraClass>().expect_err("no class").to_string();
    assert!(refused.contains("sideways") && refused.contains("off-centre"), "{refused}");
    let lens = Lens { fov_x_rad: 0.69, size: size(64, 64) };
    let nowhere = LookAt::at(DVec3::NAN, 1.0);
    CameraClass::Far.cameras(nowhere, lens, 1).expect_err("no point to look at");
    CameraClass::Far.cameras(LOOK_AT, lens, 0).expect_err("no views");
}
