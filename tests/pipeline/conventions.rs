//! One scene through one camera in the words of each program: the pictures agree, and would not if an axis were wrong.

use glam::{DMat3, DVec3, Mat4};
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::scene::gaussians::SH_FLOATS;
use guard4d_engine::scene::{Camera, CameraSet, FrameSize, Gaussians, Motion};
use guard4d_kernels::Device;

use crate::support::camera_writers::{Format, Shot};
use crate::support::close::largest;
use crate::support::gpu::device;

const WIDTH: u32 = 64;
const HEIGHT: u32 = 48;

/// Files keep all digits of f64, so that poses and lenses differ by roundings to f32: 1e-7 of numbers up to 60 px,
/// which moves splats by 1e-5 px. The steepest edge of these is 0.3 per px, and no pixel of theirs lies that near to a
/// cutoff.
const TOLERANCE: f32 = 1e-4;

/// What a wrong axis has to change somewhere in the picture, of colours from 0 to 1.
const SEEN: f32 = 0.3;

/// A splat's Y0, by which its first coefficients are multiplied.
const Y0: f32 = 0.282_094_8;

/// Five splats of different colour, shape and place, with no symmetry.
fn scene() -> Gaussians {
    let splats: [([f32; 3], [f32; 3], [f32; 3]); 5] = [
        ([0.0, 0.0, 0.0], [0.3, 0.1, 0.2], [1.0, 0.1, 0.1]),
        ([0.9, 0.2, 0.1], [0.1, 0.2, 0.3], [0.1, 1.0, 0.2]),
        ([-0.3, 0.8, 0.5], [0.2, 0.2, 0.1], [0.1, 0.2, 1.0]),
        ([0.2, -0.6, 0.9], [0.1, 0.1, 0.25], [0.9, 0.9, 0.1]),
        ([-0.7, -0.4, -0.5], [0.25, 0.15, 0.1], [0.8, 0.1, 0.9]),
    ];
    let colour = |(_, _, colour): &([f32; 3], [f32; 3], [f32; 3])| {
        let mut row = [0.0; SH_FLOATS];
        for (coefficient, channel) in row.iter_mut().zip(colour) {
            *coefficient = (channel - 0.5) / Y0;
        }
        row
    };
    Gaussians {
        means: splats.iter().map(|s| s.0).collect(),
        quats: vec![[0.9, 0.3, -0.2, 0.1]; splats.len()],
        scales: splats.iter().map(|s| s.1.map(f32::ln)).collect(),
        // An opacity of 0.95.
        opacities: vec![2.944; splats.len()],
        sh_coeffs: splats.iter().flat_map(colour).collect(),
        sh_degree: 0,
    }
}

/// Stands askew, so that no two axes can be exchanged unseen, and rolled, so that the image has no upright.
fn shot() -> Shot {
    let upright = Shot::looking(DVec3::new(1.7, -3.1, 1.3), DVec3::new(0.1, 0.05, 0.2), 70.0, [WIDTH, HEIGHT]);
    Shot { axes: upright.axes * DMat3::from_rotation_z(0.3), ..upright }
}

fn size() -> FrameSize {
    FrameSize::new(WIDTH, HEIGHT).expect("a small size")
}

/// The camera without any file, by the definition of its fields.
fn camera(shot: &Shot) -> Camera {
    let mut rows = [[0.0; 4]; 4];
    for (row, axis) in rows.iter_mut().zip([shot.axes.x_axis, shot.axes.y_axis, shot.axes.z_axis]) {
        *row = [axis.x, axis.y, axis.z, -axis.dot(shot.position)].map(|value| value as f32);
    }
    rows[3] = [0.0, 0.0, 0.0, 1.0];
    let [fx, fy] = shot.focal.map(|focal| focal as f32);
    let [cx, cy] = shot.principal.map(|edge| (edge - 0.5) as f32);
    let world_to_camera = Mat4::from_cols_array_2d(&rows).transpose();
    Camera { world_to_camera, fx, fy, cx, cy, width: shot.size[0], height: shot.size[1] }
}

fn picture(device: &Device, camera: Camera) -> Vec<f32> {
    let mut renderer = SceneRenderer::new(device, &scene(), &Motion::Still, [0.0; 3]).expect("the scene fits");
    let mut picture = Vec::new();
    let shot = renderer.render_clips(&[vec![(camera, 0.0)]], |_, _, pixels| {
        picture.extend_from_slice(pixels);
        Ok(())
    });
    shot.expect("the scene renders");
    picture
}

/// The picture of a camera that goes through a file.
fn through(device: &Device, format: Format, shot: &Shot) -> Vec<f32> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = format.write(folder.path(), &[*shot]);
    let set = CameraSet::open(&path, size()).unwrap_or_else(|e| panic!("{format:?}: {e}"));
    assert_eq!(set.views.len(), 1, "{format:?}");
    picture(device, set.views[0].camera)
}

/// Largest difference; NaN when anything is or lengths differ.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    if a.len() == b.len() { largest(a.iter().zip(b).map(|(a, b)| (a - b).abs())) } else { f32::NAN }
}

#[test]
fn pictures_agree_through_all_formats() {
    let Some(gpu) = device() else { return };
    let want = picture(&gpu, camera(&shot()));
    for channel in 0..3 {
        let brightest = largest(want.iter().skip(channel).step_by(4).copied());
        assert!(brightest > SEEN, "channel {channel} shows the scene: {brightest}");
    }
    for format in Format::ALL {
        let worst = difference(&through(&gpu, format, &shot()), &want);
        assert!(worst <= TOLERANCE, "{format:?}: {worst}");
    }
}

#[test]
fn off_centre_lenses_agree_where_formats_have_them() {
    let Some(gpu) = device() else { return };
    let shot = Shot { focal: [70.0, 55.0], principal: [27.25, 28.75], ..shot() };
    let want = picture(&gpu, camera(&shot));
    let centred = Shot { principal: [32.0, 24.0], ..shot };
    assert!(difference(&picture(&gpu, camera(&centred)), &want) > SEEN, "the principal point shows");
    for format in Format::ALL.into_iter().filter(|format| format.has_lens()) {
        let worst = difference(&through(&gpu, format, &shot), &want);
        assert!(worst <= TOLERANCE, "{format:?}: {worst}");
    }
}

#[test]
fn pictures_disagree_when_an_axis_is_wrong() {
    let Some(gpu) = device() else { return };
    let right = shot();
    let want = picture(&gpu, camera(&right));
    let turned =
        |x: f64, y: f64, z: f64| Shot { axes: right.axes * DMat3::from_diagonal(DVec3::new(x, y, z)), ..right };
    let mistakes = [
        ("OpenGL axes for OpenCV axes", turned(1.0, -1.0, -1.0)),
        ("up for down and left for right", turned(-1.0, -1.0, 1.0)),
        ("camera to world for world to camera", Shot { axes: right.axes.transpose(), ..right }),
        ("y for z in the world", Shot { position: DVec3::new(1.7, -1.3, -3.1), ..right }),
        ("half a pixel", Shot { principal: right.principal.map(|edge| edge - 0.5), ..right }),
    ];
    for format in Format::ALL {
        for (mistake, shot) in &mistakes[..4] {
            let worst = difference(&through(&gpu, format, shot), &want);
            assert!(worst > SEEN, "{format:?}: {mistake} changes the picture by {worst}");
        }
        if format.has_lens() {
            // Half of the edges' steepness, at the least a hundred times the tolerance.
            let (mistake, shot) = &mistakes[4];
            let worst = difference(&through(&gpu, format, shot), &want);
            assert!(worst > 100.0 * TOLERANCE, "{format:?}: {mistake} changes the picture by {worst}");
        }
    }
}
