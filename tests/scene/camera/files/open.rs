//! Folders of cameras of every kind, opened by what lies in them.

use super::{assert_is, folder, open, shots};
use crate::support::camera_writers::Format;

#[test]
fn folders_give_every_camera_with_its_own_lens() {
    let folder = folder();
    for (format, names) in [
        (Format::ColmapText, ["000.png", "001.png", "002.png"]),
        (Format::ColmapBinary, ["000.png", "001.png", "002.png"]),
        (Format::Nerfies, ["000000", "000001", "000002"]),
        (Format::NerfstudioFrames, ["images/000", "images/001", "images/002"]),
    ] {
        let set = open(&format.write(folder.path(), &shots())).unwrap_or_else(|e| panic!("{format:?}: {e}"));
        assert_eq!(set.views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(), names, "{format:?}");
        for (view, shot) in set.views.iter().zip(shots()) {
            assert_is(&view.camera, &shot);
        }
        let times: Vec<&[f32]> = set.views.iter().map(|view| view.times.as_slice()).collect();
        match format {
            Format::Nerfies => assert_eq!(times, [[0.0], [0.5], [1.0]], "warp_id / max(warp_id)"),
            _ => assert!(times.iter().all(|times| times.is_empty()), "{format:?} has no times"),
        }
    }
}
