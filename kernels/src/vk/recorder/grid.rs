//! How many workgroups a kernel runs in.

use crate::error::KernelError;
use crate::vk::pipeline::KernelDef;

/// How many workgroups to start.
#[derive(Clone, Copy, Debug)]
pub enum Grid {
    /// At least this many invocations; the shader takes its index from `global_index()`.
    Threads(usize),
    /// Exactly these workgroups.
    Groups([u32; 3]),
}

impl Grid {
    /// At least `n` invocations.
    #[must_use]
    pub fn threads(n: usize) -> Self {
        Self::Threads(n)
    }

    /// Exactly `x × y × z` workgroups.
    #[must_use]
    pub fn groups(x: u32, y: u32, z: u32) -> Self {
        Self::Groups([x, y, z])
    }

    pub(super) fn resolve(self, kernel: &KernelDef, max_x: u32) -> Result<[u32; 3], KernelError> {
        let groups = match self {
            Self::Groups(groups) => groups,
            Self::Threads(n) => {
                let groups = n.div_ceil(kernel.local_size[0] as usize);
                let x = groups.min(max_x as usize);
                let y = if x == 0 { 0 } else { groups.div_ceil(x) };
                [u32::try_from(x).unwrap_or(u32::MAX), u32::try_from(y).unwrap_or(u32::MAX), 1]
            }
        };
        if groups.iter().any(|&g| g > max_x) {
            return Err(KernelError::Shape {
                kernel: kernel.name,
                buffer: "grid",
                got: format!("{groups:?} workgroups"),
                expected: format!("at most {max_x} along each axis"),
            });
        }
        Ok(groups)
    }
}
