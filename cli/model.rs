//! A model, with what there is to say about its files.

use std::path::Path;

use guard4d_engine::EngineError;
use guard4d_engine::scene::Model;

use crate::args::Common;
use crate::report::note;

/// Opens a model and tells what was assumed about it.
pub(crate) fn open(path: &Path, common: &Common) -> Result<Model, EngineError> {
    let model = Model::open(path)?;
    for warning in &model.warnings {
        note(common, &format!("note: {warning}"));
    }
    Ok(model)
}
