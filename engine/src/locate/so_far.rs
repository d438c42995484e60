//! What was found of a film before a search was broken off, so that it goes on from there.

use std::path::Path;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::align::Fit;
use super::pose::{Middle, Pose};
use crate::base::digest::Digest;
use crate::base::files::bad_data;
use crate::base::output::{AtomicFile, Existing};
use crate::base::tensor_file::TensorFile;
use crate::error::EngineError;
use crate::render::making::Making;

/// `format` entry of a checkpoint.
const FORMAT: &str = "guard4d.locating/4";
/// Entries of what is looked at, and of what was found, as JSON.
const IDENTITY: &str = "identity";
const SO_FAR: &str = "so_far";

/// What was found, shot by shot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SoFar {
    /// Where the longest shot begins to be found; none before it was looked for.
    pub(super) first: Option<First>,
    /// Frames of the shots that are done, in order.
    pub(super) shots: Vec<Vec<Option<Exactly>>>,
    /// How often a frame may be looked for anew.
    pub(super) searches: usize,
    /// How the film was made, as the last shot told.
    pub(super) making: Making,
}

/// Where the longest shot begins to be found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct First {
    /// None where nothing was alike.
    pub(super) begun: Option<Begun>,
    /// Whether the asset is mirrored there.
    pub(super) is_mirrored: bool,
}

/// A frame that is found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Begun {
    pub(super) frame: usize,
    pub(super) fit: Exactly,
    /// How like the original it is, looked at closely.
    pub(super) likeness: f64,
}

/// Where it is kept while a search runs.
#[derive(Clone, Copy, Debug)]
pub struct Kept<'a> {
    /// The file.
    pub path: &'a Path,
    /// Whether it is gone on with.
    pub goes_on: bool,
}

impl SoFar {
    /// Takes up what was found of the same pictures and original.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] without a file; [`EngineError::BadData`] for another film or original, and for
    /// what is no such file.
    pub fn read(path: &Path, identity: Digest) -> Result<Self, EngineError> {
        let file = TensorFile::read(path)?;
        file.expect_text("format", FORMAT)?;
        if file.text(IDENTITY)? != identity.to_string() {
            return Err(file.bad(
                IDENTITY,
                "another film or original",
                "the same frames, looked at for the same model",
            ));
        }
        serde_json::from_str(file.text(SO_FAR)?).map_err(|error| bad_data(path, SO_FAR, error, "what a search leaves"))
    }

    /// Keeps it.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path, identity: Digest) -> Result<(), EngineError> {
        let mut file = TensorFile { path: path.to_owned(), ..TensorFile::default() };
        let so_far = serde_json::to_string(self).expect("numbers are valid JSON");
        let entries = [("format", FORMAT.to_owned()), (IDENTITY, identity.to_string()), (SO_FAR, so_far)];
        file.meta.extend(entries.map(|(name, text)| (name.to_owned(), text)));
        AtomicFile::write(path, Existing::Replace, &file.to_bytes()?)
    }
}

/// A fit that is kept as the bits of its numbers, whatever they are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "Bits", from = "Bits")]
pub(super) struct Exactly(pub(super) Fit);

type Bits = [u64; 17];

impl From<Exactly> for Bits {
    fn from(Exactly(fit): Exactly) -> Self {
        let Fit { pose, cost, correlation, lens_weight, tied } = fit;
        let Pose { middle: Middle { point, radius }, turn, shift: [across, down], size, lens, time } = pose;
        let [x, y, z, w] = turn.to_array();
        let middle = [point.x, point.y, point.z, radius];
        let rest = [x, y, z, w, across, down, size, lens, time, cost, correlation, lens_weight, tied];
        let mut bits = middle.into_iter().chain(rest).map(f64::to_bits);
        std::array::from_fn(|_| bits.next().unwrap_or_default())
    }
}

impl From<Bits> for Exactly {
    fn from(bits: Bits) -> Self {
        let [px, py, pz, radius, x, y, z, w, across, down, size, lens, time, cost, correlation, lens_weight, tied] =
            bits.map(f64::from_bits);
        let middle = Middle { point: DVec3::new(px, py, pz), radius };
        let pose = Pose { middle, turn: DQuat::from_xyzw(x, y, z, w), shift: [across, down], size, lens, time };
        Self(Fit { pose, cost, correlation, lens_weight, tied })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::profile::Viewer;
    use crate::render::settings::Settings;

    #[test]
    fn what_was_found_comes_back_to_the_bit_and_for_the_same_film_alone() {
        let middle = Middle { point: DVec3::new(0.1, 1.0 / 7.0, -2.3), radius: 0.7 };
        let turn = DQuat::from_rotation_x(0.1);
        let pose = Pose { middle, turn, shift: [0.1, -0.3], size: -1.2, lens: 0.3, time: 0.7 };
        let fit = Exactly(Fit { pose, cost: 1e-3, correlation: 0.9, lens_weight: f64::INFINITY, tied: 1.0 / 3.0 });
        let first = First { begun: Some(Begun { frame: 3, fit, likeness: 0.1 + 0.2 }), is_mirrored: true };
        let settings = Settings { dilation: Some(0.1), ..Viewer::GaussianSplats3d.into() };
        let making = Making { settings, times: 2 };
        let so_far = SoFar { first: Some(first), shots: vec![vec![Some(fit), None], vec![]], searches: 4, making };
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("leak.json.checkpoint.safetensors");
        so_far.write(&path, Digest::of(b"this")).expect("writable");
        assert_eq!(SoFar::read(&path, Digest::of(b"this")).expect("the same"), so_far);
        let refused = SoFar::read(&path, Digest::of(b"other")).expect_err("another film").to_string();
        assert!(refused.contains("leak.json") && refused.contains("another film"), "{refused}");
        std::fs::remove_file(&path).expect("a file");
        let refused = SoFar::read(&path, Digest::of(b"this")).expect_err("nothing");
        assert!(matches!(refused, EngineError::MissingInput { .. }), "{refused}");
    }
}
