//! How much memory the clips of an embedding may take.

use guard4d_engine::device::DeviceKind;
use guard4d_engine::watermark::embed::most_kept_bytes;

const GIB: u64 = 1 << 30;

#[test]
fn clips_take_what_was_asked_for_and_a_part_of_a_card() {
    let usual = 5 * GIB / 4;
    for kind in [DeviceKind::Cpu, DeviceKind::Integrated, DeviceKind::Discrete] {
        // More than usual, or less.
        assert_eq!(most_kept_bytes(kind, Some(8 * GIB), Some(64 * GIB)), 8 * GIB, "{kind:?}");
        assert_eq!(most_kept_bytes(kind, Some(GIB), Some(64 * GIB)), GIB, "{kind:?}");
        assert_eq!(most_kept_bytes(kind, None, None), usual, "{kind:?}");
    }
    assert_eq!(most_kept_bytes(DeviceKind::Discrete, None, Some(80 * GIB)), 20 * GIB);
    assert_eq!(most_kept_bytes(DeviceKind::Discrete, None, Some(2 * GIB)), usual, "no less than elsewhere");
    // What a processor's machine has free is not the embedding's alone.
    assert_eq!(most_kept_bytes(DeviceKind::Cpu, None, Some(80 * GIB)), usual);
    assert_eq!(most_kept_bytes(DeviceKind::Integrated, None, Some(80 * GIB)), usual);
}
