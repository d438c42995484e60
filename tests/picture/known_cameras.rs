//! Where the trained frame lies in films of known cameras.

use glam::{DMat3, DVec3};
use guard4d_engine::picture::foreground::NotFound;
use guard4d_engine::picture::known_cameras::KnownCameras;
use guard4d_engine::picture::part::{Part, Window};
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::{Camera, FrameSize, LookAt};
use guard4d_kernels::image::resize::ImageSize;

use crate::support::close::largest;

/// Cameras of f32, at a few hundred pixels.
const ROUNDING_PX: f64 = 0.01;

fn look_at() -> LookAt {
    LookAt { up: DVec3::new(0.6, 0.0, 0.8), ..LookAt::at(DVec3::new(1.0, -2.0, 0.5), 3.0) }
}

fn lens(fov_x_rad: f64, [width, height]: [u32; 2]) -> Lens {
    Lens { fov_x_rad, size: FrameSize::new(width, height).expect("a size") }
}

fn trained() -> Lens {
    lens(0.7, [200, 150])
}

fn cameras(look_at: LookAt, elevation_deg: f64, lens: Lens) -> Vec<Camera> {
    let orbit = Orbit { views: 5, elevation_deg, look_at, lens };
    orbit.cameras().expect("an orbit").views.into_iter().map(|view| view.camera).collect()
}

fn parts(cameras: Vec<Camera>, frames: usize, [width, height]: [usize; 2]) -> Vec<Part> {
    let known = KnownCameras { cameras, look_at: look_at(), lens: trained() };
    known.parts(frames, ImageSize { height, width }).expect("one for each")
}

#[test]
fn films_of_trainings_cameras_are_shown_whole_in_any_size() {
    for size in [[200, 150], [800, 600], [101, 76]] {
        let parts = parts(cameras(look_at(), 40.0, trained()), 5, size);
        assert_eq!(parts, vec![Part::All; 5], "{size:?}");
    }
}

#[test]
fn the_window_is_where_the_trained_frame_projects_to() {
    let away = LookAt { radius: 4.8, ..look_at() };
    let beside = LookAt { target: look_at().target + DVec3::new(0.4, 0.2, -0.3), ..look_at() };
    let rolled = |camera: Camera| camera.turned(DMat3::from_rotation_z(-0.3));
    for (what, film) in [
        ("from farther away", cameras(away, 20.0, trained())),
        ("through another lens", cameras(look_at(), -30.0, lens(1.1, [640, 360]))),
        ("aimed beside it", cameras(beside, 50.0, lens(0.9, [300, 400]))),
        ("rolled", cameras(beside, 10.0, trained()).into_iter().map(rolled).collect()),
    ] {
        let size = [film[0].width, film[0].height].map(|n| n as usize);
        for (camera, part) in film.iter().zip(parts(film.clone(), 5, size)) {
            let Part::Window(window @ Window { middle, sides, turn_deg }) = part else { panic!("{what}: {part:?}") };
            // What lies half a trained frame to the right of the target, and half of one below.
            let half = 3.0 * f64::tan(0.35);
            let level = camera.axes()[2].cross(look_at().up).normalize();
            let plumb = camera.axes()[2].cross(level);
            let (sin, cos) = turn_deg.to_radians().sin_cos();
            for (point, wanted) in [
                (DVec3::ZERO, [0.0, 0.0]),
                (level * half, [cos * sides[0] / 2.0, -sin * sides[0] / 2.0]),
                (plumb * half * 0.75, [sin * sides[1] / 2.0, cos * sides[1] / 2.0]),
            ] {
                let (pixel, _) = camera.project((look_at().target + point).as_vec3()).expect("in front");
                // Pixel centres of cameras lie at whole numbers.
                let off = [0, 1].map(|i| (f64::from(pixel[i]) + 0.5 - middle[i] - wanted[i]).abs());
                assert!(largest(off) < ROUNDING_PX, "{what}: {off:?} px off, {window:?}");
            }
            assert_eq!(turn_deg != 0.0, what == "rolled", "{what}: {turn_deg}");
        }
    }
}

#[test]
fn cameras_are_one_for_all_or_one_for_each() {
    let film = cameras(look_at(), 20.0, trained());
    assert_eq!(parts(vec![film[0]], 3, [200, 150]), vec![Part::All; 3], "one for all");
    let known = KnownCameras { cameras: film, look_at: look_at(), lens: trained() };
    let refused = known.parts(3, ImageSize { height: 150, width: 200 }).expect_err("five for three");
    assert_eq!(refused.exit_code(), 2, "{refused}");
    assert!(refused.to_string().contains("5, expected 3"), "{refused}");
    // A camera that looks away is no reason for another reading than of the whole frame.
    let away = cameras(look_at(), 20.0, trained())[0].turned(DMat3::from_rotation_y(std::f64::consts::PI));
    assert_eq!(parts(vec![away], 1, [200, 150]), [Part::Fallback(NotFound::Nothing)]);
    // From straight above nothing is level.
    let above = parts(cameras(look_at(), 90.0, lens(1.0, [200, 150])), 5, [200, 150]);
    assert!(above.iter().all(|part| matches!(part, Part::Window(window) if window.middle[0].is_finite())), "{above:?}");
}
