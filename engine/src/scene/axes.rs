//! Scenes in other axes: half turns between the conventions of file formats.

use super::gaussians::{CHANNELS, Gaussians, SH_FLOATS};

/// Exponents of x, y and z in the SH bases, modulo 2: which signs a basis changes with.
const ODD_IN: [[bool; 3]; SH_FLOATS / CHANNELS] = {
    const X: [bool; 3] = [true, false, false];
    const Y: [bool; 3] = [false, true, false];
    const Z: [bool; 3] = [false, false, true];
    const XY: [bool; 3] = [true, true, false];
    const YZ: [bool; 3] = [false, true, true];
    const XZ: [bool; 3] = [true, false, true];
    const XYZ: [bool; 3] = [true, true, true];
    const EVEN: [bool; 3] = [false, false, false];
    [EVEN, Y, Z, X, XY, YZ, EVEN, XZ, EVEN, Y, XYZ, Y, Z, X, Z, X]
};

/// A half turn about a coordinate axis, which is its own inverse.
///
/// Captures come with y down and z forward (PLY and what is made from it). SPZ turns them about x, so that y is up and
/// z backward (RUB, its README); glTF about z, so that y is up and z forward (LUF, ibid.).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HalfTurn {
    /// y and z change their sign.
    AboutX,
    /// x and y change their sign.
    AboutZ,
}

impl HalfTurn {
    const fn negates(self) -> [bool; 3] {
        match self {
            Self::AboutX => [false, true, true],
            Self::AboutZ => [true, true, false],
        }
    }

    /// Sign of each float of one splat's SH coefficients `[16,3]` after the turn.
    #[must_use]
    pub fn sh_signs(self) -> [f32; SH_FLOATS] {
        let flips = self.negates();
        std::array::from_fn(|i| {
            let odd = ODD_IN[i / CHANNELS];
            let changes = (0..3).filter(|&axis| odd[axis] && flips[axis]).count();
            if changes % 2 == 1 { -1.0 } else { 1.0 }
        })
    }

    /// Turns means, rotations and colours.
    pub fn apply(self, gaussians: &mut Gaussians) {
        let flips = self.negates();
        for mean in &mut gaussians.means {
            for (value, flip) in mean.iter_mut().zip(flips) {
                *value = if flip { -*value } else { *value };
            }
        }
        for quat in &mut gaussians.quats {
            *quat = self.turned(*quat);
        }
        let signs = self.sh_signs();
        for splat in gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS) {
            splat.iter_mut().zip(signs).for_each(|(value, sign)| *value *= sign);
        }
    }

    /// The turn after the rotation w, x, y, z: the product of (0, 1, 0, 0) or (0, 0, 0, 1) and the quaternion.
    fn turned(self, [w, x, y, z]: [f32; 4]) -> [f32; 4] {
        match self {
            Self::AboutX => [-x, w, -z, y],
            Self::AboutZ => [-z, -y, x, w],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_half_turns_give_the_scene_back_up_to_the_sign_of_quaternions() {
        let before = Gaussians {
            means: vec![[1.0, 2.0, 3.0]],
            quats: vec![[0.1, 0.2, 0.3, 0.4]],
            scales: vec![[0.0; 3]],
            opacities: vec![0.0],
            sh_coeffs: (0_u8..48).map(f32::from).collect(),
            sh_degree: 3,
        };
        for turn in [HalfTurn::AboutX, HalfTurn::AboutZ] {
            let mut after = before.clone();
            turn.apply(&mut after);
            assert_ne!(after.means, before.means, "{turn:?} moves");
            turn.apply(&mut after);
            assert_eq!(after.means, before.means, "{turn:?}");
            assert_eq!(after.sh_coeffs, before.sh_coeffs, "{turn:?}");
            assert_eq!(after.quats[0], before.quats[0].map(|v| -v), "{turn:?}: a full turn");
        }
    }
}
