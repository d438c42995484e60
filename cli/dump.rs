//! `guard4d dump`

use std::path::Path;

use guard4d_engine::EngineError;
use guard4d_engine::clip::ClipSource;
use guard4d_engine::dump::{self, Border, View};
use guard4d_engine::output::{AtomicFile, Existing};
use guard4d_engine::scene::Model;
use guard4d_engine::tensor_file::TensorFile;
use serde_json::json;

use crate::args::{BorderArg, Common, DumpArgs, DumpCommand};
use crate::devices;
use crate::report::{Outcome, print};

pub(crate) fn run(args: &DumpArgs, common: &Common) -> Result<Outcome, EngineError> {
    let device = devices::open(common)?;
    let (tensors, out) = match &args.command {
        DumpCommand::Deform { model, time, out } => (dump::deform(&device, &Model::open(model)?, *time)?, out),
        DumpCommand::Render { model, camera, time, v_image, out } => {
            let view = View::open(camera, *time)?;
            let v_image = v_image.as_deref().map(TensorFile::read).transpose()?;
            (dump::render(&device, &Model::open(model)?, &view, v_image.as_ref())?, out)
        }
        DumpCommand::Clip { clip, io } => {
            let clip = devices::load_clip(&device, &ClipSource::from_argument(clip), common)?;
            (dump::clip(&device, &clip, &TensorFile::read(&io.input)?)?, &io.out)
        }
        DumpCommand::Conv3d { border, io } => {
            let border = match border {
                BorderArg::Zero => Border::Zero,
                BorderArg::Clip => Border::Clip,
            };
            (dump::conv3d(&device, &TensorFile::read(&io.input)?, border)?, &io.out)
        }
        DumpCommand::Ssim { io } => (dump::ssim(&device, &TensorFile::read(&io.input)?)?, &io.out),
        DumpCommand::Resize { size: (width, height), io } => {
            let to = [*height, *width].map(|side| side as usize);
            (dump::resize(&device, &TensorFile::read(&io.input)?, to)?, &io.out)
        }
        DumpCommand::Adam { io } => (dump::adam(&device, &TensorFile::read(&io.input)?)?, &io.out),
    };
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
    write(tensors, out, existing, common)
}

/// Writes the tensors and names them with their shapes.
fn write(tensors: TensorFile, out: &Path, existing: Existing, common: &Common) -> Result<Outcome, EngineError> {
    AtomicFile::write(out, existing, &tensors.to_bytes()?)?;
    let shapes: serde_json::Map<_, _> = tensors.tensors.iter().map(|(n, t)| (n.clone(), json!(t.shape))).collect();
    print(common, &shapes, |shapes| {
        shapes.iter().map(|(name, shape)| format!("  {name} {shape}")).collect::<Vec<_>>().join("\n")
    })?;
    Ok(Outcome::Done)
}
