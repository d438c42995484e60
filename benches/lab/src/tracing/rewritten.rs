//! Copies that went through somebody else's program: other formats, another order, fewer splats.

use std::path::Path;
use std::process::Command;

use guard4d_engine::error::EngineError;
use guard4d_engine::scene::{Gaussians, Model, ply};

/// How a copy is rewritten: arguments of `splat-transform` (PlayCanvas), and the format that it comes out in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// In tables.
    pub name: &'static str,
    actions: &'static [&'static str],
    extension: &'static str,
}

/// All ways: what it writes of splats alone, reordered, and simplified.
pub const WAYS: [Way; 6] = [
    Way { name: "as spz", actions: &[], extension: "spz" },
    Way { name: "as sog", actions: &[], extension: "sog" },
    Way { name: "as compressed ply", actions: &[], extension: "compressed.ply" },
    Way { name: "as reordered ply", actions: &["--morton-order"], extension: "ply" },
    Way { name: "turned and scaled", actions: &["--rotate", "30,40,50", "--scale", "1.7"], extension: "ply" },
    Way { name: "decimated to 50 %", actions: &["--decimate", "50%"], extension: "ply" },
];

impl Way {
    /// Whether films of it can be compared with those of the original's cameras.
    #[must_use]
    pub fn stays_in_place(self) -> bool {
        !self.actions.contains(&"--rotate")
    }

    /// `gaussians` as `program` makes them, by files in `folder`.
    ///
    /// # Errors
    /// [`EngineError::Program`] when it fails; those of reading what it wrote.
    pub fn through(self, program: &Path, gaussians: &Gaussians, folder: &Path) -> Result<Gaussians, EngineError> {
        let [from, to] = [folder.join("copy.ply"), folder.join(format!("rewritten.{}", self.extension))];
        std::fs::write(&from, ply::encode(gaussians))
            .map_err(|source| EngineError::Io { path: from.clone(), source })?;
        let failed = |reason: String| EngineError::Program { program: program.display().to_string(), reason };
        let mut command = Command::new(program);
        command.args(["-q", "-w", "-g", "cpu"]).arg(&from).args(self.actions).arg(&to);
        let run = command.output().map_err(|error| failed(error.to_string()))?;
        if !run.status.success() {
            return Err(failed(String::from_utf8_lossy(&run.stderr).trim().to_owned()));
        }
        Ok(Model::open(&to)?.gaussians)
    }
}
