//! Where windows lie in a frame.

use guard4d_engine::picture::foreground::NotFound;
use guard4d_engine::picture::part::{Part, Window};
use guard4d_kernels::image::resize::{ImageSize, Region};

use crate::support::close::largest;

const SIZE: ImageSize = ImageSize { height: 300, width: 400 };

/// Largest difference of two maps.
fn apart(a: [[f64; 2]; 2], b: [[f64; 2]; 2]) -> f64 {
    largest(a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs()))
}

#[test]
fn an_upright_window_is_its_own_region() {
    let window = Window { middle: [100.0, 80.0], sides: [60.0, 40.0], turn_deg: 0.0 };
    assert_eq!(window.region(), Region { x: 70.0, y: 60.0, width: 60.0, height: 40.0 });
    assert!(apart(window.in_region(), [[1.0, 0.0], [0.0, 1.0]]) < 1e-12, "{:?}", window.in_region());
    for part in [Part::All, Part::Fallback(NotFound::Cut)] {
        assert_eq!(part.window(SIZE).region(), Region::whole(SIZE), "{part:?}");
    }
    assert_eq!(Part::Window(window).window(SIZE), window);
}

#[test]
fn a_turned_window_lies_within_its_region_and_touches_all_sides_of_it() {
    for turn_deg in [-40.0, -5.0, 12.0, 30.0, 90.0] {
        let window = Window { middle: [10.0, -20.0], sides: [80.0, 30.0], turn_deg };
        let (region, map) = (window.region(), window.in_region());
        let middle = [region.x + region.width / 2.0, region.y + region.height / 2.0];
        assert!(largest((0..2).map(|i| (middle[i] - window.middle[i]).abs())) < 1e-12, "{turn_deg}: {middle:?}");
        // Corners of the window, in halves of the region's sides.
        let corners = [[1.0, 1.0], [1.0, -1.0]].map(|[x, y]| map.map(|row| (row[0] * x + row[1] * y).abs()));
        for axis in 0..2 {
            let reach = largest(corners.iter().map(|corner| corner[axis]));
            assert!((reach - 1.0).abs() < 1e-12, "{turn_deg}: {corners:?}");
        }
    }
    // Counterclockwise by a quarter: what is right in the window is above in the frame.
    let quarter = Window { middle: [0.0; 2], sides: [80.0, 30.0], turn_deg: 90.0 };
    assert!(apart(quarter.in_region(), [[0.0, 1.0], [-1.0, 0.0]]) < 1e-12, "{:?}", quarter.in_region());
}
