//! A model, with what there is to say about its files.

use std::path::Path;

use guard4d_engine::error::EngineError;
use guard4d_engine::scene::Model;
use guard4d_engine::scene::formats::Format;

use crate::flags::common::Common;
use crate::ui::report::note;

/// Opens a model and tells what was assumed about it.
pub(crate) fn open(path: &Path, common: &Common) -> Result<Model, EngineError> {
    told(Model::open(path)?, common)
}

/// Opens a model whose copies are to be of its own format.
pub(crate) fn open_in_kind(path: &Path, common: &Common) -> Result<Model, EngineError> {
    told(Model::open_in_kind(path)?, common)
}

/// Opens a model whose marked copy is to be of its own format, for all that this rounds.
pub(crate) fn open_lossy(path: &Path, common: &Common) -> Result<Model, EngineError> {
    let model = Model::open_in_kind(path)?;
    let format = model.sources()[0].format();
    if format != Format::Spz {
        return Err(EngineError::Usage {
            what: format!("{} with --lossy", path.display()),
            got: format.to_string(),
            expected: "an SPZ file, which is then written as SPZ".to_owned(),
        });
    }
    told(model, common)
}

fn told(model: Model, common: &Common) -> Result<Model, EngineError> {
    for warning in &model.warnings {
        note(common, &format!("note: {warning}"));
    }
    Ok(model)
}
