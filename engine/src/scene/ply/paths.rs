//! The properties with which `SpacetimeGaussians` say how splats move.

use std::path::Path;

use super::body::Body;
use super::header::{Element, find_float};
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::trajectories::{MOTION_FLOATS, Trajectories};

/// A property that only files of splats on paths have.
const MARK: &str = "trbf_center";
/// One that only the variant "full" has, whose colours come out of a network beside the file.
const FULL: &str = "f_t_0";

/// Property indices of the `vertex` element.
#[derive(Clone, Debug)]
pub(super) struct PathLayout {
    centre: usize,
    log_duration: usize,
    motion: [usize; MOTION_FLOATS],
    omega: [usize; 4],
}

impl PathLayout {
    /// Finds the properties; `None` for splats that stand still.
    pub(super) fn find(path: &Path, element: &Element) -> Result<Option<Self>, EngineError> {
        if element.find(MARK).is_none() {
            return Ok(None);
        }
        if element.find(FULL).is_some() {
            let expected = "the variant `lite`; the colours of `full` are made by a network that is not supported";
            return Err(bad_data(path, format!("property `{FULL}`"), "SpacetimeGaussians `full`", expected));
        }
        let mut motion = [0; MOTION_FLOATS];
        for (index, place) in motion.iter_mut().enumerate() {
            *place = find_float(path, element, &format!("motion_{index}"))?;
        }
        let mut omega = [0; 4];
        for (index, place) in omega.iter_mut().enumerate() {
            *place = find_float(path, element, &format!("omega_{index}"))?;
        }
        let centre = find_float(path, element, MARK)?;
        Ok(Some(Self { centre, log_duration: find_float(path, element, "trbf_scale")?, motion, omega }))
    }

    pub(super) fn decode(&self, body: &Body<'_>, splats: usize) -> Trajectories {
        let mut paths = Trajectories::default();
        for row in 0..splats {
            let record = body.record(row);
            let value = |property| record.value(property);
            paths.centres.push(value(self.centre));
            paths.log_durations.push(value(self.log_duration));
            paths.motion.push(self.motion.map(value));
            paths.omega.push(self.omega.map(value));
        }
        paths
    }
}
