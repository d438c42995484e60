//! Splats that move along polynomials of time and appear for a while: `SpacetimeGaussians` (Li et al. 2024), the
//! variant "lite", whose colours are plain RGB.

/// Coefficients of the position's polynomial: of the first, second and third power of time, x, y, z each.
pub const MOTION_FLOATS: usize = 9;

/// How each splat moves. With dt = t - `centre`: position + Σₖ motionₖ dtᵏ, quaternion + `omega` dt, and opacity times
/// exp(-(dt / exp(`log_duration`))²).
///
/// # Shapes
/// N rows each; times in units of the whole motion, 0 to 1
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectories {
    /// Time at which the splat is most opaque.
    pub centres: Vec<f32>,
    /// Natural logarithm of how long it is there.
    pub log_durations: Vec<f32>,
    /// Coefficients of the position, [`MOTION_FLOATS`] each.
    pub motion: Vec<[f32; MOTION_FLOATS]>,
    /// Change of the quaternion w, x, y, z with time.
    pub omega: Vec<[f32; 4]>,
}

impl Trajectories {
    /// Whether every value of row `row` is finite.
    #[must_use]
    pub fn is_finite(&self, row: usize) -> bool {
        let mut values = [self.centres[row], self.log_durations[row]].into_iter();
        let mut values = values.by_ref().chain(self.motion[row]).chain(self.omega[row]);
        values.all(f32::is_finite)
    }

    /// Keeps the rows that `keep` holds.
    pub fn retain(&mut self, keep: &[bool]) {
        super::gaussians::retain_rows(&mut self.centres, keep);
        super::gaussians::retain_rows(&mut self.log_durations, keep);
        super::gaussians::retain_rows(&mut self.motion, keep);
        super::gaussians::retain_rows(&mut self.omega, keep);
    }
}
