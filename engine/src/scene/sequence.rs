//! Folders with a file of splats for each moment.

use std::path::{Path, PathBuf};

use super::folder::{has_splat_extension, list};
use super::gaussians::Gaussians;
use super::limits::MAX_MOMENTS;
use super::source::{Opened, SplatSource};
use crate::base::files::bad_data;
use crate::base::natural;
use crate::error::EngineError;

/// A folder's moments, their files, and what there is to say about these.
#[derive(Default)]
pub(super) struct Take {
    pub(super) moments: Vec<Gaussians>,
    pub(super) sources: Vec<SplatSource>,
    pub(super) warnings: Vec<String>,
}

/// Opens the files of `root` that hold splats, in the order of the numbers in their names.
///
/// # Errors
/// [`EngineError::MissingInput`] when there are none; [`EngineError::BadData`] when they do not all have the same
/// splats: one offset for all moments needs rows that mean the same in each.
pub(super) fn open(root: &Path) -> Result<Take, EngineError> {
    let mut names: Vec<PathBuf> = list(root)?.into_iter().filter(|name| has_splat_extension(name)).collect();
    names.sort_by_cached_key(|name| natural::key(&name.to_string_lossy()));
    if names.is_empty() {
        let expected = "a 4DGaussians folder, or one with a file of splats for each moment".to_owned();
        return Err(EngineError::MissingInput { path: root.join("*.ply"), expected });
    }
    if names.len() > MAX_MOMENTS {
        return Err(bad_data(root, "files with splats", names.len(), format!("at most {MAX_MOMENTS} moments")));
    }
    let mut take = Take::default();
    for name in names {
        let path = root.join(name);
        let Opened { source, gaussians, trajectories, warnings: notes } = SplatSource::open(&path)?;
        if trajectories.is_some() {
            return Err(bad_data(&path, "splats", "on paths of their own", "still ones, as each file is one moment"));
        }
        if let (Some(first), Some(first_source)) = (take.moments.first(), take.sources.first()) {
            let of =
                |g: &Gaussians, s: &SplatSource| format!("{} of degree {} as {}", g.len(), g.sh_degree, s.format());
            let (got, expected) = (of(&gaussians, &source), of(first, first_source));
            if got != expected {
                return Err(bad_data(&path, "splats", got, format!("{expected}, as the first moment has")));
            }
            if !source.has_rows_of(first_source) {
                let got = "values that are not finite elsewhere than in the first moment";
                return Err(bad_data(&path, "splats", got, "the same splats in all moments"));
            }
        }
        take.moments.push(gaussians);
        take.sources.push(source);
        // What holds for the first file mostly holds for all.
        if take.warnings.len() < MAX_NOTES {
            take.warnings.extend(notes);
        }
    }
    Ok(take)
}

/// Notes that are shown at most.
const MAX_NOTES: usize = 8;
