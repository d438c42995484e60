//! Tiny models, so that the time of a row is that of the farm.

use super::random::Random;

/// Splats of a model.
const SPLATS: usize = 30;

/// Coefficients beside the first of each colour channel: degree 1.
const REST: usize = 9;

/// A model of random splats that stands still, as a PLY of 3D Gaussian Splatting.
pub(super) fn ply(seed: u64) -> Vec<u8> {
    let mut random = Random::new(seed);
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(str::to_owned).into();
    names.extend((0..3).map(|i| format!("f_dc_{i}")));
    names.extend((0..REST).map(|i| format!("f_rest_{i}")));
    names.push("opacity".to_owned());
    names.extend((0..3).map(|i| format!("scale_{i}")));
    names.extend((0..4).map(|i| format!("rot_{i}")));
    let properties: String = names.iter().map(|name| format!("property float {name}\n")).collect();
    let header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {SPLATS}\n{properties}end_header\n");
    let mut bytes = header.into_bytes();
    for _ in 0..SPLATS {
        for name in &names {
            let value = match name.split('_').next().unwrap_or_default() {
                "nx" | "ny" | "nz" => 0.0,
                "scale" => random.between(-4.0, -2.0),
                _ => random.between(-1.0, 1.0),
            };
            bytes.extend(f32::to_le_bytes(value));
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_as_long_as_its_header_says() {
        let bytes = ply(1);
        let end = b"end_header\n";
        let body = bytes.windows(end.len()).position(|window| window == end).expect("a header") + end.len();
        assert_eq!(bytes.len() - body, SPLATS * 26 * 4);
        assert!(bytes != ply(2), "another seed makes another model");
    }
}
